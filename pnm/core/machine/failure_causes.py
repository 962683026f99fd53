"""Causes: why a step recovers or fails. Whatever depends on the cause alone is a trait of it, and stands here."""

from __future__ import annotations

from enum import Enum, StrEnum, auto
from typing import Final, Self


class Phase(Enum):
    """The time of a failure of a call. A plan's own recoveries are sorted by it."""

    BEFORE = "before"
    """Nothing has been sent."""
    DURING = "during"
    """Its request has ended, and not with success."""
    AFTER = "after"
    """Its request has succeeded."""


class NoRecovery(Enum):
    """Why no recovery of a call follows a cause, as a sentence."""

    CALL = "then a call has failed for good"
    STEP = "a loop, a choice or a wait fails so, and no call"
    PLAN = "a plan as a whole fails so, and none of its calls"


class FailureKind(Enum):
    """The kind of failure that a task ends with which does not get past it."""

    ACTION = auto()
    CONDITION = auto()
    TIME = auto()
    SERVER = auto()


class Blame(Enum):
    """The part that a new plan must avoid, when it happens again and again."""

    ACTION = auto()
    WORLD = auto()
    """Nothing: the state of the world, or of resources, was against it, not the action."""
    SERVER = auto()
    """The action and, for whatever it is called, its server: it would not be there."""


class Cause(StrEnum):
    """Why a step recovers or fails: which check did not hold, or how its request ended.

    The order gives the numbers in messages: a new one comes last.

    Attributes:
        phase: of a call, when it comes; or why it has no recoveries.
        kind: which kind of failure it is.
        blame: whom it speaks against. A condition over all that breaks speaks against the action: it was under way, as when its robot
            notices that itself and aborts.
        happened: what has become of a call, as the predicate of a sentence.
    """

    phase: Phase | NoRecovery
    kind: FailureKind
    blame: Blame
    happened: str

    def __new__(cls, value: str, phase: Phase | NoRecovery, kind: FailureKind, blame: Blame = Blame.ACTION, happened: str = "") -> Self:
        """Make a member of its traits."""
        cause = str.__new__(cls, value)
        cause._value_ = value
        cause.phase, cause.kind, cause.blame, cause.happened = phase, kind, blame, happened or f"failed: {value}"
        return cause

    BEFORE = "before", Phase.BEFORE, FailureKind.ACTION
    """The recovery's own condition holds before the start."""
    PRECONDITION_FALSE = "precondition_false", Phase.BEFORE, FailureKind.CONDITION, Blame.WORLD
    DATA_MISSING = "data_missing", Phase.BEFORE, FailureKind.CONDITION
    REJECTED = "rejected", Phase.DURING, FailureKind.SERVER, Blame.ACTION, "was rejected"
    UNAVAILABLE = "unavailable", Phase.DURING, FailureKind.SERVER, Blame.SERVER, "found no server"
    ABORTED = "aborted", Phase.DURING, FailureKind.ACTION, Blame.ACTION, "was aborted"
    CANCELED = "canceled", Phase.DURING, FailureKind.ACTION, Blame.ACTION, "was cancelled"
    TIMED_OUT = "timed_out", Phase.DURING, FailureKind.TIME, Blame.ACTION, "timed out"
    LOST = "lost", Phase.DURING, FailureKind.SERVER, Blame.SERVER, "lost its server"
    AFTER = "after", Phase.AFTER, FailureKind.ACTION
    """The recovery's own condition holds after success."""
    EFFECTS_MISSING = "effects_missing", Phase.AFTER, FailureKind.ACTION
    INVARIANT_FALSE = "invariant_false", NoRecovery.CALL, FailureKind.CONDITION
    TOO_LATE = "too_late", NoRecovery.CALL, FailureKind.TIME
    """Its deadline, or the time of its latest start, has passed before it was sent."""
    DEADLINE_MISSED = "deadline_missed", NoRecovery.CALL, FailureKind.TIME
    WITHHELD = "withheld", NoRecovery.CALL, FailureKind.SERVER, Blame.WORLD, "has waited in vain for resources of others"
    """Its resources belong to requests that were given up."""
    LOOP_LIMIT = "loop_limit", NoRecovery.STEP, FailureKind.ACTION
    """All rounds of a loop are spent."""
    CONDITION_UNKNOWN = "condition_unknown", NoRecovery.STEP, FailureKind.ACTION
    """The condition of a loop or a choice is neither true nor false."""
    RESTART_LIMIT = "restart_limit", NoRecovery.PLAN, FailureKind.ACTION
    """The plan shall begin anew once more, and has done so as often as it may."""
    GOAL_FALSE = "goal_false", NoRecovery.PLAN, FailureKind.ACTION
    """Every step is done, and the goal of the plan does not hold."""
    WAIT_LIMIT = "wait_limit", NoRecovery.STEP, FailureKind.TIME
    """The condition that is waited for has not become true in time."""


ASKED: Final = frozenset({Cause.BEFORE, Cause.AFTER})
"""Causes that each recovery has a condition of its own for."""


def causes_in(phase: Phase) -> frozenset[Cause]:
    """Return the causes of a phase that need no condition of a recovery."""
    return frozenset(cause for cause in Cause if cause.phase is phase) - ASKED
