"""Problem → Plan: Kairos in this process by default, any other engine in a child process, or several at once.

Every plan is validated before it is returned. A limit in seconds bounds every search, and a
search can be cancelled from another thread.
"""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Final

from planner_bridge.model.plan import PlanningResult, Stop
from planner_bridge.model.problem import Problem
from planner_bridge.planning.kairos import DEFAULT_PLANNER, accepted, has_task_network, kairos_plan
from planner_bridge.planning.search import search
from planner_bridge.planning.validate import validated

if TYPE_CHECKING:
    from concurrent.futures import Executor

RACE: Final = "race"
_RACE_OF: Final = f"{RACE}:"


def solve(
    problem: Problem,
    *,
    planner: str = DEFAULT_PLANNER,
    timeout: float = 30.0,
    cancel: Stop | None = None,
    executor: Executor | None = None,
) -> PlanningResult:
    """Search for a plan, at most `timeout` seconds, and validate it.

    Args:
        problem: what is to be solved.
        planner: kairos, an engine of unified-planning, ``race`` for several at once, or ``race:kairos,aries`` for these.
        timeout: seconds that the search may take, besides the time to load a planner.
        cancel: set from elsewhere when nobody wants the plan any more.
        executor: runs the planners of a race; a process pool by default.

    Raises:
        InputError: the planner refuses the problem, is not known, or is not installed.
    """
    stop = cancel or threading.Event()
    if planner == RACE or planner.startswith(_RACE_OF):
        from planner_bridge.planning.portfolio import race  # here, because most searches are no races

        named = None if planner == RACE else _named(planner)
        return race(problem, planners=named, timeout=timeout, executor=executor, cancel=stop)
    if planner == DEFAULT_PLANNER and not has_task_network(problem):
        loaded = accepted(problem)
        return validated(problem, kairos_plan(loaded, problem, timeout, stop), loaded)
    return validated(problem, search(problem, planner, timeout, stop))


def check_planner(planner: str, cancel: Stop | None = None) -> None:
    """See to it that there is such a planner, before anybody needs it; one that we do not know ourselves takes some seconds.

    Args:
        planner: as for `solve`.
        cancel: set from elsewhere when nobody wants to know any more.

    Raises:
        InputError: it is not known, or something has to be installed first.
    """
    if planner in (DEFAULT_PLANNER, RACE):
        return
    if planner.startswith(_RACE_OF):
        from planner_bridge.planning.portfolio import check_entrants  # here and below, because Kairos needs neither

        check_entrants(_named(planner))
    else:
        from planner_bridge.planning.engine_process import check_engine

        check_engine(planner, cancel or threading.Event())


def _named(race: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in race.removeprefix(_RACE_OF).split(","))


# --- validation ----------------------------------------------------------------------------


# --- Kairos --------------------------------------------------------------------------------
