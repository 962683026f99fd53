"""The search of one planner: Kairos in this process, or an engine of unified-planning in a process of its own."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from planner_bridge.model.plan import CancelToken, PlanningResult, PlanningStatus
from planner_bridge.model.problem import Problem
from planner_bridge.planning.kairos import DEFAULT_PLANNER, has_task_network, parse_for_kairos, search_with_kairos

if TYPE_CHECKING:
    import kairos


def search(problem: Problem, planner: str, timeout: float, cancel: CancelToken, parsed: kairos.Problem | None = None) -> PlanningResult:
    """Search with one planner; its plan is not validated yet.

    Args:
        problem: what is to be solved.
        planner: kairos or an engine of unified-planning.
        timeout: seconds that the search may take, besides the time to load an engine.
        cancel: set from another thread to end the search.
        parsed: the problem as Kairos reads it, if that is there already.

    Raises:
        InputError: the planner refuses the problem, is not known, or is not installed.
    """
    if planner != DEFAULT_PLANNER:
        from planner_bridge.planning.engine_process import search_with_engine  # here, because Kairos needs no process

        return replace(search_with_engine(problem, planner, timeout, cancel), planner=planner)
    if has_task_network(problem):
        message = "task networks, which aries plans for (--planner aries)"
        return PlanningResult(PlanningStatus.UNSUPPORTED, message=message, planner=planner)
    return search_with_kairos(problem, parsed or parse_for_kairos(problem), timeout, cancel)
