"""The story: problem → plan → plan graph → machine → run, and again from the world as it then is."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeAlias

from planner_bridge.loading import load
from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.problem import Domain, Problem
from planner_bridge.simulation import simulated_backend
from planner_bridge.tasks.context import Mission
from planner_bridge.tasks.goal_loop import Pursuit
from planner_bridge.tasks.replanning import History
from planner_bridge.tasks.result import Stopwatch, TaskResult
from planner_bridge.tasks.settings import Settings, TaskObserver
from pnm.actions.backend import Backend
from pnm.actions.faults import NO_FAULTS, Faults
from pnm.clock import run_async, stop_then_cancel
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.ros.backend import Ros2Backend
from pnm.tasks import Code

Where: TypeAlias = Literal["simulated", "ros2"]


def achieve(
    domain: Path | str | Domain | None,
    problem: Path | str | Problem | Any,
    *,
    actions: Where = "simulated",
    faults: Faults = NO_FAULTS,
    settings: Settings | None = None,
    observer: TaskObserver | None = None,
    stopwatch: Stopwatch | None = None,
) -> TaskResult:
    """Pursue the goal of the problem until it holds or cannot be reached.

    Args:
        domain: a file or a Domain; not needed when `problem` is a Problem.
        problem: a file, a Problem, or a Problem of unified-planning.
        actions: simulated robots under virtual time, or the action servers of ROS 2.
        faults: what goes wrong in simulation.
        settings: planner, bindings and limits.
        observer: is told what happens.
        stopwatch: measures where the time goes; one that has run before goes on.

    Raises:
        InputError: an input is wrong; nothing was started.
    """
    chosen = settings or Settings()
    seconds = stopwatch or Stopwatch()
    with seconds.of("parse"):
        loaded = load(domain, problem)
    site: Backend = (
        Ros2Backend(chosen.bindings, sensing=chosen.sensing) if actions == "ros2" else simulated_backend(loaded, chosen.bindings, faults)
    )
    task = pursue(loaded, site, chosen, observer or TaskObserver(), seconds)
    return run_async(task, virtual=actions == "simulated")


async def pursue(problem: Problem, site: Backend, settings: Settings, observer: TaskObserver, seconds: Stopwatch) -> TaskResult:
    """Plan, execute and replan at a site; `achieve` does this with a loop of its own."""
    knowledge = initial_knowledge(problem)
    try:
        return await _stoppable(Pursuit(Mission(problem, site, settings, observer, seconds, Layered(knowledge))), opens=True)
    finally:
        await site.close()


async def pursue_on(
    problem: Problem,
    site: Backend,
    settings: Settings,
    observer: TaskObserver,
    seconds: Stopwatch,
    *,
    knowledge: KnowledgeBase,
    history: History,
) -> TaskResult:
    """Plan, execute and replan at a site that is open and keeps the knowledge up to date, after what has happened before."""
    return await _stoppable(Pursuit(Mission(problem, site, settings, observer, seconds, Layered(knowledge)), history=history))


async def _stoppable(pursuit: Pursuit, *, opens: bool = False) -> TaskResult:
    """Pursue a goal. Cancelling this stops the task: what is under way is cancelled and waited for; cancelling it again leaves it alone."""
    return await stop_then_cancel(pursuit.pursue(opens=opens), partial(pursuit.stop, Code.CANCELLED, "cancelled"))
