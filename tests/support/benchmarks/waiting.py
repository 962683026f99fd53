"""Runs that wait: for facts to change, and for resources."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from uuid import UUID

from planner_bridge.tasks.constraint_monitor import ConstraintMonitor
from pnm.core.execution.events import Begin, KnowledgeChanged, ResourcesChanged, Send
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.conditions import Holds
from pnm.core.logic.expressions import Fluent
from pnm.core.logic.trajectory import Constraint
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import ActionCall, GroundAction, PlanGraph
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind
from pnm.core.resources import Resources
from tests.support.benchmarks.peers.worker import each
from tests.support.tasks.constraints import TO_C


def over_all(count: int) -> tuple[KnowledgeBase, Callable[[], object]]:
    """So many calls under way, each with a condition over all: their world, and the look at what has changed in it."""
    world = KnowledgeBase({("fit", f"r{index}"): True for index in range(count)})
    calls = tuple(ActionCall(index, GroundAction("drive", invariant=Holds(("fit", f"r{index}")))) for index in range(count))
    run = Run(generate(PlanGraph(calls)), Layered(world), id=UUID(int=1))
    for command in run.handle(Begin(), 0.0):
        if isinstance(command, Send):
            run.handle(Accepted(command.request.id), 0.0)
    return world, lambda: run.handle(KnowledgeChanged(), 0.0)


def constrained(count: int) -> tuple[KnowledgeBase, Callable[[], object]]:
    """The same of so many constraints."""
    known = {("fit", f"r{index}"): True for index in range(count)}
    world, constraints = KnowledgeBase(known), tuple(Constraint("always", (Holds(fluent),)) for fluent in known)
    monitor = ConstraintMonitor(replace(TO_C, constraints=constraints), Layered(world))
    return world, lambda: (monitor.look(0.0), monitor.next_look(0.0))


def heard(world: KnowledgeBase, look: Callable[[], object], fluent: Fluent) -> float:
    """Return the shortest time, in microseconds, in which a change of the fluent is recorded and looked at."""
    look()
    times = []
    for value in range(2, 100):
        began = time.perf_counter()
        world.update({fluent: value})
        look()
        times.append(time.perf_counter() - began)
    return min(times) * 1e6


def taking_turns(count: int) -> float:
    """Return the microseconds that a call takes while so many runs want its resource; each hears of it whenever it may be free."""
    bindings = Bindings({"lift": Binding(resources=("lift",))})
    machine = generate(PlanGraph((ActionCall(0, GroundAction("lift")),)), bindings)
    pool, world = Resources(), KnowledgeBase()
    runs = [Run(machine, Layered(world), id=UUID(int=number << 96), bindings=bindings, resources=pool) for number in range(1, count + 1)]
    told: dict[Run, None] = {}
    for run in runs:
        pool.listen(lambda run=run: told.setdefault(run), run.task)  # type: ignore[misc]
    return each(lambda: in_turn(runs, told), count)


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
