"""People as sources of knowledge: what they are asked, what they answer, at a terminal, beforehand, and when a task needs help."""

from __future__ import annotations

import asyncio
import json
import logging
import os
import select
import sys
import termios
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Final, TextIO
from uuid import UUID, uuid5

from pnm.core.logic.computed_values import MISSING, Layer, Question, spoken
from pnm.errors import printable
from pnm.knowledge.source import Asker, Source, SourceError, read_value

# --- texts for people, and what their answers mean -----------------------------------------

ANSWER_LIMIT: Final = 60.0
"""Time limit for a person's answer, in seconds."""
PSEUDO: Final = frozenset({"USER", "CONTROLLER"})
"""Names of people rather than variables, in files for the original implementation: the user and the operator of the robot."""
_WRITTEN: Final = ('"', "[", "{")
"""Beginnings of JSON texts, so that malformed JSON is not taken for an answer."""
_SHOWN: Final = 40
"""Characters of a wrong answer that are repeated."""


def is_for_people(question: Question) -> bool:
    """Return whether the question is for a person rather than a knowledge base."""
    return question.layer is Layer.PERSON or (question.layer is not Layer.LOCAL and question.name in PSEUDO)


def question_text(question: Question) -> str:
    """Return the wording of a question: its meta data, alone or under ``text``; otherwise one made from the name."""
    if wording := _wording(question):
        return wording
    return "What do you say?" if question.name in PSEUDO else f"What is {question.name}?"


def question_words(question: Question) -> str:
    """Return the wording of a question, with its ``answers`` if it names any."""
    answers = _meta(question).get("answers")
    choices = f" ({' or '.join(map(str, answers))})" if isinstance(answers, list) else ""
    return f"{question_text(question)}{choices}"


def message_text(question: Question, value: object) -> str:
    """Return the text of a message to a person."""
    shown = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False, default=str)
    about = _wording(question) or ("" if question.name in PSEUDO else question.name)
    return f"{about}: {shown}" if about else shown


def read_answer(text: str, question: Question) -> object:
    """Return the value of an answer, by whichever way it came: that one of the question's ``answers`` which is said, if it names any.

    Otherwise JSON, or else the text as it stands; an empty text is `MISSING`. Raises `SourceError` for malformed JSON,
    and for what is none of the answers.

    >>> open, closed = Question("go", Layer.PERSON, ""), Question("go", Layer.PERSON, '{"answers": ["yes", "no", 3]}')
    >>> [read_answer(text, open) for text in ("kitchen", "5", '"5"', "true", "No.")]
    ['kitchen', 5, '5', True, 'No.']
    >>> [read_answer(text, closed) for text in ("No.", " YES", "3")]
    ['no', 'yes', 3]
    """
    text = text.strip()
    if not text:
        return MISSING
    expected = _meta(question).get("answers")
    if isinstance(expected, list):
        for answer in expected:
            if spoken(text) == spoken(answer if isinstance(answer, str) else json.dumps(answer)):
                return answer
        raise SourceError(f"expected {' or '.join(map(str, expected))}, found {text[:_SHOWN]!r}")
    try:
        return read_value(text)
    except SourceError:
        if text.startswith(_WRITTEN):
            raise
        return text


def _wording(question: Question) -> str:
    text = _meta(question).get("text")
    return text.strip() if isinstance(text, str) else ""


def _meta(question: Question) -> Mapping[str, object]:
    """Return the meta data of a question, which are JSON, or else its text; so are those that are no mapping."""
    try:
        data = json.loads(question.meta or "null")
    except ValueError:
        data = question.meta
    return data if isinstance(data, dict) else {"text": data}


# --- a person at the terminal --------------------------------------------------------------
# One question at a time, while everything else goes on. The line is read on a thread, which holds virtual time still: a person
# cannot answer within a simulated second.


class TerminalSource:
    """A person at the terminal: questions are written to one stream and answers read from another, which must be a terminal.

    An answer is read by `read_answer`; an empty line means that the person does not know. Input from before
    a question appeared does not count as its answer.

    The streams are by default the standard input, and for questions the standard error, since the standard output is for results.
    The limit is the seconds for an answer, on a real clock. The mutable state is the queue of the questions, which the lock holds.
    """

    def __init__(self, answers: TextIO | None = None, shown: TextIO | None = None, *, limit: float = ANSWER_LIMIT) -> None:
        self._answers = answers
        self._shown = shown
        self._limit = limit
        self._turn = asyncio.Lock()

    def __repr__(self) -> str:
        return "<Terminal>"

    async def query(self, question: Question, asker: Asker, /) -> object:
        """Show the question when its turn comes and return the answer, or `MISSING` for an empty line."""
        self._check()
        async with self._turn:
            termios.tcflush(self._input.fileno(), termios.TCIFLUSH)
            self._show(f"{_name(asker)}{question_text(question)}", " ")
            while True:
                line = await self._line()
                try:
                    return read_answer(line, question)
                except SourceError as error:
                    self._show(f"{error}; once more:", " ")

    async def update(self, question: Question, value: object, asker: Asker, /) -> None:
        """Show the value as a message."""
        self._check()
        async with self._turn:
            self._show(f"{_name(asker)}{message_text(question, value)}")

    async def close(self) -> None:
        """Leave the terminal as it is."""

    @property
    def _input(self) -> TextIO:
        return sys.stdin if self._answers is None else self._answers

    def _check(self) -> None:
        if not is_terminal(self._input):
            raise SourceError("a person was to be asked or told something, but there is no terminal to do it on")

    def _show(self, text: str, end: str = "\n") -> None:
        stream = sys.stderr if self._shown is None else self._shown
        stream.write(printable(text) + end)
        stream.flush()

    async def _line(self) -> str:
        """Read a line on a thread; when this is cancelled, the thread stops reading first."""
        heard, ring = os.pipe()
        reading = asyncio.get_running_loop().run_in_executor(None, self._read, heard)
        try:
            return await asyncio.shield(reading)
        except (asyncio.CancelledError, SourceError):
            os.write(ring, b"\0")
            await asyncio.gather(reading, return_exceptions=True)
            self._show(" (no longer asked)")
            raise
        finally:
            os.close(heard)
            os.close(ring)

    # on the thread

    def _read(self, bell: int) -> str:
        terminal = self._input.fileno()
        ready, _, _ = select.select([terminal, bell], [], [], self._limit)
        if bell in ready:
            return ""
        if not ready:
            raise SourceError(f"nobody has answered on the terminal within {self._limit:g} s")
        line = os.read(terminal, 4096)
        if not line:
            raise SourceError("the terminal was closed")
        return line.decode("utf-8", "replace")


def is_terminal(stream: TextIO | None = None) -> bool:
    """Return whether the stream, or the standard input, is a terminal."""
    try:
        return (sys.stdin if stream is None else stream).isatty()
    except (ValueError, AttributeError):  # it was closed, or never there
        return False


def _name(asker: Asker) -> str:
    return f"[{asker.plan}] " if asker.plan else ""


# --- answers given beforehand, for rehearsals, and where nobody is there to ask -----------

_log = logging.getLogger(__name__)


class ScriptedAnswers:
    """Answers to questions by their names; what has none here goes to another source.

    Several answers of a name are given in turn, and the last of them from then on; texts are read as those that people write.
    The mutable state is those that are left, and the names that nobody has asked for yet, which are logged at the end.
    """

    def __init__(self, answers: Iterable[tuple[str, object]], otherwise: Source) -> None:
        self._otherwise = otherwise
        self._left: dict[str, list[object]] = {}
        for name, value in answers:
            self._left.setdefault(name, []).append(value)
        self._unused = dict.fromkeys(self._left)

    def __repr__(self) -> str:
        return f"<ScriptedAnswers {', '.join(self._left)}>"

    async def query(self, question: Question, asker: Asker, /) -> object:
        """Return the next answer of this name; ask the other source if there is none."""
        answers = self._left.get(question.name)
        if not answers:
            return await self._otherwise.query(question, asker)
        self._unused.pop(question.name, None)
        answer = answers.pop(0) if len(answers) > 1 else answers[0]
        return read_answer(answer, question) if isinstance(answer, str) else answer

    async def update(self, question: Question, value: object, asker: Asker, /) -> None:
        """Have the other source show the value."""
        await self._otherwise.update(question, value, asker)

    async def close(self) -> None:
        """Close the other source; log the names of answers that were not used."""
        if self._unused:
            _log.warning("the answer to %s was not needed", " or ".join(self._unused))
        await self._otherwise.close()


# --- help ----------------------------------------------------------------------------------
# Whether a task that cannot go on is to try again, and what has become of an action that nobody knows of any more.

TRY_AGAIN: Final = "try again"
GIVE_UP: Final = "give up"
APPROVAL: Final = "approval"
"""The name of the question whether a goal that was proposed is pursued: only people answer it."""
_TIMES: Final = 3
"""The number of times that a question with meaningless answers is asked."""


@dataclass(frozen=True, slots=True)
class Advice:
    """The advice of a person; without an answer the task gives up."""

    try_again: bool
    why: str
    """Its source, in words."""


@dataclass(frozen=True, slots=True)
class HelpAsked:
    """A person is asked for help: by which question, in which words, and with which answers; about a request that was lost, if any."""

    question: UUID
    text: str
    choices: tuple[str, str] = (TRY_AGAIN, GIVE_UP)
    request: UUID | None = None

    def __str__(self) -> str:
        return f"a person is asked: {self.text}"


@dataclass(frozen=True, slots=True)
class HelpEnded:
    """A person is not asked for help any more: what has come of it; about a request that was lost, if any."""

    why: str
    request: UUID | None = None

    def __str__(self) -> str:
        return self.why


def note_nothing(_: HelpAsked | HelpEnded, /) -> None:
    """Note of a question to a person that nobody keeps."""


async def ask_for_help(person: Source, asker: Asker, trouble: str, note: Callable[[HelpAsked], None] = note_nothing) -> Advice:
    """Ask a person what to do about trouble, and have it noted; cancelled when that is no longer needed."""
    question = f"{trouble}. Answer {TRY_AGAIN!r} when that is mended, or {GIVE_UP!r}."
    try:
        said = await _chosen(person, asker, "help", HelpAsked(asker.question or asker.run, question), note)
    except SourceError as error:
        return Advice(try_again=False, why=f"help was asked for in vain: {error}")
    if said == TRY_AGAIN:
        return Advice(try_again=True, why="a person says that it is to be tried again")
    return Advice(try_again=False, why=f"a person was asked for help, and {'says to give up' if said else 'does not know any'}")


async def is_approved(person: Source, asker: Asker, goal: str, note: Callable[[HelpAsked], None]) -> bool:
    """Ask a person whether a goal that a program proposes is to be pursued; `SourceError` without an answer that means anything."""
    question = f"A program proposes the goal {goal}. Is it to be pursued? Answer 'yes' or 'no'."  # all of it: it must be seen whole
    return await _chosen(person, asker, APPROVAL, HelpAsked(asker.question or asker.run, question, ("yes", "no")), note) == "yes"


async def was_carried_out(person: Source, asker: Asker, request: UUID, action: str, note: Callable[[HelpAsked], None]) -> bool:
    """Ask a person whether a lost action was carried out; without an answer it was not. `SourceError` if none means anything."""
    question = f"Nobody knows how {action} has ended: its action server has forgotten it. Was it carried out? Answer 'yes' or 'no'."
    return await _chosen(person, asker, "carried_out", HelpAsked(request, question, ("yes", "no"), request), note) == "yes"


async def _chosen(person: Source, asker: Asker, name: str, first: HelpAsked, note: Callable[[HelpAsked], None]) -> str:
    """Return which of two answers a person gives, once more when it is neither; empty without an answer."""
    expected, asked = " or ".join(map(repr, first.choices)), first
    for number in range(1, _TIMES + 1):
        note(asked)
        answer = await person.query(Question(name, Layer.PERSON, json.dumps(asked.text)), replace(asker, question=asked.question))
        said = "" if answer is MISSING else spoken(str(answer))
        if said in ("", *first.choices):
            return said
        wrong = f"Expected {expected}, found {str(answer)[:_SHOWN]!r}. {first.text}"
        asked = replace(first, question=uuid5(first.question, str(number)), text=wrong)
    raise SourceError(f"no answer was {expected}")
