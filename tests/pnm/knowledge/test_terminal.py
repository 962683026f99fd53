"""People who are asked and told, at a terminal and elsewhere; their answers mean the same to every condition."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Iterator
from io import StringIO
from pathlib import Path
from uuid import UUID

import pytest
from hypothesis import example, given, strategies as st

from planner_bridge.pipeline.achieve import carry_out
from pnm.core.logic.computed_values import MISSING, Layer, Question, Uncomputable, operate
from pnm.knowledge.people import ScriptedAnswers, TerminalSource, message_text, question_text
from pnm.knowledge.source import Asker, SourceError
from pnm.knowledge.sources import Sources
from tests.support.files import written
from tests.support.logic.people import DelayedSource, Person, TerminalUser, about, run_questions

ME = Asker(UUID(int=7), "tour")


@pytest.fixture
def person() -> Iterator[TerminalUser]:
    somebody = TerminalUser()
    yield somebody
    somebody.leave()


# --- what people see and say ---


@pytest.mark.parametrize(
    ("question", "said"),
    [
        (about("shop", Layer.PERSON), "What is shop?"),
        (about("shop", Layer.PERSON, "Which shop?"), "Which shop?"),
        (about("shop", Layer.PERSON, {"text": "Which shop?", "shops": [1]}), "Which shop?"),
        (about("shop", Layer.PERSON, {"shops": [1]}), "What is shop?"),
        (about("shop", Layer.PERSON, ["x"]), "What is shop?"),
        (about("USER", meta=""), "What do you say?"),
        (Question("shop", Layer.PERSON, "no JSON"), "no JSON"),
    ],
    ids=str,
)
def test_the_words_of_a_question(question: Question, said: str) -> None:
    assert question_text(question) == said


@pytest.mark.parametrize(
    ("question", "value", "said"),
    [
        (about("USER"), "Follow me!", "Follow me!"),
        (about("CONTROLLER", meta={"status": 1}), {"at": "hall"}, '{"at": "hall"}'),
        (about("shop", Layer.PERSON), "bakery", "shop: bakery"),
        (about("shop", Layer.PERSON, "The shop is"), ["ü"], 'The shop is: ["ü"]'),
    ],
    ids=str,
)
def test_the_words_of_a_message(question: Question, value: object, said: str) -> None:
    assert message_text(question, value) == said


# --- the terminal ---


def test_a_question_at_the_terminal(person: TerminalUser) -> None:
    async def main() -> list[object]:
        terminal = TerminalSource(person.answers, person.shown)
        found = []
        for typed in ("bakery\n", "5\n", "[1]\n", "\n", '["a"\n'):
            asking = asyncio.ensure_future(terminal.query(about("shop", Layer.PERSON, "Which shop?"), ME))
            await person.sees("[tour] Which shop? ")
            person.types(typed)
            if typed == '["a"\n':
                await person.sees("is not JSON")
                await person.sees("once more: ")
                person.types('["a"]\n')
            found.append(await asking)
        return found

    assert run_questions(main(), virtual=False) == ["bakery", 5, [1], MISSING, ["a"]]


def test_questions_queue_and_say_who_asks(person: TerminalUser) -> None:
    async def main() -> list[object]:
        terminal = TerminalSource(person.answers, person.shown)
        one = asyncio.ensure_future(terminal.query(about("a", Layer.PERSON), Asker(UUID(int=1), "first")))
        two = asyncio.ensure_future(terminal.query(about("b", Layer.PERSON), Asker(UUID(int=2), "second")))
        told = asyncio.ensure_future(terminal.update(about("USER"), "Bye!", Asker(UUID(int=2))))
        await person.sees("[first] What is a? ")
        assert not two.done()
        person.types("1\n")
        await person.sees("[second] What is b? ")
        person.types("2\n")
        await person.sees("Bye!")
        return [await one, await two, await told]

    assert run_questions(main(), virtual=False) == [1, 2, None]


def test_a_withdrawn_question_makes_place_and_its_late_answer_is_not_taken(person: TerminalUser) -> None:
    async def main() -> object:
        terminal = TerminalSource(person.answers, person.shown)
        one = asyncio.ensure_future(terminal.query(about("a", Layer.PERSON), ME))
        await person.sees("What is a? ")
        one.cancel()
        await asyncio.wait([one])
        assert one.cancelled()
        await person.sees("(no longer asked)")
        person.types("late\n")
        two = asyncio.ensure_future(terminal.query(about("b", Layer.PERSON), ME))
        await person.sees("What is b? ")
        person.types("good\n")
        return await two

    assert run_questions(main(), virtual=False) == "good"


@pytest.mark.parametrize("virtual", [True, False])
def test_nobody_answers_at_the_terminal(person: TerminalUser, virtual: bool) -> None:
    async def main() -> None:
        with pytest.raises(SourceError, match=r"nobody has answered on the terminal within 0\.2 s"):
            await TerminalSource(person.answers, person.shown, limit=0.2).query(about("a", Layer.PERSON), ME)
        await person.sees("(no longer asked)")

    run_questions(main(), virtual=virtual)


def test_thinking_takes_no_virtual_time(person: TerminalUser) -> None:
    async def main() -> tuple[object, float]:
        asking = asyncio.ensure_future(Sources([], TerminalSource(person.answers, person.shown)).query(about("a", Layer.PERSON), ME))
        await person.sees("What is a? ")
        person.types("x\n")
        return await asking, asyncio.get_running_loop().time()

    assert run_questions(main()) == ("x", 0.0)


def test_the_terminal_is_closed_while_somebody_thinks(person: TerminalUser) -> None:
    async def main() -> None:
        asking = asyncio.ensure_future(TerminalSource(person.answers, person.shown).query(about("a", Layer.PERSON), ME))
        await person.sees("What is a? ")
        person.types("\x04")
        with pytest.raises(SourceError, match="the terminal was closed"):
            await asking

    run_questions(main(), virtual=False)


@pytest.mark.parametrize("stdin", [None, StringIO()], ids=["closed", "no terminal"])
def test_without_a_terminal_that_is_said(stdin: StringIO | None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", stdin)
    for asking in (TerminalSource().query(about("USER"), ME), TerminalSource().update(about("USER"), 1, ME)):
        with pytest.raises(SourceError, match="a person was to be asked or told something, but there is no terminal to do it on"):
            run_questions(asking)


# --- answers: by whichever way one comes, it is the same value ---


PAGE = Asker(UUID(int=7), "tour", UUID(int=1))
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
    asking = asyncio.ensure_future(sources.query(question, PAGE))
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
    rehearsed = outcome(ScriptedAnswers([("go", text)], DelayedSource()).query(question, PAGE))
    assert outcome(over_the_page(question, text)) == rehearsed


def test_who_answers_something_else_is_told_the_answers(person: TerminalUser) -> None:
    async def typed() -> object:
        asking = asyncio.ensure_future(TerminalSource(person.answers, person.shown).query(CLOSED, PAGE))
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
        ("ge", ["18.5", 18], True),
        ("lt", [2, "10"], True),
        ("eq", ["9007199254740993", 9007199254740993], True),
        ("lt", ["2", "10"], False),
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
