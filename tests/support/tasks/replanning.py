"""Tasks that are pursued in simulation to their end: what they decided on the way, and what is true then."""

from __future__ import annotations

from planner_bridge.model.problem import Problem
from planner_bridge.model.world import simulated_backend
from planner_bridge.pipeline.achieve import achieve_at
from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.result import TaskResult
from planner_bridge.tasks.settings import Settings, TaskObserver
from pnm.actions.faults import NO_FAULTS, Fault, FaultKind, Faults
from pnm.clock import run_async
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import evaluate
from pnm.core.machine.bindings import Bindings


def pursued(
    problem: Problem,
    faults: Faults = NO_FAULTS,
    settings: Settings | None = None,
    *,
    limits: Limits = Limits(),
    bindings: Bindings = Bindings(),
) -> tuple[TaskResult, KnowledgeBase]:
    """Pursue the goal of the problem and return the result with the truth; without constraints the verdict must be true to the world."""
    settings = settings or Settings(limits=limits, bindings=bindings)
    backend = simulated_backend(problem, settings.bindings, faults)
    result = run_async(achieve_at(backend, problem, settings, TaskObserver()), virtual=True)
    truth = backend.robots.world.truth
    assert problem.constraints or problem.network or result.goal_reached == (evaluate(problem.goal, truth) is True)
    return result, truth


def decisions(result: TaskResult) -> list[type]:
    return [type(episode.decision) for episode in result.episodes if episode.decision]


def aborts(what: str, times: int | None = None) -> Faults:
    return Faults((Fault(what, FaultKind.ABORT, times=times),))
