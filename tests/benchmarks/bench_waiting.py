"""What runs cost that wait: for facts to change, and for resources. Not a test: `python tests/benchmarks/bench_waiting.py`."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from uuid import UUID

sys.path.insert(0, str(Path(__file__).parents[2]))

from planner_bridge.tasks.constraint_monitor import ConstraintMonitor
from pnm.core.execution.events import Begin, KnowledgeChanged, ResourcesChanged, Send
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.conditions import Holds
from pnm.core.logic.trajectory import Constraint
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import ActionCall, GroundAction, PlanGraph
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind
from pnm.core.resources import Resources
from tests.support.runs.timing import seconds
from tests.support.tasks.constraints import TO_C


def changes() -> None:
    """A fact changes: one that nothing mentions, and one that one of many conditions over all, or constraints, does."""
    for count in (100, 10_000):
        known = {("fit", f"r{index}"): True for index in range(count)}
        conditions = [Holds(fluent) for fluent in known]
        calls = tuple(ActionCall(index, GroundAction("drive", invariant=condition)) for index, condition in enumerate(conditions))
        world = KnowledgeBase(known)
        run = Run(generate(PlanGraph(calls)), Layered(world), id=UUID(int=1))
        for command in run.handle(Begin(), 0.0):
            if isinstance(command, Send):
                run.handle(Accepted(command.request.id), 0.0)
        report("conditions over all", count, world, lambda run=run: run.handle(KnowledgeChanged(), 0.0))  # type: ignore[misc]
        world, constraints = KnowledgeBase(known), tuple(Constraint("always", (condition,)) for condition in conditions)
        monitor = ConstraintMonitor(replace(TO_C, constraints=constraints), Layered(world))
        report("constraints", count, world, lambda monitor=monitor: (monitor.look(0.0), monitor.next_look(0.0)))  # type: ignore[misc]


def report(what: str, count: int, world: KnowledgeBase, look: Callable[[], object]) -> None:
    """Print how long it takes to hear of a change."""
    look()
    took = []
    for fluent in (("other",), ("fit", "r5")):
        times = []
        for value in range(2, 100):
            began = time.perf_counter()
            world.update({fluent: value})
            look()
            times.append(time.perf_counter() - began)
        took.append(min(times) * 1e6)
    print(f"a change among {count} {what}: {took[0]:.1f} us if none mentions it (at most 5), {took[1]:.1f} us if one does (at most 50)")


def one_resource() -> None:
    """Runs that all want the same resource; each hears of it whenever it may be free."""
    bindings = Bindings({"lift": Binding(resources=("lift",))})
    machine = generate(PlanGraph((ActionCall(0, GroundAction("lift")),)), bindings)
    costs = {}
    for count in (25, 200, 1_000):
        pool, world = Resources(), KnowledgeBase()
        runs = [
            Run(machine, Layered(world), id=UUID(int=number << 96), bindings=bindings, resources=pool) for number in range(1, count + 1)
        ]
        told: dict[Run, None] = {}
        for run in runs:
            pool.listen(lambda run=run, told=told: told.setdefault(run), run.task)  # type: ignore[misc]
        costs[count] = seconds(lambda runs=runs, told=told: in_turn(runs, told), 1) / count * 1e6  # type: ignore[misc]
    print(f"runs that want one resource: {', '.join(f'{count}: {cost:.0f} us' for count, cost in costs.items())} a call")


def in_turn(runs: list[Run], told: dict[Run, None]) -> None:
    """Have every run carry out its call."""
    sent = [(run, command) for run in runs for command in run.handle(Begin(), 0.0) if isinstance(command, Send)]
    while sent:
        run, command = sent.pop()
        run.handle(Accepted(command.request.id), 0.0)
        run.handle(Ended(command.request.id, Outcome(OutcomeKind.SUCCEEDED)), 0.0)
        run.retire()
        heard = [*told]
        told.clear()
        sent += [(one, new) for one in heard for new in one.handle(ResourcesChanged(), 0.0) if isinstance(new, Send)]
    assert all(run.over for run in runs)


if __name__ == "__main__":
    changes()
    one_resource()
