"""Σ and its answer: what a run is told, and what it asks for.

A run is told *events* (reports about requests besides) and answers with *commands*. All times
are seconds on the clock of whoever calls it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias
from uuid import UUID

from pnm.actions.base import Report, Request


@dataclass(frozen=True, slots=True)
class Begin:
    """Start the run."""


@dataclass(frozen=True, slots=True)
class KnowledgeChanged:
    """Facts have changed; conditions that were waiting are asked again."""


@dataclass(frozen=True, slots=True)
class Tick:
    """The moment of a `Wake` has come."""


@dataclass(frozen=True, slots=True)
class Stop:
    """End the run: start nothing more; cancel what runs, or let it end by itself."""

    cancel: bool = True
    reason: str = "cancelled"


Event: TypeAlias = Begin | KnowledgeChanged | Tick | Stop | Report


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


Command: TypeAlias = Send | Cancel | Wake
