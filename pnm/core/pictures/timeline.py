"""Timeline of a task: what its plans wanted when, and what was done when. A plain value, wherever it comes from.

All times are in seconds from the beginning of the task.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

from pnm.core.machine.requests import OutcomeKind


@dataclass(frozen=True, slots=True)
class TimedAttempt:
    """A request that was sent for a call."""

    sent: float
    ended: float | None = None
    """None while it is under way."""
    outcome: OutcomeKind | None = None
    """How it ended."""
    message: str = ""
    """What its server said about that."""


@dataclass(frozen=True, slots=True)
class TimedCall:
    """A call of a plan."""

    number: int
    """In its plan."""
    name: str
    """With its arguments."""
    lane: str
    """Whose it is, such as a robot."""
    planned: float
    """When its plan has it start."""
    duration: float | None = None
    """How long its plan takes it to last; None when nothing is known about that."""
    attempts: tuple[TimedAttempt, ...] = ()
    """Those whose requests were sent under this plan; a later plan may have taken the last one over."""
    outcome: str = ""
    """What became of it under this plan, in words."""
    is_done: bool = False
    """It succeeded, or was not needed."""
    is_failed: bool = False


@dataclass(frozen=True, slots=True)
class Replan:
    """Why a plan took the place of another, and how they differ: what was still to be done before, and what is now."""

    why: str
    kept: tuple[str, ...] = ()
    dropped: tuple[str, ...] = ()
    added: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class TimedPlan:
    """A plan, from when it was begun to when another took its place."""

    began: float
    calls: tuple[TimedCall, ...]
    replan: Replan | None = None
    """None for the first plan, and for those that are carried out for a call of another."""
    failures: tuple[str, ...] = ()
    """What failed in it, and why."""


@dataclass(frozen=True, slots=True)
class Timeline:
    """The timeline of a task."""

    goal: str
    plans: tuple[TimedPlan, ...] = ()
    now: float = 0.0
    """The time until which it tells everything: the end, if there is one."""
    ending: str = ""
    """How the task ended, in words; empty while it goes on."""


def replan(why: str, left: Iterable[str], new: Iterable[str]) -> Replan:
    """Return how a plan follows another one, of which these calls were left."""
    before, after = Counter(left), Counter(new)
    kept, dropped, added = before & after, before - after, after - before
    return Replan(why, *(tuple(part.elements()) for part in (kept, dropped, added)))
