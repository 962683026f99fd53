"""The fields of ROS 2 messages that sensors look at: whether a type has them, and what a message holds in them."""

from __future__ import annotations

import re
from typing import Any, Final

from pnm.errors import InputError
from pnm.message_fields import Comparison, Field, Flag, Source, Unreadable, comparisons
from pnm.nearest import meant
from pnm.ros.messages import import_type, plain
from pnm.sensing import Choice, Fact, Number, Object, Sensor, Statement, Stored

_LIST: Final = re.compile(r"(.+)\[(\d+)\]|sequence<(.+?)(?:, \d+)?>")
_NUMBER: Final = re.compile(r"u?int\d+|float|double|octet")
_TEXT: Final = re.compile(r"w?string(<\d+>)?")


def check_fields(sensor: Sensor, message_type: Any) -> None:
    """Refuse a sensor that looks for what messages of this type do not have.

    Raises:
        InputError: a field is not there, or is of another kind than what it is used for.
    """
    for statement in sensor.statements:
        try:
            _check(statement, message_type)
        except InputError as error:
            raise InputError(error.message, statement.position) from error


def _check(statement: Statement, message_type: Any) -> None:
    match statement:
        case Fact(_, test):
            for one in comparisons(test):
                _check_test(one, kind_of(message_type, one.field))
        case Number(_, source):
            _check_source(source, message_type, _NUMBER, "a number")
        case Choice(_, source) | Object(_, source):
            _check_source(source, message_type, _TEXT, "a text")
        case Stored(_, source):
            kind_of(message_type, source.field)


def _check_test(test: Flag | Comparison, kind: str) -> None:
    if isinstance(test, Flag):
        if kind != "boolean":
            raise InputError(f"{test.field} is a {kind}; expected a boolean, or 'when' and how it compares")
        return
    listed = test.operation == "contains"
    inner = _item(kind) if listed else kind
    if inner is None and not (_TEXT.fullmatch(kind) and isinstance(test.constant, str)):
        raise InputError(f"{test.field} is a {kind}, which contains nothing")
    match test.constant:
        case bool():
            fits = inner == "boolean"
        case int() | float():
            fits = bool(_NUMBER.fullmatch(inner or ""))
        case str():
            fits = inner is None or bool(_TEXT.fullmatch(inner))
        case _:
            fits = True
    if not fits:
        raise InputError(f"{test.field} is a {kind}, which cannot be compared with {test.constant!r}")


def _check_source(source: Source, message_type: Any, needed: re.Pattern[str], expected: str) -> None:
    kind = kind_of(message_type, source.field)
    if source.table is None and not needed.fullmatch(kind):
        raise InputError(f"{source.field} is a {kind}; expected {expected}, or a table")


def kind_of(message_type: Any, where: Field) -> str:
    """Return the kind of a field, as ``get_fields_and_field_types`` writes it.

    Raises:
        InputError: messages of this type have no such field.
    """
    kind, kinds, so_far = "", message_type.get_fields_and_field_types(), ""
    for step in where.steps:
        if isinstance(step, int):
            inner = _item(kind)
            if inner is None:
                raise InputError(f"{so_far} is a {kind}; only a list has an item {step}")
            kind, so_far = inner, f"{so_far}[{step}]"
        elif step in kinds:
            kind, so_far = kinds[step], f"{so_far}.{step}".lstrip(".")
        else:
            owner = kind or message_type.__name__
            has = f"it has {', '.join(kinds)}" if kinds else "it has none"
            raise InputError(f"{owner} has no field {step!r}; {' '.join(filter(None, (meant(step, kinds), has)))}")
        package, slash, name = kind.rpartition("/")
        kinds = import_type(f"{package}/msg/{name}").get_fields_and_field_types() if slash and _item(kind) is None else {}
    return kind


def _item(kind: str) -> str | None:
    """Return the kind of a list's items; None if it is no list."""
    found = _LIST.fullmatch(kind)
    return found and (found[1] or found[3])


def value_at(message: Any, where: Field) -> object:
    """Return what a message holds in a field, as plain data.

    Raises:
        Unreadable: a list has no such item.
    """
    value = message
    for step in where.steps:
        if not isinstance(step, int):
            value = getattr(value, step)
        elif -len(value) <= step < len(value):
            value = value[step]
        else:
            raise Unreadable(f"there is no {where}: the list has {len(value)} items")
    return plain(value)
