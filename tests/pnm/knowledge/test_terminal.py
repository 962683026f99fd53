"""A person at a terminal, who is asked and told."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from uuid import UUID

import pytest

from pnm.core.logic.computed_values import MISSING, Layer, Question
from pnm.knowledge.people import TerminalSource, message_text, question_text
from pnm.knowledge.source import Asker, SourceError
from pnm.knowledge.sources import Sources
from tests.support.logic.people import TerminalUser, about, run_questions

ME = Asker(UUID(int=7), "tour")


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


NO_TERMINAL = """
import asyncio, sys
from uuid import UUID
from pnm.core.logic.computed_values import Layer, Question
from pnm.knowledge.source import Asker, SourceError
from pnm.knowledge.people import TerminalSource
question = Question("USER", Layer.PERSON, "null")
for asking in (TerminalSource().query(question, Asker(UUID(int=1))), TerminalSource().update(question, 1, Asker(UUID(int=1)))):
    try:
        asyncio.run(asking)
    except SourceError as error:
        print(error)
"""


@pytest.mark.parametrize("stdin", ["<&-", "</dev/null"])
def test_without_a_terminal_that_is_said(stdin: str) -> None:
    command = f'exec "$0" -c "$1" {stdin}'
    ended = subprocess.run(["sh", "-c", command, sys.executable, NO_TERMINAL], capture_output=True, text=True, timeout=60.0, check=True)
    said = "a person was to be asked or told something, but there is no terminal to do it on\n"
    assert ended.stdout == said * 2
