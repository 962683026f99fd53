"""Σ and its answer: what a run is told, and what it asks for.

A run is told *events* (reports about requests besides) and answers with *commands*. All times
are seconds on the clock of whoever calls it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias
from uuid import UUID

from pnm.actions.base import Report, Request
from pnm.queries import Question


@dataclass(frozen=True, slots=True)
class Begin:
    """Start the run."""


@dataclass(frozen=True, slots=True)
class KnowledgeChanged:
    """Facts have changed; conditions that were waiting are asked again."""


@dataclass(frozen=True, slots=True)
class ResourcesChanged:
    """Somebody who waits for resources may have them now; calls that wait for some ask again."""


@dataclass(frozen=True, slots=True)
class Tick:
    """The moment of a `Wake` has come."""


@dataclass(frozen=True, slots=True)
class Stop:
    """End the run: start nothing more; cancel what runs, or let it end by itself."""

    cancel: bool = True
    reason: str = "cancelled"


@dataclass(frozen=True, slots=True)
class Pause:
    """Start nothing more until told to resume; let what runs come to its end, or have it cancelled and begin anew later."""

    at_once: bool = False


@dataclass(frozen=True, slots=True)
class Resume:
    """Go on after a pause."""


@dataclass(frozen=True, slots=True)
class Answered:
    """What a question of an `Ask` was answered with; `MISSING` when nobody knows, or nobody has answered in time."""

    id: UUID
    value: object
    message: str = ""
    """Why there is no value, when there is none."""


Event: TypeAlias = Begin | KnowledgeChanged | ResourcesChanged | Tick | Stop | Pause | Resume | Answered | Report


@dataclass(frozen=True, slots=True)
class Send:
    """Send the request."""

    request: Request


@dataclass(frozen=True, slots=True)
class Cancel:
    """Ask for the request to be cancelled."""

    request: UUID


@dataclass(frozen=True, slots=True)
class Wake:
    """Call back with a `Tick` at this time; replaces an earlier `Wake`."""

    at: float


@dataclass(frozen=True, slots=True)
class Ask:
    """Ask the question outside of the run; exactly one `Answered` follows."""

    id: UUID
    question: Question


@dataclass(frozen=True, slots=True)
class Withdraw:
    """The answer to the question is no longer needed."""

    id: UUID


@dataclass(frozen=True, slots=True)
class Tell:
    """Store the value outside of the run; one `Ended` follows, as for a request that was sent."""

    id: UUID
    question: Question
    """Its name and layer say where the value goes, its meta data go with it."""
    value: object


Command: TypeAlias = Send | Cancel | Wake | Ask | Withdraw | Tell
