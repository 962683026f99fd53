"""Fields of ROS 2 messages: where a type has them, whether bindings and sensors fit them, and their values in a message."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, assert_never

from pnm.core.logic.computed_values import MISSING
from pnm.core.machine.bindings import Binding, Table
from pnm.core.message_fields import Comparison, Every, Field, FieldValue, Flag, Having, Negation, Some, Test, item, parse_field, written
from pnm.errors import InputError, suggestion
from pnm.knowledge.sensor_model import ExclusiveFact, Fact, Number, Object, Sensor, Statement, Stored
from pnm.ros.node.messages import FieldError, import_type, plain, to_value

_LIST: Final = re.compile(r"(.+)\[(\d+)\]|sequence<(.+?)(?:, \d+)?>")
NUMBER: Final = re.compile(r"u?int\d+|float|double|octet")
_WRITTEN: Final = re.compile(r"-?\d.*")
ANY: Final = re.compile(r".*")
TEXT: Final = re.compile(r"w?string(<\d+>)?")


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
        case Negation(inner):
            return Negation(fitted_test(inner, message_type))
        case Every(tests):
            return Every(tuple([fitted_test(part, message_type) for part in tests]))
        case Some(tests):
            return Some(tuple([fitted_test(part, message_type) for part in tests]))
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
    keys = {key: key if _WRITTEN.fullmatch(key) else written(field.constant(key)) for key in source.table}
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
                if _inside(kind) is None:
                    raise InputError(f"{so_far.removesuffix(f'[{step}]')} is a list of {kind}; only items with fields can be found by one")
                part = find_field(_inside(kind), parse_field(step.name)).kind
                if not (TEXT.fullmatch(part) or (NUMBER.fullmatch(part) and _WRITTEN.fullmatch(step.value))):
                    raise InputError(f"{so_far}: {step.name} is a {part}; expected a text")
        else:
            kinds = {} if inside is None else inside.get_fields_and_field_types()
            if step not in kinds:
                has = f"it has {', '.join(kinds)}" if kinds else "it has none"
                raise InputError(f"{kind or message_type.__name__} has no field {step!r}; {f'{suggestion(step, kinds)} {has}'.strip()}")
            kind, so_far, owner = kinds[step], f"{so_far}.{step}".lstrip("."), inside
        inside = _inside(kind)
    return MessageField(where, kind, owner)


def _inside(kind: str) -> Any:
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

    Args:
        binding: of the action.
        action_type: of its server.
        example: says which kinds of values goal fields are filled with.

    Raises:
        InputError: the goal has no such field, a constant is of another kind than its field, or the result has no such field.
    """
    for name, source in (binding.goal or {}).items():
        _check(source, find_field(action_type.Goal, parse_field(name)).kind, name, example)
    for name in binding.store:
        find_field(action_type.Result, parse_field(name))
    success = binding.success and fitted_test(binding.success, action_type.Result)
    reason = binding.reason and fitted_source(binding.reason, action_type.Result, ANY, "a value")
    final = binding.final and fitted_test(binding.final, action_type.Result)
    return replace(binding, success=success, reason=reason, final=final)


def _check(source: object, kind: str, path: str, example: Example) -> None:
    """Refuse what can never be the value of a field of this kind; what only a call knows is looked at when its goal is sent."""
    inner, package = item_kind(kind), kind.rpartition("/")
    match source:
        case Table(_, rows):
            for name, row in rows.items():
                _check(row, kind, f"{path} of {name}", example)
        case str() if source[:1] in ("?", "$", "("):
            value = example(source)
            if value is not MISSING:
                _check_value(kind, value, f"{path}, which is filled from {source},")
        case Mapping() if inner is None and package[1]:
            message_type = import_type(f"{package[0]}/msg/{package[2]}")
            for name, part in source.items():
                _check(part, find_field(message_type, parse_field(name)).kind, f"{path}.{name}", example)
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
    try:
        match statement:
            case Fact(_, test):
                return replace(statement, test=fitted_test(test, message_type))
            case Number(_, source):
                return replace(statement, source=fitted_source(source, message_type, NUMBER, "a number"))
            case ExclusiveFact(_, source) | Object(_, source):
                return replace(statement, source=fitted_source(source, message_type, TEXT, "a text"))
            case Stored(_, source):
                return replace(statement, source=fitted_source(source, message_type, ANY, "a value"))
            case _:
                assert_never(statement)
    except InputError as error:
        raise InputError(error.message, statement.position) from error
