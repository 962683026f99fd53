"""Answers of people: by whichever way one comes, it is the same value, and a condition reads it in the same way."""

from __future__ import annotations

import asyncio
from pathlib import Path
from uuid import UUID

import pytest
from hypothesis import example, given, strategies as st

from planner_bridge.pipeline.carry_out import carry_out
from pnm.core.logic.computed_values import Layer, Question, Uncomputable, operate
from pnm.knowledge.people import ScriptedAnswers, TerminalSource
from pnm.knowledge.source import Asker, SourceError
from pnm.knowledge.sources import Sources
from tests.support.files import written
from tests.support.logic.people import DelayedSource, Person, TerminalUser, about, run_questions

ME = Asker(UUID(int=7), "tour", UUID(int=1))
GO = about("go", Layer.PERSON, "Go on?")
CLOSED = about("go", Layer.PERSON, {"text": "Go on?", "answers": ["yes", "no", 3]})
NO = ("no", "No.", "false", "off")
YES = ("yes", " YES", "true", "on")
PLAN = """
actions: {{move: {{params: [to]}}, note: {{type: kb_action}}}}
plan:
  - note: {{operation: {{LocalUpdate: [go, {{PersonQuery: [go, {question}]}}]}}}}
  - {conditions}
"""


async def over_the_page(question: Question, text: str) -> object:
    """Answer a question that somebody else is asked."""
    person = Person()
    sources = Sources([], person)
    asking = asyncio.ensure_future(sources.query(question, ME))
    await person.asked.get()
    try:
        assert sources.answer(UUID(int=1), text)
    except SourceError:
        asking.cancel()
        raise
    return await asking


def outcome(answering: object) -> object:
    try:
        return run_questions(answering)  # type: ignore[arg-type]
    except SourceError as error:
        return str(error)


@given(st.one_of(st.text(max_size=12), st.from_regex(r"\A(no|yes|-?[0-9.e]{1,5}|\[1, ?2|\"5\")\Z")), st.sampled_from([GO, CLOSED]))
@example("no", GO)
@example("No.", CLOSED)
@example('"5', GO)
def test_an_answer_is_the_same_in_a_rehearsal_and_on_the_page(text: str, question: Question) -> None:
    rehearsed = outcome(ScriptedAnswers([("go", text)], DelayedSource()).query(question, ME))
    assert outcome(over_the_page(question, text)) == rehearsed


def test_who_answers_something_else_is_told_the_answers(person: TerminalUser) -> None:
    async def typed() -> object:
        asking = asyncio.ensure_future(TerminalSource(person.answers, person.shown).query(CLOSED, ME))
        await person.sees("Go on? ")
        person.types("perhaps\n")
        await person.sees("expected yes or no or 3, found 'perhaps'; once more:")
        person.types("NO!\n")
        return await asking

    assert run_questions(typed(), virtual=False) == "no"


AS_A_TEXT = (
    "{Comparison: [eq, [LocalQuery: go, yes]]}",
    '{Comparison: [eq, [LocalQuery: go, "yes"]]}',
    "{Comparison: [ne, [LocalQuery: go, no]]}",
    "{not: {Comparison: [eq, [LocalQuery: go, 'no']]}}",
)
AS_A_TRUTH = (
    "{Comparison: [eq, [LocalQuery: go, true]]}",
    "{BooleanAssertion: [{LocalQuery: go}, true]}",
    "{not: {BooleanAssertion: [{LocalQuery: go}, false]}}",
    "{LocalQuery: go}",
    "{not: {not: {LocalQuery: go}}}",
)
"""Ways to ask whether a person has said yes: any for a question that names its answers, those of a truth value for all others."""


@pytest.mark.parametrize(
    ("question", "conditions", "said"),
    [
        *(('{text: "Go on?", answers: [yes, no]}', (*AS_A_TEXT, *AS_A_TRUTH), said) for said in ("no", "No.", "yes", " YES")),
        *(('"Go on?"', AS_A_TRUTH, said) for said in (*YES, *NO)),
        *(('"Go on?"', AS_A_TEXT, said) for said in ("no", "yes")),
    ],
)
def test_whoever_says_no_stops_the_robot_however_the_plan_asks(
    tmp_path: Path, question: str, conditions: tuple[str, ...], said: str
) -> None:
    asked = "\n  - ".join(f"if: {condition}\n    then: [move: {{to: r{number}}}]" for number, condition in enumerate(conditions))
    plan = written(tmp_path, PLAN.format(question=question, conditions=asked))
    result = carry_out(plan, None, {}, answers=[("go", said)])
    moved = [call for call in result.calls if call.call.action.name == "move" and call.attempts]
    assert len(moved) == (len(conditions) if said in YES else 0)


@pytest.mark.parametrize(
    ("operator", "operands", "value"),
    [
        ("eq", ["no", False], True),
        ("eq", [False, " No"], True),
        ("ne", ["yes", True], False),
        ("eq", ["perhaps", True], False),
        ("eq", ["5", 5], True),
        ("ge", ["18.5", 18], True),
        ("lt", [2, "10"], True),
        ("eq", ["9007199254740993", 9007199254740993], True),
        ("eq", ["2", "10"], False),
        ("lt", ["2", "10"], False),
        ("eq", ["five", 5], False),
        ("truth", ["off"], False),
        ("truth", ["of"], True),
        ("not_", ["no"], True),
    ],
)
def test_a_text_is_compared_as_what_it_is_compared_with(operator: str, operands: list[object], value: bool) -> None:
    assert operate(operator, operands) is value


def test_a_text_that_is_no_number_is_neither_less_nor_more() -> None:
    with pytest.raises(Uncomputable):
        operate("lt", ["five", 6])
