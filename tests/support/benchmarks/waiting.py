"""Runs that wait: for facts to change, and for resources."""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Final, TypeVar
from uuid import UUID

from planner_bridge.model.problem import Problem
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
from pnm.core.logic.conditions import All, Any, Exists, Holds
from pnm.core.logic.expressions import Fluent, Unknown, Value, Variable
from pnm.core.logic.rules import DerivationRule, Rules
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
_HALL = """
(define (domain hall) (:requirements :typing :durative-actions :universal-preconditions) (:types robot lamp)
  (:predicates (lit ?l - lamp) (seen ?r - robot))
  (:durative-action watch :parameters (?r - robot) :duration (= ?duration 1000)
    :condition (over all (forall (?l - lamp) (lit ?l))) :effect (at end (seen ?r))))
"""
LAMP: Fluent = ("lit", "l3")
OTHER: Fluent = ("other",)
"""What no condition reads."""
X, Y, Z = (Variable(name, ("node",)) for name in ("?x", "?y", "?z"))
REACH = DerivationRule(
    "reach", (X, Y), Any((Holds(("edge", "?x", "?y")), Exists((Z,), All((Holds(("edge", "?x", "?z")), Holds(("reach", "?z", "?y")))))))
)
_WIDTH: Final = 10
"""Of a grid."""


def fleet(count: int) -> Problem:
    """So many robots that drive, each on the condition that its battery is charged."""
    robots = [f"r{index}" for index in range(count)]
    text = f"(define (problem p) (:domain fleet) (:objects {' '.join(robots)} - robot) "
    text += f"(:init {' '.join(f'(= (charge {robot}) 9)' for robot in robots)}) "
    text += f"(:goal (and {' '.join(f'(arrived {robot})' for robot in robots)})))"
    return parse_problem(text, parse_domain(_FLEET))


def hall(count: int) -> Problem:
    """A robot that watches a hall, on the condition that all of so many lamps are lit."""
    lamps = [f"l{index}" for index in range(count)]
    text = f"(define (problem p) (:domain hall) (:objects {' '.join(lamps)} - lamp r - robot) "
    text += f"(:init {' '.join(f'(lit {lamp})' for lamp in lamps)}) (:goal (seen r)))"
    return parse_problem(text, parse_domain(_HALL))


class UnderWay(SimulatedBackend):
    """Robots under way for a goal: the whole way from the goal on."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        super().__init__(robots_of(self.problem, NO_BINDINGS, NO_FAULTS), NO_BINDINGS.assumed)
        self.known = KnowledgeBase()

    async def open(self, knowledge: KnowledgeBase) -> None:
        """Connect, and remember what is known."""
        self.known = knowledge
        await super().open(knowledge)

    def under_way(self, on_change: OnChange, work: Callable[[UnderWay], Awaitable[T]]) -> T:
        """Do some work while all robots are under way; return what has come of it."""

        async def main() -> T:
            handle = GoalHandle(self, self.problem, Settings(improve=0.0, on_change=on_change), TaskObserver(), Stopwatch()).begin()
            await asyncio.sleep(500.0)
            found = await work(self)
            await handle.stop()
            return found

        return run_async(main(), virtual=True)

    async def change(self, fluent: Fluent | None, value: float) -> None:
        """Have a fact change as sensors report it, and all that wait for it look at it."""
        if fluent:
            self.known.update({fluent: value})
        for _ in range(_ROUNDS):
            await asyncio.sleep(0.0)


def rounds() -> float:
    """Return the microseconds of the rounds of the event loop alone, in which nothing has changed."""
    return fact(fleet(10), None)


def fact(problem: Problem, fluent: Fluent | None, on_change: OnChange = OnChange.LAZY) -> float:
    """Return the shortest time, in microseconds, of a change of a fact while robots are under way."""

    async def shortest(fleet: UnderWay) -> float:
        times = []
        for value in range(10, 110):
            began = time.perf_counter()
            await fleet.change(fluent, float(value))
            times.append(time.perf_counter() - began)
        return min(times) * 1e6

    return UnderWay(problem).under_way(on_change, shortest)


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


def report(count: int) -> float:
    """Return the microseconds of a report of where a robot is, in a world of so many other facts."""
    world = KnowledgeBase({("linked", f"n{index}"): True for index in range(count)})
    places = [("at", f"n{index}") for index in range(1_000)]
    world.replace(("at",), {("at", "dock"): True})
    return each(lambda: [world.replace(("at",), {place: True}) for place in places], len(places))


def grid(count: int) -> dict[Fluent, Value | Unknown]:
    """The ways between neighbours in a grid of so many places."""
    pairs = ((one, one + step) for one in range(count) for step in (1, -1, _WIDTH, -_WIDTH) if 0 <= one + step < count)
    return {("edge", f"n{one}", f"n{other}"): True for one, other in pairs}


def asked_in_grid(count: int) -> tuple[KnowledgeBase, Callable[[], None]]:
    """A grid of so many places, and the question for all that is reached from a corner."""
    nodes = tuple(f"n{index}" for index in range(count))
    world, asked = KnowledgeBase(grid(count), objects={"node": nodes}, rules=Rules((REACH,))), [("reach", "n0", node) for node in nodes]

    def ask() -> None:
        assert all(map(world.value, asked))

    return world, ask


def ways_at_first(count: int) -> float:
    """Return the microseconds to derive at first what is reached in a grid."""
    return each(asked_in_grid(count)[1], 1)


def ways(count: int) -> float:
    """Return the microseconds to know what is reached in a grid after a way is closed, or opened again: of a few, the mean."""
    world, ask = asked_in_grid(count)
    ask()
    edges = random.Random(0).sample([*grid(count)], 40)

    def change() -> None:
        for edge in edges:
            for is_open in (False, True):
                world.update({edge: is_open})
                ask()

    return each(change, 2 * len(edges))


def searched(count: int) -> float:
    """Return the microseconds of a search through a grid in plain Python."""
    after = dict[str, list[str]]()
    for _, one, other in grid(count):
        after.setdefault(one, []).append(other)

    def search() -> None:
        seen, waiting = {"n0"}, ["n0"]
        for one in waiting:  # grows
            for other in after[one]:
                if other not in seen:
                    seen.add(other)
                    waiting.append(other)
        assert len(seen) == count

    return each(search, 1)


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
