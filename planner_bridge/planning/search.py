"""The search of one planner: Kairos in this process, any other engine in a child process."""

from __future__ import annotations

from dataclasses import replace

from planner_bridge.model.plan import PlanningResult, PlanningStatus, Stop
from planner_bridge.model.problem import Problem
from planner_bridge.planning.kairos import DEFAULT_PLANNER, accepted, has_task_network, kairos_plan


def search(problem: Problem, planner: str, timeout: float, cancel: Stop) -> PlanningResult:
    """Search with one planner; its plan is still to be validated.

    Raises:
        InputError: as `solve`.
    """
    if planner == DEFAULT_PLANNER and has_task_network(problem):
        message = "task networks, which aries plans for (--planner aries)"
        return PlanningResult(PlanningStatus.UNSUPPORTED, message=message, planner=planner)
    if planner == DEFAULT_PLANNER:
        return kairos_plan(accepted(problem), problem, timeout, cancel)
    from planner_bridge.planning.engine_process import solve_in_child  # here, because Kairos needs no child

    return replace(solve_in_child(problem, planner, timeout, cancel), planner=planner)
