"""Sends every question to whoever it is for, and waits no longer than there is sense in it."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Sequence
from typing import Final, TypeVar

from pnm.core.logic.computed_values import MISSING, Question
from pnm.errors import PnmError
from pnm.knowledge.sources import person_text as people
from pnm.knowledge.sources.source import Asker, Source, SourceError

GRACE: Final = 1.0
"""Seconds more for those that have a limit of their own, and say better what the matter is."""
LIMIT: Final = 5.0
"""Seconds a knowledge base may take."""
PERSON_LIMIT: Final = people.LIMIT + GRACE
"""The same for a person."""

T = TypeVar("T")

_log = logging.getLogger(__name__)


class Sources:
    """The global knowledge, in as many knowledge bases as there are, and a person; itself a `Source`.

    A query goes through the knowledge bases in order until one has a value, which null is not; an update goes to the first, where every
    later query finds it. What is for people (`people.is_for_people`) goes to the person. One that fails is an error, never
    passed over: the next one might answer with something else.

    Args:
        shared: the knowledge bases.
        person: who is asked and told; may be nobody.
    """

    def __init__(
        self, shared: Sequence[Source] = (), person: Source | None = None, *, limit: float = LIMIT, person_limit: float = PERSON_LIMIT
    ) -> None:
        self._shared = tuple(shared)
        self._person = person
        self._limit = limit
        self._person_limit = person_limit

    def __repr__(self) -> str:
        return f"<Sources {', '.join(map(repr, self._shared)) or 'no knowledge base'}; {self._person or 'nobody'!r}>"

    async def query(self, question: Question, asker: Asker, /) -> object:
        """Return the first value that anybody has, or `MISSING`.

        Raises:
            SourceError: somebody could not be asked, or did not answer in time.
        """
        if people.is_for_people(question):
            person = self._somebody(question)
            return await self._within(self._person_limit, person.query(question, asker), f"nobody has answered {question}")
        for source in self._shared:
            found = await self._within(self._limit, source.query(question, asker), f"{source!r} has not answered {question}")
            if found is not MISSING and found is not None:
                return found
        return MISSING

    async def update(self, question: Question, value: object, asker: Asker, /) -> None:
        """Store the value in the first knowledge base, or tell the person.

        Raises:
            SourceError: there is none, it failed, or it took too long.
        """
        if people.is_for_people(question):
            person = self._somebody(question)
            await self._within(self._person_limit, person.update(question, value, asker), f"nobody has heard {question}")
            return
        if not self._shared:
            raise SourceError(f"there is no knowledge base to store {question} in")
        first = self._shared[0]
        await self._within(self._limit, first.update(question, value, asker), f"{first!r} has not stored {question}")

    async def close(self) -> None:
        """Close all of them, whatever becomes of one."""
        everybody = [*self._shared, *([self._person] if self._person is not None else [])]
        ended = await asyncio.gather(*(self._within(self._limit, one.close(), "not closed") for one in everybody), return_exceptions=True)
        for source, error in zip(everybody, ended, strict=True):
            if isinstance(error, Exception):
                _log.warning("%r cannot be closed: %s", source, error)

    def _somebody(self, question: Question) -> Source:
        if self._person is None:
            raise SourceError(f"there is nobody who could be asked or told {question}")
        return self._person

    async def _within(self, limit: float, answer: Awaitable[T], otherwise: str) -> T:
        timer = asyncio.timeout(limit)
        try:
            async with timer:
                return await answer
        except TimeoutError as error:
            if not timer.expired():  # a source of somebody's own has failed so
                raise SourceError(f"{otherwise}: {str(error) or type(error).__name__}") from error
            raise SourceError(f"{otherwise} within {limit:g} s") from error
        except PnmError as error:
            if isinstance(error, SourceError):
                raise
            raise SourceError(f"{otherwise}: {error}") from error
