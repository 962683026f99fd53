"""The search of one planner: Kairos in this process, or an engine of unified-planning in a process of its own."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from planner_bridge.model.plan import CancelToken, PlanningResult, PlanningStatus
from planner_bridge.model.problem import Problem
from planner_bridge.planning.kairos import DEFAULT_PLANNER, parse_for_kairos, search_with_kairos

if TYPE_CHECKING:
    import kairos


def search(
    problem: Problem, planner: str, timeout: float, cancel: CancelToken, *, improve: float = 0.0, parsed: kairos.Problem | None = None
) -> PlanningResult:
    """Search with one planner, at most `timeout` seconds besides the time to load it; the plan is not validated yet.

    Args:
        improve: seconds for which Kairos looks for a better plan once there is one; other planners return what they find.
        parsed: the problem as Kairos reads it, if that is there already.
    """
    if planner != DEFAULT_PLANNER:
        from planner_bridge.planning.engine_process import search_with_engine  # here, because Kairos needs no process

        return replace(search_with_engine(problem, planner, timeout, cancel), planner=planner)
    if problem.has_tasks:
        message = "task networks, which aries plans for (--planner aries)"
        return PlanningResult(PlanningStatus.UNSUPPORTED, message=message, planner=planner)
    return search_with_kairos(problem, parsed or parse_for_kairos(problem), timeout, improve, cancel)
