"""Fields of messages: their paths, tests of their values, and tables that translate these."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, TypeAlias, assert_never

from pnm.core.logic.computed_values import Uncomputable, operate
from pnm.core.logic.conditions import TOLERANCE
from pnm.core.logic.expressions import is_number
from pnm.errors import InputError, PnmError

COMPARISONS: Final = ("eq", "ne", "lt", "le", "gt", "ge", "contains")
"""Operators of `pnm.core.logic.computed_values` that a field and a constant can be compared by."""

_STEP: Final = re.compile(r"\.?([A-Za-z]\w*)|\[(-?\d{1,9})\]|\[([A-Za-z]\w*)=([^\[\]]+)\]", re.ASCII)


class Unreadable(PnmError):
    """A message has no such field, or a value of the wrong kind."""


@dataclass(frozen=True, slots=True)
class Having:
    """The one item of a list whose field has this value."""

    name: str
    value: str
    """As the keys of tables are written; ``?r`` stands for an object."""

    def __str__(self) -> str:
        return f"{self.name}={self.value}"


@dataclass(frozen=True, slots=True)
class Field:
    """The path of a field in a message: names and, in lists, items by position, from the end if negative, or by a field of theirs."""

    steps: tuple[str | int | Having, ...]

    def __str__(self) -> str:
        return "".join(f".{step}" if isinstance(step, str) else f"[{step}]" for step in self.steps)[1:]

    @property
    def variables(self) -> tuple[str, ...]:
        """The variables in it."""
        return tuple(step.value for step in self.steps if isinstance(step, Having) and step.value.startswith("?"))

    def bound(self, env: Mapping[str, str]) -> Field:
        """Return it with objects in the place of variables."""
        if not self.variables:
            return self
        steps = (replace(step, value=env.get(step.value, step.value)) if isinstance(step, Having) else step for step in self.steps)
        return Field(tuple(steps))


Look: TypeAlias = Callable[[Field], object]
"""Returns the value of a field of a message as plain data; raises `Unreadable` when there is none."""


def parse_field(text: str) -> Field:
    """Read ``pose.position.x``, ``cells[0].voltage`` or ``objects[name=?o].parent``; raise `InputError` for anything else."""
    steps: list[str | int | Having] = []
    end = 0
    while step := _STEP.match(text, end):
        if (step[0][0] == ".") is not (step[1] is not None and end > 0):
            break
        steps.append(step[1] if step[1] is not None else Having(step[3], step[4]) if step[3] else int(step[2]))
        end = step.end()
    if not steps or not isinstance(steps[0], str) or end != len(text):
        raise InputError(f"not a field: {text!r}; expected something like pose.position.x, cells[0].voltage or objects[name=?o].parent")
    return Field(tuple(steps))


# --- tests of fields -----------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Flag:
    """The field is true."""

    field: Field


@dataclass(frozen=True, slots=True)
class Comparison:
    """The comparison of the field with the constant is true."""

    field: Field
    operation: str
    constant: object


@dataclass(frozen=True, slots=True)
class Combined:
    """Several tests as one."""

    word: str
    """``all``: they succeed, of which there may be none. ``any``: at least one succeeds. ``not``: the only one fails."""
    tests: tuple[Test, ...] = ()


Test: TypeAlias = Flag | Comparison | Combined


def fields_bound(test: Test, env: Mapping[str, str]) -> Test:
    """Return the test with objects in the place of the variables in its fields."""
    match test:
        case Flag(where) | Comparison(where):
            return replace(test, field=where.bound(env))
        case Combined(word, tests):
            return Combined(word, tuple([fields_bound(part, env) for part in tests]))
        case _:
            assert_never(test)


def fields_in(test: Test) -> Iterator[Field]:
    """Yield the fields that a test looks at."""
    match test:
        case Flag(where) | Comparison(where):
            yield where
        case Combined(_, tests):
            for part in tests:
                yield from fields_in(part)
        case _:
            assert_never(test)


def succeeds(test: Test, look: Look) -> bool:
    """Return whether the message passes the test; `Unreadable` if any of its fields is missing, or of another kind than expected."""
    match test:
        case Flag(where):
            value = look(where)
            if not isinstance(value, bool):
                raise Unreadable(f"{where} is {shown(value)}; expected true or false")
            return value
        case Comparison(where, operation, constant):
            value = without_nan(where, look(where))
            close = is_number(value) and is_number(constant) and abs(value - constant) <= TOLERANCE  # 0.8 in a float32 is not quite 0.8
            try:
                return bool(operate(operation, [constant if close else value, constant]))
            except Uncomputable as error:
                raise Unreadable(f"{where} is {shown(value)}, which cannot be compared with {shown(constant)}") from error
        case Combined(word, tests):
            found = [succeeds(part, look) for part in tests]  # of those that do not decide the fields are looked at as well
            return any(found) if word == "any" else all(found) is (word == "all")
        case _:
            assert_never(test)


# --- values --------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class FieldValue:
    """The value of a field, translated by a table if there is one."""

    field: Field
    table: Mapping[str, object] | None = None

    def value(self, look: Look) -> object:
        """Return the value; raise `Unreadable` if there is none, or it is not in the table."""
        value = look(self.field)
        if self.table is None:
            return value
        key = written(value)
        if key not in self.table:
            raise Unreadable(f"{self.field} is {shown(value)}, which is not in the table ({', '.join(self.table)})")
        return self.table[key]


def value_in(data: object, where: Field) -> object:
    """Return the value of a field of a message that is plain data; raise `Unreadable` if there is none."""
    for step in where.steps:
        match data, step:
            case dict(), str() if step in data:
                data = data[step]
            case list(), int() | Having():
                data = item(data, step, where, lambda inner, name: inner.get(name) if isinstance(inner, dict) else None)
            case _:
                raise Unreadable(f"there is no {where}")
    return data


def item(items: Sequence[Any], step: int | Having, where: Field, part: Callable[[Any, str], object]) -> Any:
    """Return the item of a list for a step of a field, given how to look at a field of an item; raise `Unreadable` if there is none."""
    if isinstance(step, int):
        if -len(items) <= step < len(items):
            return items[step]
        raise Unreadable(f"there is no {where}: the list has {len(items)} items")
    fitting = [one for one in items if written(part(one, step.name)) == step.value]
    if len(fitting) != 1:
        raise Unreadable(f"there is no {where}: {len(fitting) or 'none'} of the {len(items)} items has {step}")
    return fitting[0]


def written(value: object) -> str:
    """Write a value as the keys of a table are written."""
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.12g}" if isinstance(value, float) else str(value)


def without_nan(where: Field, value: object) -> object:
    """Return the value of a field; raise `Unreadable` if it is NaN."""
    if isinstance(value, float) and math.isnan(value):
        raise Unreadable(f"{where} is not a number (NaN)")
    return value


def shown(value: object) -> str:
    """Return a short text of a value for an error message."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
