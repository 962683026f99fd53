"""Help from people: whether a task that cannot go on is to try again, and what has become of an action that nobody knows of any more."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final
from uuid import UUID, uuid5

from pnm.core.logic.computed_values import MISSING, Layer, Question, spoken
from pnm.knowledge.sources.source import Asker, Source, SourceError

TRY_AGAIN: Final = "try again"
GIVE_UP: Final = "give up"
HELP: Final = (TRY_AGAIN, GIVE_UP)
"""The answers of a person who is asked for help."""
YES: Final = "yes"
NO: Final = "no"
_TIMES: Final = 3
"""How often a question is asked whose answers mean nothing."""
_SHOWN: Final = 40
"""Characters of a wrong answer that are repeated."""


@dataclass(frozen=True, slots=True)
class Advice:
    """What a person advises; without an answer the task gives up."""

    try_again: bool
    why: str
    """Who or what it comes from, in words."""


@dataclass(frozen=True, slots=True)
class HelpAsked:
    """A person is asked for help: by which question, in which words, and with which answers; about a request that was lost, if any."""

    question: UUID
    text: str
    choices: tuple[str, str] = HELP
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


async def was_carried_out(person: Source, asker: Asker, request: UUID, action: str, note: Callable[[HelpAsked], None]) -> bool:
    """Ask a person whether an action was carried out of which nobody else knows, and have it noted; without an answer it was not.

    Raises:
        SourceError: there is no person to be asked, or no answer means anything.
    """
    question = f"Nobody knows how {action} has ended: its action server has forgotten it. Was it carried out? Answer {YES!r} or {NO!r}."
    return await _chosen(person, asker, "carried_out", HelpAsked(request, question, (YES, NO), request), note) == YES


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
