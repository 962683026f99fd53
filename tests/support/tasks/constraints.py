"""Constraints of tasks, and what an observer of such a task hears."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field

from planner_bridge.model.grounding import problem_now
from planner_bridge.model.problem import Problem
from planner_bridge.model.world import simulated_backend
from planner_bridge.pipeline.achieve import achieve_at
from planner_bridge.tasks.constraint_monitor import ConstraintMonitor
from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.result import TaskResult, Violation
from planner_bridge.tasks.settings import Settings, TaskObserver
from pnm.actions.backend import SimulatedBackend
from pnm.actions.faults import NO_FAULTS, Faults, HiddenChange
from pnm.clock import run_async
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.conditions import Condition
from pnm.core.logic.trajectory import Constraint
from pnm.core.machine.bindings import Bindings
from tests.support.pddl.problems import rooms

TO_C = rooms(init="(at r1 a)", goal="(at r1 c)", ways="ab bc")
"""Two moves of a second each, from a over b to c."""


def within(seconds: float, condition: Condition) -> Constraint:
    return Constraint("within", (condition,), (seconds,))


def changes(*times: tuple[float, str], value: bool = True) -> Faults:
    """Rooms that become clean behind the robots' backs; or, with ``not``, dirty."""
    return Faults(changes=tuple(HiddenChange({("clean", room[-1]): "not" not in room}, at=time) for time, room in times))


@dataclass
class ViolationLog(TaskObserver):
    """Writes down which constraints are violated, when that is told, and how often a planner is asked."""

    told: list[tuple[float, Violation]] = field(default_factory=list)
    asked: int = 0

    def planning(self, planner: str) -> None:
        self.asked += 1

    def violated(self, violation: Violation, now: float) -> None:
        self.told.append((now, violation))


@dataclass
class MonitoredTask:
    """A task that is over."""

    result: TaskResult
    log: ViolationLog
    truth: KnowledgeBase
    ended: float

    def outcomes(self) -> list[str]:
        return [call.outcome for call in self.result.calls]

    def statuses(self) -> list[str]:
        return [one.status for one in self.result.constraints]


def monitored(
    problem: Problem,
    faults: Faults = NO_FAULTS,
    *,
    limits: Limits = Limits(),
    bindings: Bindings = Bindings(),
    backend: SimulatedBackend | None = None,
) -> MonitoredTask:
    backend, log = backend or simulated_backend(problem, bindings, faults), ViolationLog()

    async def main() -> tuple[TaskResult, float]:
        result = await achieve_at(backend, problem, Settings(limits=limits, bindings=bindings), log)
        return result, asyncio.get_running_loop().time()

    result, ended = run_async(main(), virtual=True)
    return MonitoredTask(result, log, backend.robots.world.truth, ended)


def monitor(problem: Problem, *seen: tuple[float, dict[str, bool]]) -> tuple[ConstraintMonitor, Problem]:
    """Look at which rooms are clean at some times; return also the problem that is left then."""
    world = KnowledgeBase(problem.init, objects=problem.objects_by_type)
    watching = ConstraintMonitor(problem, Layered(world))
    for time, clean in seen:
        world.update({("clean", room): value for room, value in clean.items()})
        watching.look(time)
        watching.look(time + 0.02)
    last = seen[-1][0]
    return watching, watching.rest_of(problem_now(problem, world, last), last)
