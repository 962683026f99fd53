"""Sensor models: how the messages of topics and the responses of services become facts, numbers, objects and variables.

A *sensor* is a subscribed topic, or a service that is asked. It reports some fluents and
variables, and replaces only these. Parts of a message that cannot be interpreted make their fluents unknown, with a reason.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Final, TypeAlias, assert_never

from pnm.core.logic.expressions import UNDEFINED, UNKNOWN, Fluent, Unknown, Value, Variable, bind, fluent_text
from pnm.core.message_fields import FieldValue, Look, Test, Unreadable, fields_bound, shown, succeeds, without_nan
from pnm.errors import InputError, Position

VALUE: Final = "?value"
"""In a fact: the object that the field names; the fact holds for this object and for no other."""
Objects: TypeAlias = Callable[[tuple[str, ...]], tuple[str, ...]]
"""Returns the objects of any of the types."""


# --- statements ----------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Fact:
    """A fact that holds when the test succeeds."""

    fluent: Fluent
    test: Test
    position: Position = field(compare=False)
    variables: tuple[Variable, ...] = ()


@dataclass(frozen=True, slots=True)
class ExclusiveFact:
    """A family of facts of which one holds: with the named object of these types in the place of `VALUE`."""

    fluent: Fluent
    source: FieldValue
    types: tuple[str, ...]
    position: Position = field(compare=False)
    variables: tuple[Variable, ...] = ()


@dataclass(frozen=True, slots=True)
class Number:
    """A function whose value is the number in the field."""

    fluent: Fluent
    source: FieldValue
    position: Position = field(compare=False)
    variables: tuple[Variable, ...] = ()


@dataclass(frozen=True, slots=True)
class Object:
    """A function whose value is the object of these types that the field names."""

    fluent: Fluent
    source: FieldValue
    types: tuple[str, ...]
    position: Position = field(compare=False)
    variables: tuple[Variable, ...] = ()


@dataclass(frozen=True, slots=True)
class Stored:
    """A variable whose value is that of the field; in its name ``{r}`` stands for an object."""

    name: str
    source: FieldValue
    position: Position = field(compare=False)
    variables: tuple[Variable, ...] = ()


Statement: TypeAlias = Fact | ExclusiveFact | Number | Object | Stored
"""With variables of its own there is one for every choice of objects for these."""


@dataclass(frozen=True, slots=True)
class ByService:
    """Read by asking a service: at the start, after every action, before a new plan is made, and `every` seconds after its last answer."""

    request: Mapping[str, object]
    """Fields; ``?r`` stands for an object."""
    every: float | None
    """None for not without a reason."""
    limit: float
    """Seconds that an answer may take."""


@dataclass(frozen=True, slots=True)
class Sensor:
    """Topics or services of one kind: one for every choice of objects for the variables."""

    name: str
    """The name of the topic or service, in which ``{r}`` stands for the object of the variable ``?r``."""
    type: str | None
    """Found from the ROS graph if None."""
    variables: tuple[Variable, ...]
    statements: tuple[Statement, ...]
    service: ByService | None
    """How it is asked; None for a topic, which is subscribed to."""
    stale: float | None
    """Seconds without a message, or for which a request is not answered, after which all its fluents are unknown."""
    lag: float | None
    """Seconds that its reports may be late; None for the lag of the bindings."""
    position: Position = field(compare=False)

    def lag_or(self, otherwise: float) -> float:
        """Return the lag in seconds, given that of the bindings."""
        return otherwise if self.lag is None else self.lag


@dataclass(frozen=True, slots=True)
class Sensing:
    """All sensors of a file."""

    sensors: tuple[Sensor, ...] = ()
    stale: float | None = None
    """Seconds after which names that are no longer reported on ``knowledge/sensed`` become unknown."""

    @property
    def names(self) -> frozenset[str]:
        """The predicates and functions that sensors report."""
        return frozenset(self.lags(0.0))

    def lags(self, otherwise: float) -> dict[str, float]:
        """Return the lag in seconds of the slowest sensor of each predicate and function."""
        lags: dict[str, float] = {}
        for sensor in self.sensors:
            for statement in sensor.statements:
                if not isinstance(statement, Stored):
                    name = statement.fluent[0]
                    lags[name] = max(lags.get(name, 0.0), sensor.lag_or(otherwise))
        return lags


NO_SENSING: Final = Sensing()


@dataclass(frozen=True, slots=True)
class Instance:
    """A sensor for one choice of objects."""

    sensor: Sensor
    env: Mapping[str, str]

    @property
    def name(self) -> str:
        """The name of its topic or service; names in ROS have no hyphens, names in PDDL often do."""
        return filled(self.sensor.name, self.env).replace("-", "_")

    def request(self, service: ByService) -> dict[str, object]:
        """Return the fields of the request to a service."""
        return {name: _resolved(value, self.env) for name, value in service.request.items()}


@dataclass(frozen=True, slots=True)
class Reading:
    """The interpretation of one message."""

    facts: dict[Fluent, Value | Unknown]
    variables: dict[str, object]
    """None for one that is unknown."""
    unread: dict[int, str]
    """The statements of the sensor that could not be interpreted, by position, with the reason."""


def instances(sensing: Sensing, objects: Objects) -> tuple[Instance, ...]:
    """Return the sensors for all choices of objects; raise `InputError` if two of them report the same fluent or variable."""
    sensors = []
    for sensor in sensing.sensors:
        for env in _choices(sensor.variables, objects):
            statements = [_bound(part, {**env, **own}) for part in sensor.statements for own in _choices(part.variables, objects)]
            sensors.append(Instance(replace(sensor, statements=tuple(statements)), env))
    reported_by: dict[Fluent | str, Statement] = {}
    for instance in sensors:
        for statement in instance.sensor.statements:
            for subject in _subjects(statement, instance.env, objects):
                if subject in reported_by:
                    other = reported_by[subject].position
                    what = subject if isinstance(subject, str) else fluent_text(subject)
                    raise InputError(f"{what} is sensed in line {other.line} as well; expected one sensor for it", statement.position)
                reported_by[subject] = statement
    return tuple(sensors)


def _choices(variables: tuple[Variable, ...], objects: Objects) -> Iterator[dict[str, str]]:
    for chosen in product(*(objects(variable.types) for variable in variables)):
        yield dict(zip((variable.name for variable in variables), chosen, strict=True))


def _bound(statement: Statement, env: Mapping[str, str]) -> Statement:
    match statement:
        case Fact(fluent, test):
            return replace(statement, fluent=bind(fluent, env), test=fields_bound(test, env), variables=())
        case Stored(name, source):
            return replace(statement, name=filled(name, env), source=replace(source, field=source.field.bound(env)), variables=())
        case ExclusiveFact(fluent, source) | Number(fluent, source) | Object(fluent, source):
            return replace(statement, fluent=bind(fluent, env), source=replace(source, field=source.field.bound(env)), variables=())
        case _:
            assert_never(statement)


def _subjects(statement: Statement, env: Mapping[str, str], objects: Objects) -> Iterator[Fluent | str]:
    match statement:
        case Stored(name):
            yield filled(name, env)
        case ExclusiveFact(fluent, _, types):
            for name in objects(types):
                yield bind(fluent, {**env, VALUE: name})
        case Fact(fluent) | Number(fluent) | Object(fluent):
            yield bind(fluent, env)
        case _:
            assert_never(statement)


def read(instance: Instance, look: Look, objects: Objects) -> Reading:
    """Interpret a message; fluents of statements that cannot be interpreted are unknown."""
    reading = Reading({}, {}, {})
    for number, statement in enumerate(instance.sensor.statements):
        try:
            _interpret(statement, instance.env, look, objects, reading)
        except Unreadable as error:
            reading.unread[number] = str(error)
            _set_unknown(statement, instance.env, objects, reading)
    return reading


def unknown(instance: Instance, objects: Objects) -> Reading:
    """Return the reading in which all fluents and variables of the sensor are unknown."""
    reading = Reading({}, {}, {})
    for statement in instance.sensor.statements:
        _set_unknown(statement, instance.env, objects, reading)
    return reading


def _set_unknown(statement: Statement, env: Mapping[str, str], objects: Objects, reading: Reading) -> None:
    for subject in _subjects(statement, env, objects):
        if isinstance(subject, str):
            reading.variables[subject] = None
        else:
            reading.facts[subject] = UNKNOWN


def _interpret(statement: Statement, env: Mapping[str, str], look: Look, objects: Objects, reading: Reading) -> None:
    match statement:
        case Fact(fluent, test):
            reading.facts[bind(fluent, env)] = succeeds(test, look)
        case ExclusiveFact(fluent, source, types):
            chosen = _object(source, types, look, objects)
            for name in objects(types):
                reading.facts[bind(fluent, {**env, VALUE: name})] = name == chosen
        case Number(fluent, source):
            value = without_nan(source.field, source.value(look))
            if isinstance(value, bool) or not isinstance(value, int | float) or math.isinf(value):
                raise Unreadable(f"{source.field} is {shown(value)}; expected a finite number")
            reading.facts[bind(fluent, env)] = float(value)
        case Object(fluent, source, types):
            reading.facts[bind(fluent, env)] = _object(source, types, look, objects)
        case Stored(name, source):
            reading.variables[filled(name, env)] = source.value(look)
        case _:
            assert_never(statement)


def _object(source: FieldValue, types: tuple[str, ...], look: Look, objects: Objects) -> str:
    """Return the object that a field names; a table is needed only for values that are no names of objects."""
    value, known = look(source.field), objects(types)
    if not (source.table is not None and isinstance(value, str) and value in known and value not in source.table):
        value = source.value(look)
    if isinstance(value, str) and (value == UNDEFINED or value in known):
        return value
    raise Unreadable(f"{source.field} is {shown(value)}, which is no object of type {' or '.join(types)}")


# --- names with objects in them ------------------------------------------------------------

_PLACEHOLDER: Final = re.compile(r"\{([^{}]*)\}")


def placeholders(pattern: str) -> tuple[str, ...]:
    """Return the variables named in braces, without ``?``."""
    return tuple(_PLACEHOLDER.findall(pattern))


def filled(pattern: str, env: Mapping[str, str]) -> str:
    """Put the objects in the place of those variables in braces that have one."""
    return _PLACEHOLDER.sub(lambda placeholder: env.get(f"?{placeholder[1]}", placeholder[0]), pattern)


def _resolved(value: object, env: Mapping[str, str]) -> object:
    if isinstance(value, Mapping):
        return {name: _resolved(part, env) for name, part in value.items()}
    if isinstance(value, list):
        return [_resolved(part, env) for part in value]
    return env.get(value, value) if isinstance(value, str) else value
