"""Runs of small plans on simulated robots, under virtual time, compared with the world's own truth."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from functools import wraps
from typing import Any, ParamSpec

from planner_bridge.model.problem import Problem
from planner_bridge.model.world import robots_of
from pnm.actions.backend import SimulatedBackend
from pnm.actions.faults import NO_FAULTS, Fault, FaultKind, Faults, HiddenChange
from pnm.actions.simulated_robots import SimulatedRobots, SimulatedWorld, report_changes
from pnm.clock import run_async
from pnm.core.execution.call_results import RunResult
from pnm.core.execution.events import Fired, Observer
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.conditions import Holds
from pnm.core.logic.effects import Set
from pnm.core.logic.expressions import Constant, Fluent, Value
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.generate import generate
from pnm.core.machine.machine import OnFailure
from pnm.core.machine.plan_graph import GroundAction, PlanGraph
from pnm.core.machine.verification.verify import verify
from pnm.executor import Executor
from tests.support.processes import LIMIT
from tests.support.runs.commands import RUN

P = ParamSpec("P")


def on_a_loop(test: Callable[P, Coroutine[Any, Any, None]]) -> Callable[P, None]:
    """Run a test that is a coroutine; it may not hang."""

    @wraps(test)
    def run(*args: P.args, **kwargs: P.kwargs) -> None:
        asyncio.run(asyncio.wait_for(test(*args, **kwargs), LIMIT))

    return run


def in_virtual_time(test: Callable[P, Coroutine[Any, Any, None]]) -> Callable[P, None]:
    """Run a test that is a coroutine, in virtual time; it may not hang."""

    @wraps(test)
    def run(*args: P.args, **kwargs: P.kwargs) -> None:
        run_async(asyncio.wait_for(test(*args, **kwargs), 10_000.0), virtual=True)

    return run


def move(robot: str, here: str, there: str, duration: float = 4.0) -> GroundAction:
    """A robot goes from one place to another; on the way it is nowhere."""
    return GroundAction(
        "move",
        (robot, here, there),
        ("robot", "from", "to"),
        precondition=Holds(("at", robot, here)),
        start_effects=(Set(("at", robot, here), Constant(False)),),
        end_effects=(Set(("at", robot, there), Constant(True)),),
        duration=duration,
    )


def fault(what: str, kind: FaultKind, **options: object) -> Faults:
    """One fault."""
    return Faults((Fault(what, kind, **options),))  # type: ignore[arg-type]


def hidden(changes: dict[Fluent, Value], **when: object) -> Faults:
    """One change behind the robots' backs."""
    return Faults(changes=(HiddenChange(changes, **when),))  # type: ignore[arg-type]


@dataclass
class FiringLog(Observer):
    """Writes down what fired, and when."""

    fired_at: list[tuple[float, str]] = field(default_factory=list)
    orphans: list[object] = field(default_factory=list)

    def fired(self, fired: Fired, now: float) -> None:
        self.fired_at.append((now, fired.name))

    def orphaned(self, report: object, now: float) -> None:
        self.orphans.append(report)

    def times(self, name: str) -> list[float]:
        return [time for time, transition in self.fired_at if transition.endswith(name)]


@dataclass
class SimulatedRun:
    """A finished run, the world it was in, and what the robots believed."""

    result: RunResult
    truth: KnowledgeBase
    beliefs: KnowledgeBase
    run: Run
    log: FiringLog

    def outcomes(self) -> list[str]:
        return [call.outcome for call in self.result.calls]

    def attempts(self) -> list[int]:
        return [call.attempts for call in self.result.calls]

    def causes(self) -> list[str]:
        return [failure.cause for failure in self.result.failures]


def simulate(
    plan: PlanGraph,
    init: dict[Fluent, Value],
    faults: Faults = NO_FAULTS,
    *,
    bindings: Bindings | None = None,
    on_failure: OnFailure = OnFailure.DRAIN,
    watched: bool = True,
) -> SimulatedRun:
    """Run a plan to its end. Unless `watched`, nothing reports what the world is like."""
    chosen = bindings or Bindings()
    truth = KnowledgeBase(init)
    world = SimulatedWorld(truth, {fluent[0] for fluent in init} | {"at"})
    beliefs = KnowledgeBase(init)
    robots = SimulatedRobots(world, faults, chosen)
    log = FiringLog()
    machine = generate(plan, chosen, on_failure=on_failure)
    verify(machine)
    run = Run(machine, Layered(beliefs), id=RUN, bindings=chosen, goal_fields=robots.goal_fields, observer=log)

    async def main() -> RunResult:
        if watched:
            report_changes(world, beliefs)
        robots.begin()
        return await Executor(run, robots).execute()

    return SimulatedRun(run_async(main(), virtual=True), truth, beliefs, run, log)


class LateBackend(SimulatedBackend):
    """Simulated robots whose sensors report 0.3 s late."""

    def __init__(self, problem: Problem, bindings: Bindings, faults: Faults) -> None:
        super().__init__(robots_of(problem, bindings, faults), bindings.assumed)

    async def open(self, knowledge: KnowledgeBase) -> None:
        loop, world = asyncio.get_running_loop(), self.robots.world
        names = world.reported(self._assumed)
        knowledge.sense(names, lag=1.0)
        knowledge.replace(names, world.report(names))
        world.truth.listen(lambda _: loop.call_later(0.3, lambda: knowledge.replace(names, world.report(names))) and None)
        self.robots.begin()
