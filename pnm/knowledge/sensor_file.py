"""Reads the file of sensors: which topics and services report which facts, numbers, objects and variables.

First come the fields of messages that are looked at, tables that translate their values, and tests: bindings of actions have them too.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from pnm.core.knowledge_base import parse_fluent
from pnm.core.logic.domain import FluentKind, Signature, Vocabulary
from pnm.core.logic.expressions import UNDEFINED, Fluent, Variable, is_number
from pnm.core.message_fields import Combined, Comparison, Field, FieldValue, Flag, Test, fields_in, parse_field
from pnm.errors import InputError, Position, located, suggestion
from pnm.files.yaml_keys import ANYTHING, TEXT, Keys, ref, written
from pnm.files.yaml_nodes import Mapped, Node, load_yaml, texts_in
from pnm.knowledge.sensor_model import VALUE, ByService, Sensing, Sensor, Statement, placeholders

_FIELD_TEST: Final = ref("fieldTest")
_TESTS: Final = ("not", "all", "any")


class TabledField(Keys, schema={"required": ["field"]}):
    """A field, and what its values mean."""

    field = written(TEXT, "a field such as status.code")
    table = written({"type": "object"}, "values of the field and what they mean")


class FieldComparison(Keys):
    """A field of a message, and what it is compared with."""

    field = written(TEXT, "a field such as status.code or poses[0].x, which is true or compared")
    eq = written(ANYTHING, "the field is equal to this")
    ne = written(ANYTHING, "the field is different from this")
    lt = written(ANYTHING, "the field is less than this")
    le = written(ANYTHING, "the field is at most this")
    gt = written(ANYTHING, "the field is more than this")
    ge = written(ANYTHING, "the field is at least this")
    contains = written(ANYTHING, "the field is a text or list that has this in it")


class FieldTest(FieldComparison, schema={"type": ["object", "null"], "minProperties": 1}):
    """A comparison of a field of a message with a constant, or several of them."""

    not_ = written(_FIELD_TEST, "the test fails")
    all_ = written({"type": "array", "items": _FIELD_TEST}, "all of the tests succeed")
    any_ = written({"type": "array", "items": _FIELD_TEST}, "at least one of the tests succeeds")


def read_field(entry: Mapped) -> Field:
    """Read the field under ``field``."""
    node = entry.node("field")
    if node is None:
        raise InputError("expected a field, such as pose.position.x", entry.start)
    return _field(node)


def _field(node: Node) -> Field:
    with located(node.position):
        field = parse_field(node.written)  # not the value of the YAML scalar, since `on` and `y` are true in YAML
    return field


def field_value(node: Node) -> FieldValue:
    """Read a field, or a field and a table of what its values mean."""
    if not node.is_mapping:
        return FieldValue(_field(node))
    entry = TabledField(node.mapped()).entry
    return FieldValue(read_field(entry), read_table(entry))


def read_number(entry: Mapped) -> FieldValue:
    """Read a field, and a table of numbers for its values if there is one."""
    table = read_table(entry)
    for name, value in (table or {}).items():
        if not is_number(value) or not math.isfinite(value):
            raise entry.section("table").needed(name).wrong(f"expected a number for {name!r}")
    return FieldValue(read_field(entry), table)


def read_object(entry: Mapped, types: tuple[str, ...], known: Vocabulary | None) -> FieldValue:
    """Read a field, and a table of objects of these types for its values if there is one."""
    table = read_table(entry)
    for name, value in (table or {}).items():
        node = entry.section("table").needed(name)
        if not isinstance(value, str):
            raise node.wrong(f"expected the name of an object for {name!r}, or {UNDEFINED}")
        if known is not None and value != UNDEFINED:
            known.check_object(value, types, node.position)
    return FieldValue(read_field(entry), table)


def read_table(entry: Mapped) -> dict[str, object] | None:
    """Read the table under ``table``, from values of a field to their meanings; None if there is none."""
    node = entry.node("table")
    if node is None:
        return None
    if not node.is_mapping or not node.mapped().nodes:
        raise node.wrong("expected values of the field and their meanings")
    return {name: value.plain() for name, _, value in node.mapped().entries()}


def read_test(entry: Mapped) -> Test:
    """Read the test of a message: a truth value under ``field``, a test under ``when``, or none, which every message passes."""
    test = entry.node("when")
    if test is None:
        return Flag(read_field(entry)) if "field" in entry.nodes else Combined("all")
    if "field" in entry.nodes:
        raise InputError("expected either 'field', which is true or false, or 'when'", entry.position("field"))
    return field_test(test)


def field_test(node: Node) -> Test:
    """Read a comparison of a field, or several combined by ``not``, ``all`` and ``any``."""
    if not node.is_mapping or not node.mapped().nodes:
        raise InputError("expected a test such as {field: percentage, ge: 0.8}", node.position)
    entry = FieldTest(node.mapped()).entry
    if "field" in entry.nodes:
        return _comparison(entry)
    if len(entry.nodes) > 1:
        raise InputError(f"expected one of {', '.join(_TESTS)}, or a field and how it compares", entry.start)
    ((key, _, inner),) = entry.entries()
    if key not in _TESTS:
        raise InputError(f"expected the field that is compared by {key!r}", entry.start)
    items = (inner,) if key == "not" else inner.items
    if items is None:
        raise inner.wrong(f"expected a list of tests under {key!r}")
    return Combined(key, tuple(map(field_test, items)))


def _comparison(entry: Mapped) -> Test:
    FieldComparison.check(entry)
    field = read_field(entry)
    comparisons = []
    for key, _, node in entry.entries():
        if key != "field":
            constant = node.plain()
            if constant is None or (isinstance(constant, float) and math.isnan(constant)):
                raise node.wrong(f"expected a value to compare {field} with")
            comparisons.append(Comparison(field, key, constant))
    return Combined("all", tuple(comparisons)) if len(comparisons) > 1 else comparisons[0] if comparisons else Flag(field)


# --- sensors --------------------------------------------------------------------------------------


EVERY: Final = 1.0
"""Seconds from an answer of a service to the next request, if there is no reason to ask before."""
NEVER: Final = "never"
"""In the place of these seconds: asked only when there is a reason."""
LIMIT: Final = 1.0
"""Seconds that a service may take to answer."""
_TYPE: Final = re.compile(r"[a-z][a-z0-9_]*/(msg|srv)/[A-Z][A-Za-z0-9]*")
_NAME: Final = re.compile(r"[~/]?[\w{}-]+(/[\w{}-]+)*", re.ASCII)
_VARIABLE: Final = re.compile(r"[A-Za-z][\w-]*", re.ASCII)
_OWN: Final = ("for", "facts", "variables", "stale", "lag", "type")


def read_sensing(path: Path, known: Vocabulary | None = None) -> Sensing:
    """Read a file of sensors, its names checked against the known ones if given; raise `InputError` where something is wrong."""
    return sensing_in(load_yaml(path), known)


def sensing_in(top: Mapped, known: Vocabulary | None = None) -> Sensing:
    """Return the sensors of a file that is loaded, as `read_sensing` does."""
    top.only("sensors", "stale")
    stale = _seconds(top, "stale")
    sensors = tuple(_Reader(entry, known, stale).sensor() for entry in top.sequence("sensors"))
    return Sensing(sensors, stale)


def _seconds(entry: Mapped, key: str, default: float | None = None) -> float | None:
    seconds = entry.number(key, default)
    if seconds == 0:
        raise InputError(f"expected more than 0 seconds under {key!r}", entry.position(key))
    return seconds


def _text(entry: Mapped, key: str, example: str) -> str:
    text = entry.string(key)
    if not text:
        raise InputError(f"expected something like {example} under {key!r}", entry.position(key))
    return text


@dataclass(frozen=True)
class _Reader:
    """Reads one sensor."""

    entry: Mapped
    known: Vocabulary | None
    stale: float | None

    def sensor(self) -> Sensor:
        entry = self.entry
        is_topic = "topic" in entry.nodes
        if is_topic is ("service" in entry.nodes):
            raise InputError("expected either a topic or a service", entry.start)
        key = "topic" if is_topic else "service"
        entry.only(key, *_OWN, *(() if is_topic else ("request", "every", "limit")))
        variables = self._variables(entry)
        service = None if is_topic else self._polled(variables)
        sensor = Sensor(
            self._name(key, variables, service),
            self._type("msg" if is_topic else "srv"),
            variables,
            (
                *(self._statement(item, variables) for item in entry.sequence("facts")),
                *(self._stored(item, variables) for item in entry.sequence("variables")),
            ),
            service,
            _seconds(entry, "stale", self.stale),
            # The answer to a request that was under way when an action ended may be old; the next one is not.
            entry.number("lag", None if service is None else 2.0 * service.limit),
            entry.start,
        )
        if not sensor.statements:
            raise InputError("the sensor says nothing; expected facts or variables", entry.start)
        return sensor

    # --- topic or service ---

    def _variables(self, entry: Mapped) -> tuple[Variable, ...]:
        node = entry.node("for")
        if node is None or node.is_null:
            return ()
        variables = []
        for name, where, kind in node.mapped().entries():
            if not _VARIABLE.fullmatch(name) or f"?{name}" == VALUE:
                raise InputError(f"{name!r} cannot name an object here; expected something like r", where)
            if kind.text is None:
                raise kind.wrong(f"expected the type of {name}")
            if self.known is not None:
                self.known.check_type(kind.text, kind.position)
            variables.append(Variable(f"?{name}", (kind.text,)))
        return tuple(variables)

    def _name(self, key: str, variables: tuple[Variable, ...], service: ByService | None) -> str:
        name, where = _text(self.entry, key, "/{robot}/battery"), self.entry.position(key)
        if not _NAME.fullmatch(name):
            raise InputError(f"not a name in ROS: {name!r}; expected something like /{{robot}}/battery", where)
        self._placeholders(name, variables, where)
        distinguished = {*placeholders(name), *(_terms(service.request) if service else ())}
        for variable in variables:
            if variable.name[1:] not in distinguished:
                also = " or the request" if service else ""
                raise InputError(f"expected {{{variable.name[1:]}}} in {name!r}{also}; otherwise all sensors hear the same", where)
        return name

    def _placeholders(self, pattern: str, variables: tuple[Variable, ...], where: Position) -> None:
        if "{" in re.sub(r"\{[^{}]*\}", "", pattern) or "}" in re.sub(r"\{[^{}]*\}", "", pattern):
            raise InputError(f"the braces in {pattern!r} do not match", where)
        for name in placeholders(pattern):
            self._variable(f"?{name}", variables, where)

    def _variable(self, name: str, variables: Iterable[Variable], where: Position) -> Variable:
        own = {variable.name: variable for variable in variables}
        if name not in own:
            expected = f"expected one of {', '.join(own)}" if own else "expected {name: type} there"
            raise InputError(f"{name} is not in 'for'; {suggestion(name, own) or expected}", where)
        return own[name]

    def _type(self, kind: str) -> str | None:
        name = self.entry.string("type")
        if name is not None and not ((match := _TYPE.fullmatch(name)) and match[1] == kind):
            example = "sensor_msgs/msg/BatteryState" if kind == "msg" else "std_srvs/srv/Trigger"
            raise InputError(f"not such a type: {name!r}; expected something like {example}", self.entry.position("type"))
        return name

    def _polled(self, variables: tuple[Variable, ...]) -> ByService:
        request = self.entry.plain("request")
        if request is not None and not isinstance(request, dict):
            raise InputError("expected the fields of the request and their values", self.entry.position("request"))
        for name in _terms(request):
            self._variable(f"?{name}", variables, self.entry.position("request"))
        node = self.entry.node("every")
        every = None if node is not None and node.text == NEVER else _seconds(self.entry, "every", EVERY)
        return ByService(request or {}, every, _seconds(self.entry, "limit", LIMIT) or LIMIT)

    # --- statements ---

    def _statement(self, entry: Mapped, around: tuple[Variable, ...]) -> Statement:
        own = self._variables(entry)
        variables = (*around, *own)
        kinds = [key for key in ("fact", "number", "object") if key in entry.nodes]
        if len(kinds) != 1:
            raise InputError("expected one of fact, number and object", entry.start)
        kind, where = kinds[0], entry.position(kinds[0])
        text = _text(entry, kind, "(battery ?r)")
        with located(where):
            fluent = parse_fluent(text)
        is_choice = kind == "fact" and VALUE in fluent
        for variable in own:
            if variable.name not in fluent:
                raise InputError(f"expected {variable.name} in {text}; otherwise all objects share one value", where)
        if kind == "fact" and not is_choice:
            entry.only("fact", "for", "field", "when")
            self._typed(fluent, FluentKind.FACT, variables, where)
            test = read_test(entry)
            self._fields(fields_in(test), variables, entry.position("when" if "when" in entry.nodes else "field"))
            return Statement(fluent, test, where, own)
        entry.only(kind, "for", "field", "table")
        self._fields([read_field(entry)], variables, entry.position("field"))
        if kind == "number":
            self._typed(fluent, FluentKind.NUMBER, variables, where)
            return Statement(fluent, read_number(entry), where, own)
        signature = self._typed(fluent, FluentKind.FACT if is_choice else FluentKind.OBJECT, variables, where)
        if fluent.count(VALUE) > 1:
            raise InputError(f"{VALUE} is there twice; expected it once", where)
        types: tuple[str, ...] = ("object",)
        if signature:
            types = signature.parameters[fluent.index(VALUE) - 1] if is_choice else signature.values
        return Statement(fluent, read_object(entry, types, self.known), where, own, types)

    def _fields(self, fields: Iterable[Field], variables: tuple[Variable, ...], where: Position) -> None:
        for name in (name for field in fields for name in field.variables):
            self._variable(name, variables, where)

    def _stored(self, entry: Mapped, around: tuple[Variable, ...]) -> Statement:
        entry.only("name", "for", "field", "table")
        own = self._variables(entry)
        variables = (*around, *own)
        name, where = _text(entry, "name", "{r}_zone"), entry.position("name")
        self._placeholders(name, variables, where)
        for variable in variables:
            if variable.name[1:] not in placeholders(name):
                raise InputError(f"expected {{{variable.name[1:]}}} in {name!r}; otherwise all objects share one variable", where)
        field, table = read_field(entry), None if entry.filled("table") is None else read_table(entry)
        self._fields([field], variables, entry.position("field"))
        return Statement(name, FieldValue(field, table), where, own)

    def _typed(self, fluent: Fluent, kind: FluentKind, variables: tuple[Variable, ...], where: Position) -> Signature | None:
        """Check the names of a fluent and return its signature, if that is known."""
        named = [term for term in fluent[1:] if term[0] == "?" and (term != VALUE or kind is not FluentKind.FACT)]
        types = {term: self._variable(term, variables, where).types[0] for term in named}
        if self.known is None:
            return None
        signature = self.known.check_kind(fluent[0], kind, where)
        if len(signature.parameters) != len(fluent) - 1:
            raise InputError(f"{fluent[0]} takes {len(signature.parameters)} arguments, found {len(fluent) - 1}", where)
        for term, needed in zip(fluent[1:], signature.parameters, strict=True):
            if term in types and self.known.types[types[term]].isdisjoint(needed):
                raise InputError(f"{term} is a {types[term]}; {fluent[0]} takes a {' or '.join(needed)}", where)
            if term[0] != "?":
                self.known.check_object(term, needed, where)
        return signature


def _terms(source: object) -> Iterable[str]:
    """Yield the variables, without ``?``, that fields of a request are filled from."""
    return (text[1:] for text in texts_in(source) if text.startswith("?"))
