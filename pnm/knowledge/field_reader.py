"""Reads which fields of messages a sensor looks at: fields, tables that translate their values, and tests."""

from __future__ import annotations

import math
from typing import Final

from pnm.core.logic.domain import Vocabulary
from pnm.core.logic.expressions import UNDEFINED, is_number
from pnm.core.message_fields import Combined, Comparison, Field, FieldValue, Flag, Test, parse_field
from pnm.errors import InputError, located
from pnm.files.yaml_keys import ANYTHING, TEXT, Keys, ref, written
from pnm.files.yaml_nodes import Mapped, Node

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
