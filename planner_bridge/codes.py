"""How tasks end, in the codes that clients read."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from planner_bridge.plan import PlanningStatus
from pnm.results import Failure, RunResult
from pnm.tasking import Code

_PLANNING: Final = {
    PlanningStatus.UNSOLVABLE: Code.NO_PLAN,
    PlanningStatus.NO_PLAN: Code.NO_PLAN,
    PlanningStatus.TIMED_OUT: Code.PLANNER_TIMEOUT,
    PlanningStatus.CANCELLED: Code.CANCELLED,
}

_CAUSES: Final = {
    "precondition_false": Code.CONDITION_LOST,
    "invariant_false": Code.CONDITION_LOST,
    "data_missing": Code.CONDITION_LOST,
    "timed_out": Code.TIMED_OUT,
    "too_late": Code.TIMED_OUT,
    "deadline_missed": Code.TIMED_OUT,
    "unavailable": Code.SERVER_UNAVAILABLE,
    "withheld": Code.SERVER_UNAVAILABLE,
    "rejected": Code.SERVER_UNAVAILABLE,
    "lost": Code.SERVER_UNAVAILABLE,
}


def code_of_planning(status: PlanningStatus, failures: Sequence[Failure]) -> Code:
    """Return the code of a task for which no plan was found, after these failures: they are why there is none any more."""
    code = _PLANNING.get(status, Code.PLANNER_ERROR)
    return code_of_failures(failures) if failures and code is Code.NO_PLAN else code


def code_of_run(result: RunResult, stopped: Code) -> Code:
    """Return the code of a task that ends with this run of its plan.

    Args:
        result: how the run ended.
        stopped: the code if it was told to stop.
    """
    if result.goal:
        return Code.GOAL_REACHED
    return stopped if result.stopped else code_of_failures(result.failures)


def code_of_failures(failures: Sequence[Failure]) -> Code:
    """Return the code of a task that ends with these failures, the last of which counts."""
    return _CAUSES.get(failures[-1].cause, Code.ACTION_FAILED) if failures else Code.CONDITION_LOST
