"""Damaged files: whatever a person does to a good file, it is read or refused with a place; nothing else is ever raised."""

from __future__ import annotations

from hypothesis import example, given, strategies as st

from pnm.language.plan import parse_plans
from tests.support.files import input_error
from tests.support.yaml.damage import WORDS, damaged
from tests.support.yaml.examples import PAPER_DOMAIN, PAPER_PLAN, PDDL, RECIPES, RECOVERING

GOOD = (PDDL, RECIPES, RECOVERING)
MARKS = (*WORDS, ":", "-", "[", "]", "{", "}", "'", '"', "&a ", "*a", "\t", "---\n", "...\n")


@given(st.data(), st.sampled_from(GOOD))
def test_damaged_trees_are_read_or_refused_with_a_place(data: st.DataObject, text: str) -> None:
    check(damaged(data, text))


@given(st.data(), st.sampled_from((*GOOD, PAPER_DOMAIN, PAPER_PLAN)))
@example(None, "...\n- not:\n a")  # type: ignore[arg-type]
def test_damaged_texts_are_read_or_refused_with_a_place(data: st.DataObject | None, text: str) -> None:
    for _ in range(3 if data else 0):
        assert data is not None
        start = data.draw(st.integers(0, len(text)))
        end = data.draw(st.integers(start, min(len(text), start + 12)))
        text = text[:start] + data.draw(st.sampled_from(MARKS)) + text[end:]
    check(text)


def check(text: str) -> None:
    error = input_error(lambda: parse_plans(text, "F"))
    assert error is None or (error.position is not None and str(error).startswith("F:")), error
