"""The protocol of knowledge sources: global knowledge bases and people, outside of runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeAlias
from uuid import UUID

from pnm.core.knowledge_base import Layered
from pnm.core.logic.computed_values import Question
from pnm.errors import PnmError


class SourceError(PnmError):
    """A source could not be reached, has refused, or did not answer in time."""


@dataclass(frozen=True, slots=True)
class Asker:
    """The run that sends a query or update."""

    run: UUID
    plan: str = ""
    """Its plan, as shown to a person."""
    question: UUID | None = None
    """What a question is known by, also when it is asked again by another process."""


class Source(Protocol):
    """A knowledge base outside of runs, or a person. Every method is called on the event loop, by many runs at once."""

    async def query(self, question: Question, asker: Asker, /) -> object:
        """Return the answer to the question, or `MISSING`; cancelled when the answer is no longer needed.

        Raises:
            SourceError: the source could not be reached.
        """

    async def update(self, question: Question, value: object, asker: Asker, /) -> None:
        """Store the value, or forget it if it is None; when this returns, every later query finds it so.

        A person is shown the value, and stores nothing.

        Raises:
            SourceError: the value could not be stored; one that is not JSON never is.
        """

    async def close(self) -> None:
        """Close files and connections; open questions end with a `SourceError`."""


FindKnowledge: TypeAlias = Callable[[UUID], tuple[Layered, Asker] | None]
"""Returns the knowledge of the run that sent the request, and the asker for it; None if there is no such request, or no longer."""
