"""Causes: why a step recovers or fails. Whatever depends on the cause alone is a trait of it, and stands here."""

from __future__ import annotations

from enum import Enum, StrEnum, auto
from typing import Final, Self


class Phase(Enum):
    """When something is wrong with a call. A plan's own recoveries are sorted by it."""

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


class Trouble(Enum):
    """The kind of trouble that a task ends with which does not get past it."""

    ACTION = auto()
    CONDITION = auto()
    TIME = auto()
    SERVER = auto()


class Blame(Enum):
    """What a new plan has to do without, when it happens again and again."""

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
        trouble: which kind it is.
        blame: whom it speaks against. A condition over all that breaks speaks against the action: it was under way, as when its robot
            notices that itself and aborts.
        happened: what has become of a call, as the predicate of a sentence.
    """

    phase: Phase | NoRecovery
    trouble: Trouble
    blame: Blame
    happened: str

    def __new__(cls, value: str, phase: Phase | NoRecovery, trouble: Trouble, blame: Blame = Blame.ACTION, happened: str = "") -> Self:
        """Make a member of its traits."""
        cause = str.__new__(cls, value)
        cause._value_ = value
        cause.phase, cause.trouble, cause.blame, cause.happened = phase, trouble, blame, happened or f"failed: {value}"
        return cause

    BEFORE = "before", Phase.BEFORE, Trouble.ACTION
    """The recovery's own condition holds before the start."""
    PRECONDITION_FALSE = "precondition_false", Phase.BEFORE, Trouble.CONDITION, Blame.WORLD
    DATA_MISSING = "data_missing", Phase.BEFORE, Trouble.CONDITION
    REJECTED = "rejected", Phase.DURING, Trouble.SERVER, Blame.ACTION, "was rejected"
    UNAVAILABLE = "unavailable", Phase.DURING, Trouble.SERVER, Blame.SERVER, "found no server"
    ABORTED = "aborted", Phase.DURING, Trouble.ACTION, Blame.ACTION, "was aborted"
    CANCELED = "canceled", Phase.DURING, Trouble.ACTION, Blame.ACTION, "was cancelled"
    TIMED_OUT = "timed_out", Phase.DURING, Trouble.TIME, Blame.ACTION, "timed out"
    LOST = "lost", Phase.DURING, Trouble.SERVER, Blame.SERVER, "lost its server"
    AFTER = "after", Phase.AFTER, Trouble.ACTION
    """The recovery's own condition holds after success."""
    EFFECTS_MISSING = "effects_missing", Phase.AFTER, Trouble.ACTION
    INVARIANT_FALSE = "invariant_false", NoRecovery.CALL, Trouble.CONDITION
    TOO_LATE = "too_late", NoRecovery.CALL, Trouble.TIME
    """Its deadline, or the time of its latest start, has passed before it was sent."""
    DEADLINE_MISSED = "deadline_missed", NoRecovery.CALL, Trouble.TIME
    WITHHELD = "withheld", NoRecovery.CALL, Trouble.SERVER, Blame.WORLD, "has waited in vain for what others keep"
    """Its resources belong to requests that were given up."""
    LOOP_LIMIT = "loop_limit", NoRecovery.STEP, Trouble.ACTION
    """All rounds of a loop are spent."""
    CONDITION_UNKNOWN = "condition_unknown", NoRecovery.STEP, Trouble.ACTION
    """The condition of a loop or a choice is neither true nor false."""
    RESTART_LIMIT = "restart_limit", NoRecovery.PLAN, Trouble.ACTION
    """The plan shall begin anew once more, and has done so as often as it may."""
    GOAL_FALSE = "goal_false", NoRecovery.PLAN, Trouble.ACTION
    """Every step is done, and the goal of the plan does not hold."""
    WAIT_LIMIT = "wait_limit", NoRecovery.STEP, Trouble.TIME
    """The condition that is waited for has not become true in time."""


ASKED: Final = frozenset({Cause.BEFORE, Cause.AFTER})
"""Causes that each recovery has a condition of its own for."""


def causes_in(phase: Phase) -> frozenset[Cause]:
    """Return the causes of a phase that need no condition of a recovery."""
    return frozenset(cause for cause in Cause if cause.phase is phase) - ASKED
