"""Plans that are run one after the other in one simulated world, by what is known of it."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from functools import update_wrapper
from inspect import Signature
from typing import Any as Anything
from uuid import uuid4

from planner_bridge.model.grounding import initial_knowledge, problem_now
from planner_bridge.model.plan import Plan, PlanStep
from planner_bridge.model.problem import Problem
from planner_bridge.model.world import simulated_backend
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.tasks.replanning import Decision, History, Limits, Progress, decide
from pnm.actions.backend import SimulatedBackend
from pnm.actions.faults import NO_FAULTS, Faults, HiddenChange
from pnm.clock import run_async
from pnm.core.execution.call_results import RunResult
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import Layered
from pnm.core.logic.expressions import Fluent, Value
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import PlanGraph
from pnm.core.machine.verification.verify import verify
from pnm.executor import Executor


@dataclass
class SimulatedSite:
    """A simulated world, and what is known of it, for one run after the other."""

    problem: Problem
    backend: SimulatedBackend
    knowledge: Layered
    bindings: Bindings

    async def run(self, graph: PlanGraph) -> RunResult:
        machine = generate(graph, self.bindings)
        verify(machine)
        fields = self.backend.client.goal_fields
        return await Executor(
            Run(machine, self.knowledge, id=uuid4(), bindings=self.bindings, goal_fields=fields), self.backend.client
        ).execute()

    async def carry_out(self, *steps: str) -> RunResult:
        """Run a plan of the problem, whose steps are written as for `timed`."""
        return await self.run(plan_graph(self.problem, timed(*steps)))

    def truth(self, fluent: Fluent) -> object:
        return self.backend.robots.world.truth.value(fluent)

    def now(self) -> Problem:
        return problem_now(self.problem, self.knowledge.world)

    def decide(self, graph: PlanGraph, result: RunResult) -> Decision:
        history = History().after(result.calls, result.failures)
        return decide(self.now(), Progress(graph, result.calls), self.knowledge.world, history, Limits())[0]


Scenario = Callable[[SimulatedSite], Coroutine[Anything, Anything, None]]


def on_site(problem: Problem, faults: Faults = NO_FAULTS, bindings: Bindings = Bindings()) -> Callable[[Scenario], Callable[[], None]]:
    """Run a test in such a world."""

    def wrap(scenario: Scenario) -> Callable[[], None]:
        async def main() -> None:
            site = SimulatedSite(problem, simulated_backend(problem, bindings, faults), Layered(initial_knowledge(problem)), bindings)
            await site.backend.open(site.knowledge.world)
            try:
                await scenario(site)
            finally:
                await site.backend.close()

        def test() -> None:
            run_async(main(), virtual=True)

        update_wrapper(test, scenario)
        test.__signature__ = Signature()  # type: ignore[attr-defined]  # by which pytest knows that a test is given nothing
        return test

    return wrap


def timed(*steps: str) -> Plan:
    """Steps such as ``"0 4 go r1 a b"``: when, how long, what."""
    found = [step.split() for step in steps]
    return Plan(tuple(PlanStep(one[2], tuple(one[3:]), float(one[0]), float(one[1])) for one in found), temporal=True)


def change_at(when: float, changes: dict[Fluent, Value]) -> Faults:
    return Faults(changes=(HiddenChange(changes, at=when),))
