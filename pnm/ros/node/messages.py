"""Messages of ROS 2: conversion to and from plain data, fields of types, and bindings and sensors that are fitted to types.

Every value is checked before it becomes part of a message:
`rclpy` checks nothing by default and sends garbage: the int 1 in a float64 field arrives as 5e-324, -1 in an unsigned
one ends in a ``SystemError``. Its own checks (ROS_PYTHON_CHECK_FIELDS=1) are no alternative: they refuse whole numbers
for float fields, name no path, and apply to all other code in the process.

Plain data has the types of JSON: bool, int, float, str, list and dict. A byte is an int from 0 to 255.
"""

from __future__ import annotations

import importlib.util
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from typing import Any, Final, assert_never
from uuid import UUID

from pnm.core.logic.computed_values import MISSING
from pnm.core.machine.bindings import Binding, Table
from pnm.core.message_fields import Combined, Comparison, Field, FieldValue, Flag, Having, Test, item, parse_field, written
from pnm.errors import InputError, PnmError, located, suggestion
from pnm.knowledge.sensor_model import Sensor, Statement

_TYPE: Final = re.compile(r"([a-z][a-z0-9_]*)/(action|msg|srv)/([A-Z][A-Za-z0-9]*)")
_LIST: Final = re.compile(r"(.+)\[(\d+)\]|sequence<(.+?)(?:, (\d+))?>")
_INTEGER: Final = re.compile(r"(u?)int(8|16|32|64)")
TEXT: Final = re.compile(r"w?string(?:<(\d+)>)?")
NUMBER: Final = re.compile(r"u?int\d+|float|double|octet")
ANY: Final = re.compile(r".*")
_NUMBER_TEXT: Final = re.compile(r"-?\d.*")
_WRITTEN: Final = {"boolean": "bool", "octet": "byte", "float": "float32", "double": "float64"}
_SECONDS: Final = frozenset({"builtin_interfaces/Time", "builtin_interfaces/Duration"})
_LARGEST_FLOAT32: Final = 3.4028235677973366e38  # from here on a double rounds to infinity
_ADVICE: Final = "add a goal mapping to the binding"


class FieldError(PnmError):
    """A value does not fit the field of a message, whose path is such as ``pose.position.x`` or ``poses[2]``; nothing was sent."""

    def __init__(self, path: str, needs: str, got: str, advice: str = "") -> None:
        super().__init__(f"field {path} needs {needs}, got {got}{f'; {advice}' if advice else ''}")
        self.path = path
        self.needs = needs
        self.got = got


def has_own_types() -> bool:
    """Return whether `pnm_interfaces` is installed; else there are no knowledge services, nor reports on ``knowledge/sensed``."""
    return importlib.util.find_spec("pnm_interfaces") is not None


def import_type(name: str) -> Any:
    """Return the class of an interface such as ``nav2_msgs/action/NavigateToPose``.

    Raises `InputError` if this is not the name of a type, or the type is not installed here.
    """
    parts = _TYPE.fullmatch(name)
    if not parts:
        raise InputError(f"not a ROS type: {name!r}; expected something like nav2_msgs/action/NavigateToPose")
    package, kind, interface = parts.groups()
    try:
        return getattr(importlib.import_module(f"{package}.{kind}"), interface)
    except (ImportError, AttributeError) as error:
        ours = "`pip install ./ros/pnm_interfaces`, or its wheel: nodes and the commands for them need it"
        advice = ours if package == "pnm_interfaces" else f"install the ROS package {package}, or source its workspace"
        raise InputError(f"the ROS type {name} is not installed; {advice}") from error


def fields(message_type: Any) -> tuple[str, ...]:
    """Return the names of the fields of a message class."""
    return tuple(message_type.get_fields_and_field_types())


def to_message(message_type: Any, data: Mapping[str, object], path: str = "") -> Any:
    """Make a message from values by field name; fields without a value keep their defaults. The path is for errors.

    Whole numbers are accepted for float fields and the other way round (80.0 for an int32), a number of seconds for a Time
    or a Duration, and a `UUID`. Nothing else is converted: text is never read as a number.
    """
    message = message_type()
    kinds = message_type.get_fields_and_field_types()
    for name, value in data.items():
        inner = f"{path}.{name}" if path else str(name)
        if name not in kinds:
            near = get_close_matches(str(name), kinds, n=1)
            needs = f"to be one of {', '.join(kinds)}" if kinds else "to be left out: the message has no fields"
            raise FieldError(inner, needs, f"a field that {message_type.__name__} does not have", f"{near[0]}?" if near else "")
        setattr(message, name, to_value(kinds[name], value, inner))
    return message


def to_data(message: Any) -> dict[str, object]:
    """Return the fields of a message as plain data."""
    return {name: plain(getattr(message, name)) for name in fields(message)}


def plain(value: Any) -> object:
    """Return the value of a field as plain data."""
    if isinstance(value, bytes):
        return value[0]
    if hasattr(value, "tolist"):
        return value.tolist()
    if hasattr(value, "get_fields_and_field_types"):
        return to_data(value)
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value


def to_value(kind: str, value: object, path: str) -> object:
    """Return the value as `rclpy` stores it in a field of this kind, as ``get_fields_and_field_types`` names it."""
    if hasattr(value, "tolist"):  # numpy arrays and numbers, array.array
        value = value.tolist()
    if parts := _LIST.fullmatch(kind):
        return _items(parts[1] or parts[3], int(parts[2] or parts[4] or -1), parts[2] is not None, value, path)
    if "/" in kind:
        return _nested(kind, value, path)
    if text := TEXT.fullmatch(kind):
        if not isinstance(value, str):
            raise FieldError(path, kind, _show(value))
        if text[1] and len(value) > int(text[1]):
            raise FieldError(path, f"text of at most {text[1]} characters", f"{len(value)} of them")
        # `rclpy` cuts the text off at a NUL, and fails to send a surrogate.
        if "\0" in value or any("\ud800" <= letter <= "\udfff" for letter in value):
            raise FieldError(path, "text that can be sent", _show(value))
        return value
    if kind in ("float", "double"):
        return _float(kind, value, path)
    if kind == "octet":
        is_byte = isinstance(value, bytes) and len(value) == 1
        return value if is_byte else bytes([_whole("byte (0 to 255)", 0, 255, value, path)])
    if kind == "boolean":
        if not isinstance(value, bool):
            raise _wrong(kind, value, path)
        return value
    integer = _INTEGER.fullmatch(kind)
    if not integer:
        raise FieldError(path, f"to be left out: {kind} fields are not supported", _show(value))
    bits = int(integer[2])
    low, high = (0, 2**bits - 1) if integer[1] else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    return _whole(f"{kind} ({low} to {high})", low, high, value, path)


def _items(kind: str, size: int, exact: bool, value: object, path: str) -> list[object]:
    what = f"values of type {_WRITTEN.get(kind, kind)}"
    count = "" if size < 0 else f"exactly {size} " if exact else f"at most {size} "
    if isinstance(value, str) or not isinstance(value, Sequence):
        raise FieldError(path, f"a list of {count}{what}", _show(value), _ADVICE if isinstance(value, str) else "")
    if size >= 0 and (len(value) != size if exact else len(value) > size):
        raise FieldError(path, f"{count}{what}", f"{len(value)} of them")
    return [to_value(kind, item, f"{path}[{index}]") for index, item in enumerate(value)]


def _nested(kind: str, value: object, path: str) -> object:
    if kind in _SECONDS and isinstance(value, int | float) and not isinstance(value, bool):
        if not math.isfinite(value):
            raise FieldError(path, f"the seconds of a {kind}", _show(value))
        seconds = math.floor(value)
        nanoseconds = round((value - seconds) * 1e9)
        value = {"sec": seconds + nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}
    if isinstance(value, UUID):
        value = {"uuid": [*value.bytes]}
    if not isinstance(value, Mapping):
        raise FieldError(path, f"the fields of a {kind}", _show(value), _ADVICE if isinstance(value, str) else "")
    return to_message(_class_of(kind), value, path)


def _float(kind: str, value: object, path: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise _wrong(kind, value, path)
    try:
        number = float(value)
    except OverflowError as error:
        raise _wrong(kind, value, path) from error
    if kind == "float" and math.isfinite(number) and abs(number) >= _LARGEST_FLOAT32:
        raise _wrong(kind, value, path)
    return number


def _whole(needs: str, low: int, high: int, value: object, path: str) -> int:
    if isinstance(value, float) and value.is_integer():  # numbers in PDDL are floats, counts among them
        value = int(value)
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise _wrong(needs, value, path)
    return value


def _wrong(kind: str, value: object, path: str) -> FieldError:
    return FieldError(path, _WRITTEN.get(kind, kind), _show(value), _ADVICE if isinstance(value, str) else "")


def _show(value: object) -> str:
    if value is None:
        return "nothing"
    written = repr(value)
    written = written if len(written) <= 60 else f"{written[:57]}..."
    return f"{written} ({type(value).__name__})"


# --- fields of types, and tests and sources that are fitted to them ------------------------


def fitted_test(test: Test, message_type: Any) -> Test:
    """Return a test with the values of the type's constants in the place of their names; raise `InputError` where it does not fit."""
    match test:
        case Flag(where):
            kind = find_field(message_type, where).kind
            if kind != "boolean":
                raise InputError(f"{where} is a {kind}; expected a boolean, or 'when' and how it compares")
            return test
        case Comparison(where):
            return _comparison(test, find_field(message_type, where))
        case Combined(word, tests):
            return Combined(word, tuple([fitted_test(part, message_type) for part in tests]))
        case _:
            assert_never(test)


def _comparison(test: Comparison, field: MessageField) -> Comparison:
    kind, constant = field.kind, test.constant
    if test.operation == "contains" and not (TEXT.fullmatch(kind) and isinstance(constant, str)):
        inner = item_kind(kind)
        if inner is None:
            raise InputError(f"{test.field} is a {kind}, which contains nothing")
        kind = inner
    match constant:
        case bool():
            fits = kind == "boolean"
        case int() | float():
            fits = bool(NUMBER.fullmatch(kind))
        case str() if NUMBER.fullmatch(kind):
            return replace(test, constant=field.constant(constant))
        case str():
            fits = bool(TEXT.fullmatch(kind))
        case _:
            fits = True
    if not fits:
        raise InputError(f"{test.field} is a {field.kind}, which cannot be compared with {constant!r}")
    return test


def fitted_source(source: FieldValue, message_type: Any, needed: re.Pattern[str], expected: str) -> FieldValue:
    """Return a source with the values of the type's constants in the place of their names; raise `InputError` where it does not fit."""
    field = find_field(message_type, source.field)
    if source.table is None:
        if not needed.fullmatch(field.kind):
            raise InputError(f"{source.field} is a {field.kind}; expected {expected}, or a table")
        return source
    if not NUMBER.fullmatch(field.kind):
        return source
    keys = {key: key if _NUMBER_TEXT.fullmatch(key) else written(field.constant(key)) for key in source.table}
    return replace(source, table={keys[key]: value for key, value in source.table.items()})


@dataclass(frozen=True, slots=True)
class MessageField:
    """A field of a message type."""

    where: Field
    kind: str
    """As ``get_fields_and_field_types`` writes it."""
    owner: Any
    """The class of the messages that have it, which may be inside others."""

    @property
    def constants(self) -> dict[str, object]:
        """The constants of the class by their names, the smallest first."""
        # of a field with a default, the class has one as a constant
        names = [name for name in dir(type(self.owner)) if name.isupper() and name[0] != "_" and not name.endswith("__DEFAULT")]
        values = {name: plain(getattr(self.owner, name)) for name in names}
        return dict(sorted(values.items(), key=lambda item: (str(type(item[1])), item[1])))

    def constant(self, name: str) -> object:
        """Return the value of the constant; raise an `InputError` if the class has none of this name."""
        known = self.constants
        if name not in known:
            hint = suggestion(name, known) or (f"expected a number, or one of {', '.join(known)}" if known else "expected a number")
            raise InputError(f"{self.where} is a {self.kind}, which cannot be compared with {name!r}; {hint}")
        return known[name]


def find_field(message_type: Any, where: Field) -> MessageField:
    """Return a field, which may be inside of other fields; raise an `InputError` if messages of this type have none."""
    kind, so_far = "", ""
    owner, inside = message_type, message_type
    for step in where.steps:
        if not isinstance(step, str):
            inner = item_kind(kind)
            if inner is None:
                raise InputError(f"{so_far} is a {kind}; only a list has an item {step}")
            kind, so_far = inner, f"{so_far}[{step}]"
            if isinstance(step, Having):
                if _class_of(kind) is None:
                    raise InputError(f"{so_far.removesuffix(f'[{step}]')} is a list of {kind}; only items with fields can be found by one")
                part = find_field(_class_of(kind), parse_field(step.name)).kind
                if not (TEXT.fullmatch(part) or (NUMBER.fullmatch(part) and _NUMBER_TEXT.fullmatch(step.value))):
                    raise InputError(f"{so_far}: {step.name} is a {part}; expected a text")
        else:
            kinds = {} if inside is None else inside.get_fields_and_field_types()
            if step not in kinds:
                has = f"it has {', '.join(kinds)}" if kinds else "it has none"
                raise InputError(f"{kind or message_type.__name__} has no field {step!r}; {f'{suggestion(step, kinds)} {has}'.strip()}")
            kind, so_far, owner = kinds[step], f"{so_far}.{step}".lstrip("."), inside
        inside = _class_of(kind)
    return MessageField(where, kind, owner)


def _class_of(kind: str) -> Any:
    """Return the class of messages that are inside of others; None for a kind of field that is no message."""
    package, slash, name = kind.rpartition("/")
    return import_type(f"{package}/msg/{name}") if slash and item_kind(kind) is None else None


def item_kind(kind: str) -> str | None:
    """Return the kind of a list's items; None if it is no list."""
    parts = _LIST.fullmatch(kind)
    return parts and (parts[1] or parts[3])


def value_at(message: Any, where: Field) -> object:
    """Return the value of a field of a message, as plain data; raise `Unreadable` if a list has no such item."""
    value = message
    for step in where.steps:
        value = getattr(value, step) if isinstance(step, str) else item(value, step, where, getattr)
    return plain(value)


# --- bindings fitted to the type of their action server, or refused ------------------------

Example = Callable[[str], object]
"""Returns a value that a parameter, a variable or a fluent may have; `MISSING` if its kind is not known."""


def fitted_binding(binding: Binding, action_type: Any, example: Example = lambda source: MISSING) -> Binding:
    """Return the binding with the values of the type's constants in the place of their names.

    `example` says which kinds of values goal fields are filled with. Raises `InputError` if the goal has no such field, a constant is
    of another kind than its field, or the result has no such field.
    """
    for name, source in (binding.goal or {}).items():
        _check(source, find_field(action_type.Goal, parse_field(name)).kind, name, example)
    for name, target in binding.store.items():
        kind = find_field(action_type.Result, parse_field(name)).kind
        if target.startswith("(") and (value := example(target)) is not MISSING:
            needed = "a text" if isinstance(value, str) else "a boolean" if isinstance(value, bool) else "a number"
            if not (kind == "boolean" if isinstance(value, bool) else (TEXT if isinstance(value, str) else NUMBER).fullmatch(kind)):
                raise InputError(f"{name} is a {kind}; {target} needs {needed}")
    if binding.found is not None:
        found = find_field(action_type.Result, parse_field(str(binding.found.field)))
        if "/" in (kind := item_kind(found.kind) or ""):
            find_field(_class_of(kind), parse_field("name"))
        elif not (TEXT.fullmatch(kind) or NUMBER.fullmatch(kind)):
            raise InputError(f"{binding.found.field} is a {found.kind}; expected a list of names, or of messages with a field 'name'")
    success = binding.success and fitted_test(binding.success, action_type.Result)
    reason = binding.reason and fitted_source(binding.reason, action_type.Result, ANY, "a value")
    final = binding.final and fitted_test(binding.final, action_type.Result)
    outcomes = {name: fitted_test(test, action_type.Result) for name, test in binding.outcomes.items()}
    return replace(binding, success=success, reason=reason, final=final, outcomes=outcomes)


def _check(source: object, kind: str, path: str, example: Example) -> None:
    """Refuse what can never be the value of a field of this kind; what only a call knows is looked at when its goal is sent."""
    inner = item_kind(kind)
    match source:
        case Table(_, rows):
            for name, row in rows.items():
                _check(row, kind, f"{path} of {name}", example)
        case str() if source[:1] in ("?", "$", "("):
            value = example(source)
            if value is not MISSING:
                _check_value(kind, value, f"{path}, which is filled from {source},")
        case Mapping() if "/" in kind and inner is None:
            for name, part in source.items():
                _check(part, find_field(_class_of(kind), parse_field(name)).kind, f"{path}.{name}", example)
        case list() if inner is not None:
            for number, part in enumerate(source):
                _check(part, inner, f"{path}[{number}]", example)
        case _:
            _check_value(kind, source, path)


def _check_value(kind: str, value: object, path: str) -> None:
    try:
        to_value(kind, value, path)
    except FieldError as error:
        raise InputError(f"field {error.path} needs {error.needs}, got {error.got}") from error


# --- sensors fitted to the types of their messages -----------------------------------------


def fitted(sensor: Sensor, message_type: Any) -> Sensor:
    """Return a sensor with the values of the type's constants in the place of their names."""
    return replace(sensor, statements=tuple([_fitted(statement, message_type) for statement in sensor.statements]))


def _fitted(statement: Statement, message_type: Any) -> Statement:
    source = statement.source
    with located(statement.position):
        if isinstance(source, FieldValue):
            needed, expected = (TEXT, "a text") if statement.types else (NUMBER, "a number")
            if isinstance(statement.subject, str):
                needed, expected = ANY, "a value"
            source = fitted_source(source, message_type, needed, expected)
        else:
            source = fitted_test(source, message_type)
    return replace(statement, source=source)
