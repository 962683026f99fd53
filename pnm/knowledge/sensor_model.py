"""What messages and responses say about the world: facts, numbers, objects and variables; read from a file, without code.

A *sensor* is a topic that is listened to, or a service that is asked again and again. It speaks of some fluents and
variables and replaces only these. What it says cannot always be understood: then that part is unknown, and the reason is told.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import product
from typing import Final, TypeAlias, assert_never

from pnm.core.logic.declared_names import Signature
from pnm.core.logic.expressions import UNDEFINED, UNKNOWN, Fluent, Unknown, Value, Variable, bind, fluent_text
from pnm.errors import InputError, Position
from pnm.knowledge.message_fields import FieldValue, Look, Test, Unreadable, shown, succeeds, without_nan

VALUE: Final = "?value"
"""In a fact: the object that the field names; the fact holds with this one and with no other."""

Objects: TypeAlias = Callable[[tuple[str, ...]], tuple[str, ...]]
"""Returns the objects of any of the types."""


# --- what sensors say ----------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Fact:
    """The fact is so when the test succeeds."""

    fluent: Fluent
    test: Test
    position: Position = field(compare=False)


@dataclass(frozen=True, slots=True)
class ExclusiveFact:
    """Of the facts that the fluent stands for, with `VALUE` for any object of the types, the one with the named object is so."""

    fluent: Fluent
    source: FieldValue
    types: tuple[str, ...]
    position: Position = field(compare=False)


@dataclass(frozen=True, slots=True)
class Number:
    """The function has the number for its value."""

    fluent: Fluent
    source: FieldValue
    position: Position = field(compare=False)


@dataclass(frozen=True, slots=True)
class Object:
    """The function has the named object of these types for its value."""

    fluent: Fluent
    source: FieldValue
    types: tuple[str, ...]
    position: Position = field(compare=False)


@dataclass(frozen=True, slots=True)
class Stored:
    """The variable, in whose name ``{r}`` stands for an object, has the value."""

    name: str
    source: FieldValue
    position: Position = field(compare=False)


Statement: TypeAlias = Fact | ExclusiveFact | Number | Object | Stored


@dataclass(frozen=True, slots=True)
class ByTopic:
    """Listened to."""


@dataclass(frozen=True, slots=True)
class ByService:
    """Asked, and asked again so many seconds after it has answered or failed to."""

    request: Mapping[str, object]
    """Fields; ``?r`` stands for an object."""
    every: float
    limit: float


@dataclass(frozen=True, slots=True)
class Sensor:
    """Topics, or services, of one kind: one for every choice of objects for the variables."""

    name: str
    """Of the topic or service, in which ``{r}`` stands for the object of the variable ``?r``."""
    type: str | None
    """Found from the ROS graph if None."""
    variables: tuple[Variable, ...]
    statements: tuple[Statement, ...]
    way: ByTopic | ByService
    stale: float | None
    """Seconds without a report after which all of it is unknown."""
    lag: float | None
    """Seconds that its reports may be late; as the bindings say if None."""
    position: Position = field(compare=False)


@dataclass(frozen=True, slots=True)
class Sensing:
    """All sensors of a file."""

    sensors: tuple[Sensor, ...] = ()
    stale: float | None = None
    """Seconds after which that is unknown which is no longer reported on ``knowledge/sensed``."""
    signatures: Mapping[str, Signature] = field(default_factory=dict)
    """How predicates and functions are used, as far as that is known."""

    @property
    def names(self) -> frozenset[str]:
        """The predicates and functions that sensors speak of."""
        return frozenset(one.fluent[0] for sensor in self.sensors for one in sensor.statements if not isinstance(one, Stored))

    def lags(self, otherwise: float) -> dict[str, float]:
        """Return how many seconds late the slowest sensor of each predicate and function may report."""
        found: dict[str, float] = {}
        for sensor in self.sensors:
            for one in sensor.statements:
                if not isinstance(one, Stored):
                    found[one.fluent[0]] = max(found.get(one.fluent[0], 0.0), otherwise if sensor.lag is None else sensor.lag)
        return found


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

    def request(self, way: ByService) -> dict[str, object]:
        """Return what a service is asked with."""
        return {name: _resolved(value, self.env) for name, value in way.request.items()}


@dataclass(frozen=True, slots=True)
class Reading:
    """What one message says."""

    facts: dict[Fluent, Value | Unknown]
    variables: dict[str, object]
    """None for one that is unknown."""
    unread: dict[int, str]
    """Which of the sensor's statements could not be understood, and why."""


def instances(sensing: Sensing, objects: Objects) -> tuple[Instance, ...]:
    """Return all sensors that there are with these objects.

    Raises:
        InputError: two of them speak of the same.
    """
    found = tuple(Instance(sensor, env) for sensor in sensing.sensors for env in _choices(sensor, objects))
    speaks: dict[Fluent | str, Statement] = {}
    for instance in found:
        for statement in instance.sensor.statements:
            for one in _subjects(statement, instance.env, objects):
                if one in speaks:
                    other = speaks[one].position
                    what = one if isinstance(one, str) else fluent_text(one)
                    raise InputError(f"{what} is sensed in line {other.line} as well; expected one sensor for it", statement.position)
                speaks[one] = statement
    return found


def _choices(sensor: Sensor, objects: Objects) -> Iterator[Mapping[str, str]]:
    names = [variable.name for variable in sensor.variables]
    for chosen in product(*(objects(variable.types) for variable in sensor.variables)):
        yield dict(zip(names, chosen, strict=True))


def _subjects(statement: Statement, env: Mapping[str, str], objects: Objects) -> Iterator[Fluent | str]:
    match statement:
        case Stored(name):
            yield filled(name, env)
        case ExclusiveFact(fluent, _, types):
            for one in objects(types):
                yield bind(fluent, {**env, VALUE: one})
        case Fact(fluent) | Number(fluent) | Object(fluent):
            yield bind(fluent, env)
        case _:
            assert_never(statement)


def read(instance: Instance, look: Look, objects: Objects) -> Reading:
    """Return what a message says to a sensor; what cannot be understood is unknown."""
    reading = Reading({}, {}, {})
    for number, statement in enumerate(instance.sensor.statements):
        try:
            _note(statement, instance.env, look, objects, reading)
        except Unreadable as error:
            reading.unread[number] = str(error)
            _doubt(statement, instance.env, objects, reading)
    return reading


def unknown(instance: Instance, objects: Objects) -> Reading:
    """Return that nothing is known of all that the sensor speaks of."""
    reading = Reading({}, {}, {})
    for statement in instance.sensor.statements:
        _doubt(statement, instance.env, objects, reading)
    return reading


def _doubt(statement: Statement, env: Mapping[str, str], objects: Objects, reading: Reading) -> None:
    for one in _subjects(statement, env, objects):
        if isinstance(one, str):
            reading.variables[one] = None
        else:
            reading.facts[one] = UNKNOWN


def _note(statement: Statement, env: Mapping[str, str], look: Look, objects: Objects, reading: Reading) -> None:
    match statement:
        case Fact(fluent, test):
            reading.facts[bind(fluent, env)] = succeeds(test, look)
        case ExclusiveFact(fluent, source, types):
            chosen = _object(source, types, look, objects)
            for one in objects(types):
                reading.facts[bind(fluent, {**env, VALUE: one})] = one == chosen
        case Number(fluent, source):
            reading.facts[bind(fluent, env)] = _number(source, look)
        case Object(fluent, source, types):
            reading.facts[bind(fluent, env)] = _object(source, types, look, objects)
        case Stored(name, source):
            reading.variables[filled(name, env)] = source.value(look)
        case _:
            assert_never(statement)


def _object(source: FieldValue, types: tuple[str, ...], look: Look, objects: Objects) -> str:
    found = source.value(look)
    if isinstance(found, str) and (found == UNDEFINED or found in objects(types)):
        return found
    raise Unreadable(f"{source.field} is {shown(found)}, which is no object of type {' or '.join(types)}")


def _number(source: FieldValue, look: Look) -> float:
    found = without_nan(source.field, source.value(look))
    if isinstance(found, bool) or not isinstance(found, int | float) or math.isinf(found):
        raise Unreadable(f"{source.field} is {shown(found)}; expected a finite number")
    return float(found)


# --- names with objects in them ------------------------------------------------------------

_PLACEHOLDER: Final = re.compile(r"\{([^{}]*)\}")


def placeholders(pattern: str) -> tuple[str, ...]:
    """Return the variables named in braces, without ``?``."""
    return tuple(_PLACEHOLDER.findall(pattern))


def filled(pattern: str, env: Mapping[str, str]) -> str:
    """Put the objects in the place of the variables in braces."""
    return _PLACEHOLDER.sub(lambda found: env[f"?{found[1]}"], pattern)


def _resolved(value: object, env: Mapping[str, str]) -> object:
    if isinstance(value, Mapping):
        return {name: _resolved(part, env) for name, part in value.items()}
    if isinstance(value, list):
        return [_resolved(part, env) for part in value]
    return env.get(value, value) if isinstance(value, str) else value
