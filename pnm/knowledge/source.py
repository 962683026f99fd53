"""Sources of knowledge outside of runs: global knowledge bases and people, and one that is in the memory of this process."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite
from typing import Final, Protocol, TypeAlias
from uuid import UUID

from pnm.core.knowledge_base import Layered
from pnm.core.logic.computed_values import MAX_SIZE, MISSING, Question
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
    """The identity of a question, also when it is asked again by another process."""
    task: UUID | None = None
    """The task of the run, which is shown as asking."""


class Source(Protocol):
    """A knowledge base outside of runs, or a person. Every method is called on the event loop, by many runs at once."""

    async def query(self, question: Question, asker: Asker, /) -> object:
        """Return the answer, or `MISSING`; raise `SourceError` if there is no way to it. Cancelled when it is no longer needed."""

    async def update(self, question: Question, value: object, asker: Asker, /) -> None:
        """Store the value, or forget it if it is None; when this returns, every later query finds it so.

        A person is shown the value, and stores nothing. Raises `SourceError` if the value could not be stored; one that is not JSON
        never is.
        """

    async def close(self) -> None:
        """Close files and connections; open questions end with a `SourceError`."""


FindKnowledge: TypeAlias = Callable[[UUID], tuple[Layered, Asker] | None]
"""Returns the knowledge of the run that sent the request, and the asker for it; None if there is no such request, or no longer."""


# --- in the memory of this process ---------------------------------------------------------
# Values on their way out of the process and back: JSON, bounded.

_SHOWN: Final = 60


def write_value(value: object) -> str:
    """Return the value as JSON text, all of it ASCII; raise `SourceError` if it is not JSON (there is no NaN), or too large."""
    try:
        text = json.dumps(value, allow_nan=False)
    except (TypeError, ValueError, RecursionError) as error:
        raise SourceError(f"JSON cannot say {_short(repr(value))}: {error}") from error
    if len(text) > MAX_SIZE:
        raise SourceError(f"{_short(text)} has {len(text)} characters as JSON; at most {MAX_SIZE} can be stored")
    return text


def read_value(text: str) -> object:
    """Return the value of a JSON text; raise `SourceError` if it is malformed, or too large."""
    if len(text) > MAX_SIZE:
        raise SourceError(f"{_short(text)} has {len(text)} characters; expected at most {MAX_SIZE}")
    try:
        return json.loads(text, parse_constant=_finite, parse_float=_finite)
    except (ValueError, RecursionError) as error:
        raise SourceError(f"{_short(text)!r} is not JSON: {error}") from error


def _finite(written: str) -> float:
    if isfinite(number := float(written)):
        return number
    raise ValueError(f"JSON has no {written}")


def _short(text: str) -> str:
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN - 1]}…"


class MemoryKnowledge:
    """Variables by name, each kept as JSON, so that no run can change the value of another. The mutable state is the variables."""

    def __init__(self) -> None:
        self._variables: dict[str, str] = {}

    def __repr__(self) -> str:
        return "<MemoryKnowledge>"

    async def query(self, question: Question, asker: Asker, /) -> object:
        """Return the value, or `MISSING`."""
        text = self._variables.get(question.name)
        return MISSING if text is None else read_value(text)

    async def update(self, question: Question, value: object, asker: Asker, /) -> None:
        """Store the value; one that is set to None is forgotten."""
        self._variables[question.name] = write_value(value)
        if value is None:
            del self._variables[question.name]

    async def close(self) -> None:
        """Do nothing: there is nothing to close."""
