"""Problem → plan: solve → search → Kairos in this process, or an engine in a process of its own; a portfolio searches with several.

Every plan is validated before it is returned (`planner_bridge.planning.validate`). A limit in seconds bounds every
search, and what its plan does not need is left out in what remains of it; a search can be cancelled from another thread.
"""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Final

from planner_bridge.model.plan import CancelToken, PlanningResult
from planner_bridge.model.problem import Problem
from planner_bridge.planning.engines import search
from planner_bridge.planning.kairos import DEFAULT_PLANNER, IMPROVE, parse_for_kairos
from planner_bridge.planning.reduction import reduced
from planner_bridge.planning.validate import validated
from pnm.errors import check_kinds, check_seconds

if TYPE_CHECKING:
    from concurrent.futures import Executor

PORTFOLIO: Final = "race"
"""The planner's name for a portfolio of what is installed; ``race:kairos,aries`` names its members."""
_LONGEST: Final = 1e9
"""Seconds that a search may take: the clocks of planners overflow with far more."""
_PORTFOLIO_OF: Final = f"{PORTFOLIO}:"


def solve(
    problem: Problem,
    *,
    planner: str = DEFAULT_PLANNER,
    timeout: float = 30.0,
    improve: float = IMPROVE,
    cancel: CancelToken | None = None,
    executor: Executor | None = None,
) -> PlanningResult:
    """Search for a plan, validate it, and leave out what it does not need, at most `timeout` seconds.

    Args:
        problem: what is to be solved.
        planner: kairos, an engine of unified-planning, ``race`` for several at once, or ``race:kairos,aries`` for these.
        timeout: seconds that the search may take, besides the time to load a planner; a plan that is found late keeps what it has.
        improve: seconds for which Kairos looks for a better plan once there is one, at most; 0 for the first plan.
        cancel: set from another thread to end the search.
        executor: runs the planners of a portfolio; a process pool by default.

    Raises:
        InputError: the planner refuses the problem, is not known, or is not installed.
    """
    check_kinds("solve", {"problem": (problem, Problem), "planner": (planner, str)})
    check_seconds("the search for a plan", timeout)
    check_seconds("the search for a better plan", improve)
    stop, timeout = cancel or threading.Event(), min(timeout, _LONGEST)
    until = time.monotonic() + timeout
    if planner == PORTFOLIO or planner.startswith(_PORTFOLIO_OF):
        from planner_bridge.planning.portfolio import solve_with_portfolio  # here, because most searches use one planner

        members = None if planner == PORTFOLIO else _portfolio_members(planner)
        found = solve_with_portfolio(problem, planners=members, timeout=timeout, executor=executor, cancel=stop)
        return reduced(problem, found, until=until)
    parsed = parse_for_kairos(problem) if planner == DEFAULT_PLANNER else None  # once, for its search and its validator
    found = search(problem, planner, timeout, stop, improve=improve, parsed=parsed)
    return reduced(problem, validated(problem, found, parsed), parsed, until=until)


def check_planner(planner: str, cancel: CancelToken | None = None) -> None:
    """Refuse a planner that is not known or not installed, before it is needed; looking up an unfamiliar name takes some seconds.

    The check can be cancelled from another thread.
    """
    if planner in (DEFAULT_PLANNER, PORTFOLIO):
        return
    if planner.startswith(_PORTFOLIO_OF):
        from planner_bridge.planning.portfolio import check_members  # here and below, because Kairos needs neither

        check_members(_portfolio_members(planner))
    else:
        from planner_bridge.planning.engines import check_engine

        check_engine(planner, cancel or threading.Event())


def _portfolio_members(planner: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in planner.removeprefix(_PORTFOLIO_OF).split(","))
