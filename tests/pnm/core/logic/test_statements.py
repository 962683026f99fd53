"""Facts and numbers as texts: what is written is read, and the rest is refused."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from pnm.core.knowledge_base import parse_fluent, parse_statement, statement_text
from pnm.core.logic.expressions import Fluent, Value
from pnm.errors import InputError


@pytest.mark.parametrize(
    ("text", "statement"),
    [
        ("(at r1 kitchen)", (("at", "r1", "kitchen"), True)),
        ("  ( at\tr1\n kitchen ) ", (("at", "r1", "kitchen"), True)),
        ("(ready)", (("ready",), True)),
        ("(not (at r1 kitchen))", (("at", "r1", "kitchen"), False)),
        ("( not ( ready ) )", (("ready",), False)),
        ("(= (battery r1) 80)", (("battery", "r1"), 80.0)),
        ("(= (offset) -1.5e1)", (("offset",), -15.0)),
        ("(= (place-of r1) hall)", (("place-of", "r1"), "hall")),
        ("(= (battery r1) 0)", (("battery", "r1"), 0.0)),
        ("(= (battery r1) .5)", (("battery", "r1"), 0.5)),
        ("(= (place-of r1) nan)", (("place-of", "r1"), "nan")),
        ("(= (place-of r1) infinity)", (("place-of", "r1"), "infinity")),
    ],
)
def test_statements(text: str, statement: tuple[Fluent, Value]) -> None:
    assert parse_statement(text) == statement
    assert type(parse_statement(text)[1]) is type(statement[1])


@pytest.mark.parametrize(
    ("text", "refused"),
    [
        ("", ""),
        ("at r1", "at r1"),
        ("()", "()"),
        ("(at r1", "(at r1"),
        ("(at r1))", "(at r1))"),
        ("(at (r1))", "(at (r1))"),
        ("(p) (q)", "(p) (q)"),
        ("(not (not (p)))", "(not (p))"),
        ("(not (p) (q))", "(p) (q)"),
        ("(= (at (r1)) 1)", "(at (r1))"),
        ("(= (n) 1 2)", "(= (n) 1 2)"),
        ("(and (p) (q))", "(and (p) (q))"),
    ],
)
def test_what_is_no_statement_is_refused(text: str, refused: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_statement(text)
    assert str(caught.value) == f"not a fact: {refused!r}; expected something like (at r1 kitchen)"


FLUENTS: st.SearchStrategy[Fluent] = st.lists(st.text("ab-1_?", min_size=1, max_size=4), min_size=1, max_size=4).map(tuple)


@given(FLUENTS, st.one_of(st.booleans(), st.floats(-1e6, 1e6).map(lambda value: round(value, 3)), st.just("hall")))
def test_a_statement_that_is_written_is_read(fluent: Fluent, value: Value) -> None:
    assert parse_statement(statement_text(fluent, value)) == (fluent, value)
    assert parse_fluent(statement_text(fluent, True)) == fluent


@given(st.text("()=not 1ab", max_size=30))
def test_any_text_is_a_statement_or_refused(text: str) -> None:
    try:
        fluent, _ = parse_statement(text)
    except InputError:
        return
    assert fluent
    assert all(fluent)
