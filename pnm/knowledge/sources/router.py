"""Routes every question to a knowledge base or the person, with a time limit."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Sequence
from typing import Final, TypeVar
from uuid import UUID

from pnm.core.logic.computed_values import MISSING, Question
from pnm.errors import PnmError
from pnm.knowledge.sources import person_text as people
from pnm.knowledge.sources.source import Asker, Source, SourceError

GRACE: Final = 1.0
"""Seconds more for sources with a time limit of their own, whose error message is more precise."""
LIMIT: Final = 5.0
"""Time limit of a knowledge base, in seconds."""
PERSON_LIMIT: Final = people.LIMIT + GRACE
"""Time limit of a person, in seconds."""

T = TypeVar("T")

_log = logging.getLogger(__name__)


class Sources:
    """The global knowledge in one or more knowledge bases, and a person; itself a `Source`.

    A query goes through the knowledge bases in order until one has a value other than null; an update goes to the first, where every
    later query finds it. Questions for people (`people.is_for_people`) go to the person. A knowledge base that fails is an error and
    never skipped: the next one might have another value. The limits are in seconds, for each knowledge base and for the person.

    The mutable state is the questions that people are asked, by their ids: answers may come by other ways as well (`answer`).
    """

    def __init__(
        self, shared: Sequence[Source] = (), person: Source | None = None, *, limit: float = LIMIT, person_limit: float = PERSON_LIMIT
    ) -> None:
        self._shared = tuple(shared)
        self._person = person
        self._limit = limit
        self._person_limit = person_limit
        self._open: dict[UUID, tuple[Question, asyncio.Future[object]]] = {}

    def __repr__(self) -> str:
        return f"<Sources {', '.join(map(repr, self._shared)) or 'no knowledge base'}; {self._person or 'nobody'!r}>"

    async def query(self, question: Question, asker: Asker, /) -> object:
        """Return the first value in any of the knowledge bases, or the person's answer; or `MISSING`."""
        if people.is_for_people(question):
            asked = self._ask(self._person_for(question), question, asker)
            return await self._within(self._person_limit, asked, f"nobody has answered {question}")
        for source in self._shared:
            value = await self._within(self._limit, source.query(question, asker), f"{source!r} has not answered {question}")
            if value is not MISSING and value is not None:
                return value
        return MISSING

    def answer(self, question: UUID, text: str) -> bool:
        """Take a person's answer from elsewhere, so that the person is not asked any more; return whether the question is open.

        Raises:
            SourceError: the text is no answer to the question.
        """
        asked, waiting = self._open.get(question, (None, None))
        if asked is None or waiting is None or waiting.done():
            return False
        waiting.set_result(people.read_answer(text, asked))
        return True

    async def _ask(self, person: Source, question: Question, asker: Asker) -> object:
        """Ask a person, and return what is answered first, by whichever way."""
        if asker.question is None:
            return await person.query(question, asker)
        asking = asyncio.ensure_future(person.query(question, asker))
        answered: asyncio.Future[object] = asyncio.get_running_loop().create_future()
        self._open[asker.question] = (question, answered)
        try:
            await asyncio.wait((asking, answered), return_when=asyncio.FIRST_COMPLETED)
            return answered.result() if answered.done() else await asking
        finally:
            del self._open[asker.question]
            asking.add_done_callback(lambda asked: asked.cancelled() or asked.exception())  # nobody else looks at what went wrong
            if not asking.done():
                asking.cancel()
                await asyncio.wait((asking,), timeout=self._limit)  # it is withdrawn where it is shown

    async def update(self, question: Question, value: object, asker: Asker, /) -> None:
        """Store the value in the first knowledge base, or show it to the person."""
        if people.is_for_people(question):
            person = self._person_for(question)
            await self._within(self._person_limit, person.update(question, value, asker), f"nobody has heard {question}")
            return
        if not self._shared:
            raise SourceError(f"there is no knowledge base to store {question} in")
        first = self._shared[0]
        await self._within(self._limit, first.update(question, value, asker), f"{first!r} has not stored {question}")

    async def close(self) -> None:
        """Close all of them; one that fails is logged."""
        sources = [*self._shared, *([self._person] if self._person is not None else [])]
        closing = [self._within(self._limit, source.close(), "not closed") for source in sources]
        errors = await asyncio.gather(*closing, return_exceptions=True)
        for source, error in zip(sources, errors, strict=True):
            if isinstance(error, Exception):
                _log.warning("%r cannot be closed: %s", source, error)

    def _person_for(self, question: Question) -> Source:
        if self._person is None:
            raise SourceError(f"there is nobody who could be asked or told {question}")
        return self._person

    async def _within(self, limit: float, answer: Awaitable[T], otherwise: str) -> T:
        timer = asyncio.timeout(limit)
        try:
            async with timer:
                return await answer
        except TimeoutError as error:
            if not timer.expired():  # raised by the source itself
                raise SourceError(f"{otherwise}: {str(error) or type(error).__name__}") from error
            raise SourceError(f"{otherwise} within {limit:g} s") from error
        except PnmError as error:
            if isinstance(error, SourceError):
                raise
            raise SourceError(f"{otherwise}: {error}") from error
