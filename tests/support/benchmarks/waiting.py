"""Runs that wait: for facts to change, and for resources."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Final, TypeVar
from uuid import UUID

from planner_bridge.model.world import robots_of
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.pipeline.goal_handle import GoalHandle
from planner_bridge.tasks.constraint_monitor import ConstraintMonitor
from planner_bridge.tasks.result import Stopwatch
from planner_bridge.tasks.settings import OnChange, Settings, TaskObserver
from pnm.actions.backend import SimulatedBackend
from pnm.actions.faults import NO_FAULTS
from pnm.clock import run_async
from pnm.core.execution.events import Begin, ResourcesChanged, Send
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.conditions import Holds
from pnm.core.logic.expressions import Fluent
from pnm.core.logic.trajectory import Constraint
from pnm.core.machine.bindings import NO_BINDINGS, Binding, Bindings
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import ActionCall, GroundAction, PlanGraph
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind
from pnm.core.resources import Resources
from tests.support.benchmarks.peers.worker import each
from tests.support.tasks.constraints import TO_C

T = TypeVar("T")

_ROUNDS: Final = 4
"""Of the event loop, in which everybody has heard of a change."""

_FLEET = """
(define (domain fleet) (:requirements :typing :durative-actions :numeric-fluents :derived-predicates) (:types robot)
  (:predicates (arrived ?r - robot) (idle ?r - robot)) (:functions (charge ?r - robot))
  (:derived (idle ?r - robot) (arrived ?r))
  (:durative-action drive :parameters (?r - robot) :duration (= ?duration 1000)
    :condition (over all (>= (charge ?r) 1)) :effect (at end (arrived ?r))))
"""
CHARGE: Fluent = ("charge", "r3")
"""What one of the conditions reads."""


class Fleet(SimulatedBackend):
    """So many robots under way for a goal, each on the condition that its battery is charged: the whole way from the goal on."""

    def __init__(self, count: int) -> None:
        robots = [f"r{index}" for index in range(count)]
        text = f"(define (problem p) (:domain fleet) (:objects {' '.join(robots)} - robot) "
        text += f"(:init {' '.join(f'(= (charge {robot}) 9)' for robot in robots)}) "
        text += f"(:goal (and {' '.join(f'(arrived {robot})' for robot in robots)})))"
        self.problem = parse_problem(text, parse_domain(_FLEET))
        super().__init__(robots_of(self.problem, NO_BINDINGS, NO_FAULTS), NO_BINDINGS.assumed)
        self.known = KnowledgeBase()

    async def open(self, knowledge: KnowledgeBase) -> None:
        """Connect, and remember what is known."""
        self.known = knowledge
        await super().open(knowledge)

    def under_way(self, on_change: OnChange, work: Callable[[Fleet], Awaitable[T]]) -> T:
        """Do some work while all robots are under way; return what has come of it."""

        async def main() -> T:
            handle = GoalHandle(self, self.problem, Settings(improve=0.0, on_change=on_change), TaskObserver(), Stopwatch()).begin()
            await asyncio.sleep(500.0)
            found = await work(self)
            await handle.stop()
            return found

        return run_async(main(), virtual=True)

    async def change(self, fluent: Fluent, value: float) -> None:
        """Have a fact change as sensors report it, and all that wait for it look at it."""
        self.known.update({fluent: value})
        for _ in range(_ROUNDS):
            await asyncio.sleep(0.0)


def fact(count: int, on_change: OnChange, fluent: Fluent) -> float:
    """Return the shortest time, in microseconds, of a change of a fact while so many robots are under way."""

    async def shortest(fleet: Fleet) -> float:
        times = []
        for value in range(10, 110):
            began = time.perf_counter()
            await fleet.change(fluent, float(value))
            times.append(time.perf_counter() - began)
        return min(times) * 1e6

    return Fleet(count).under_way(on_change, shortest)


def constrained(count: int) -> tuple[KnowledgeBase, Callable[[], object]]:
    """So many constraints: their world, and the look at what has changed in it."""
    known = {("fit", f"r{index}"): True for index in range(count)}
    world, constraints = KnowledgeBase(known), tuple(Constraint("always", (Holds(fluent),)) for fluent in known)
    monitor = ConstraintMonitor(replace(TO_C, constraints=constraints), Layered(world))
    return world, lambda: (monitor.look(0.0), monitor.next_look())


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
