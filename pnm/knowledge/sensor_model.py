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
from typing import Final, TypeAlias

from pnm.core.logic.expressions import UNDEFINED, UNKNOWN, Fluent, Unknown, Value, Variable, bind, fluent_text
from pnm.core.message_fields import FieldValue, Look, Test, Unreadable, fields_bound, shown, succeeds, without_nan
from pnm.errors import InputError, Position

VALUE: Final = "?value"
"""In a fact: the object that the field names; the fact holds for this object and for no other."""
Objects: TypeAlias = Callable[[tuple[str, ...]], tuple[str, ...]]
"""Returns the objects of any of the types."""


@dataclass(frozen=True, slots=True)
class Statement:
    """A statement of what a message says. With variables of its own there is one for every choice of objects for these.

    Args:
        subject: a fact, or a function with its arguments; or the name of a variable, in which ``{r}`` stands for an object. A fact with
            `VALUE` is a family of which one holds: with the named object in its place.
        source: a test for a fact that holds when it succeeds; a field with the value of anything else.
        types: of the objects that the field names; None for the number of a function, and for a variable.
    """

    subject: Fluent | str
    source: Test | FieldValue
    position: Position = field(compare=False)
    variables: tuple[Variable, ...] = ()
    types: tuple[str, ...] | None = None

    def __str__(self) -> str:
        return self.subject if isinstance(self.subject, str) else fluent_text(self.subject)

    def bound(self, env: Mapping[str, str]) -> Statement:
        """Return it with objects in the place of variables."""
        subject = filled(self.subject, env) if isinstance(self.subject, str) else bind(self.subject, env)
        if isinstance(self.source, FieldValue):
            return replace(self, subject=subject, source=replace(self.source, field=self.source.field.bound(env)), variables=())
        return replace(self, subject=subject, source=fields_bound(self.source, env), variables=())

    def subjects(self, objects: Objects) -> tuple[Fluent | str, ...]:
        """Return all that it is about."""
        if isinstance(self.subject, str) or VALUE not in self.subject:
            return (self.subject,)
        return tuple([bind(self.subject, {VALUE: name}) for name in objects(self.types or ())])


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
                if not isinstance(statement.subject, str):
                    name = statement.subject[0]
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
            statements = [part.bound({**env, **own}) for part in sensor.statements for own in _choices(part.variables, objects)]
            sensors.append(Instance(replace(sensor, statements=tuple(statements)), env))
    reported_by: dict[Fluent | str, Statement] = {}
    for instance in sensors:
        for statement in instance.sensor.statements:
            for subject in statement.subjects(objects):
                if subject in reported_by:
                    other = reported_by[subject].position
                    what = subject if isinstance(subject, str) else fluent_text(subject)
                    raise InputError(f"{what} is sensed in line {other.line} as well; expected one sensor for it", statement.position)
                reported_by[subject] = statement
    return tuple(sensors)


def _choices(variables: tuple[Variable, ...], objects: Objects) -> Iterator[dict[str, str]]:
    for chosen in product(*(objects(variable.types) for variable in variables)):
        yield dict(zip((variable.name for variable in variables), chosen, strict=True))


def read(instance: Instance, look: Look, objects: Objects) -> Reading:
    """Interpret a message; fluents of statements that cannot be interpreted are unknown."""
    reading = Reading({}, {}, {})
    for number, statement in enumerate(instance.sensor.statements):
        try:
            _interpret(statement, look, objects, reading)
        except Unreadable as error:
            reading.unread[number] = str(error)
            _set_unknown(statement, objects, reading)
    return reading


def unknown(instance: Instance, objects: Objects) -> Reading:
    """Return the reading in which all fluents and variables of the sensor are unknown."""
    reading = Reading({}, {}, {})
    for statement in instance.sensor.statements:
        _set_unknown(statement, objects, reading)
    return reading


def _set_unknown(statement: Statement, objects: Objects, reading: Reading) -> None:
    for subject in statement.subjects(objects):
        if isinstance(subject, str):
            reading.variables[subject] = None
        else:
            reading.facts[subject] = UNKNOWN


def _interpret(statement: Statement, look: Look, objects: Objects, reading: Reading) -> None:
    subject, source, types = statement.subject, statement.source, statement.types
    if isinstance(subject, str):
        reading.variables[subject] = source.value(look) if isinstance(source, FieldValue) else succeeds(source, look)
    elif not isinstance(source, FieldValue):
        reading.facts[subject] = succeeds(source, look)
    elif types is None:
        value = without_nan(source.field, source.value(look))
        if isinstance(value, bool) or not isinstance(value, int | float) or math.isinf(value):
            raise Unreadable(f"{source.field} is {shown(value)}; expected a finite number")
        reading.facts[subject] = float(value)
    elif VALUE in subject:
        chosen = _object(source, types, look, objects)
        reading.facts.update({bind(subject, {VALUE: name}): name == chosen for name in objects(types)})
    else:
        reading.facts[subject] = _object(source, types, look, objects)


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
