"""Small plans for tests: calls by number, and orderings such as ``"0e<1s"``."""

from __future__ import annotations

import random
from collections.abc import Iterable
from math import inf
from typing import TypeVar

from hypothesis import strategies as st

from pnm.core.logic.conditions import TRUE, Condition, Holds
from pnm.core.logic.effects import Set
from pnm.core.logic.expressions import Constant, Fluent
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.plan_graph import (
    ActionCall,
    Choice,
    Flow,
    GroundAction,
    Loop,
    Moment,
    Ordering,
    PlanEvent,
    PlanGraph,
    Recovery,
    Step,
    Then,
)

T = TypeVar("T")
_MOMENTS = {"s": Moment.START, "e": Moment.END}


def call(index: int, *, invariant: bool = False, release: float = 0.0, deadline: float = inf) -> ActionCall:
    """An action that makes (done aN) true and, if it has an invariant, needs (ok) all the time."""
    action = GroundAction(
        f"a{index}",
        invariant=Holds(("ok",)) if invariant else TRUE,
        end_effects=(Set(("done", f"a{index}"), Constant(True)),),
        duration=float(index + 1),
    )
    return ActionCall(index, action, release=release, deadline=deadline)


def ordering(text: str, protects: tuple[Fluent, ...] = ()) -> Ordering:
    """Read ``"0e<1s"``: the end of call 0 comes before the start of call 1."""
    before, after = (PlanEvent(int(side[:-1]), _MOMENTS[side[-1]]) for side in text.split("<"))
    return Ordering(before, after, protects)


def plan(calls: int, *orderings: str, invariants: bool = False, goal: Condition = TRUE) -> PlanGraph:
    """A plan of so many calls with these orderings."""
    return PlanGraph(tuple(call(index, invariant=invariants) for index in range(calls)), tuple(map(ordering, orderings)), goal)


def plan_of_steps(*steps: Step, orders: tuple[str, ...] = (), goal: Condition = TRUE) -> PlanGraph:
    """A plan of these steps, with orderings by their numbers."""
    return PlanGraph(steps, tuple(map(ordering, orders)), goal)


def plan_of(*actions: GroundAction, orders: tuple[str, ...] = (), goal: Condition = TRUE) -> PlanGraph:
    """A plan of these actions, with orderings by their numbers."""
    return plan_of_steps(*(ActionCall(index, action) for index, action in enumerate(actions)), orders=orders, goal=goal)


def two_robots() -> PlanGraph:
    """Two robots and six calls; one waits for the other, and the last one for both."""

    def move(*arguments: str) -> GroundAction:
        return GroundAction("move", arguments, ("robot", "from", "to"), duration=4.0)

    calls = (
        ActionCall(0, move("r1", "hall", "door")),
        ActionCall(1, move("r2", "dock", "hall")),
        *(ActionCall(2 + number, move("r1", f"place{number}", f"place{number + 1}")) for number in range(4)),
    )
    chain = (ordering(f"{2 + number}e<{3 + number}s", (("at", "r1", f"place{number + 1}"),)) for number in range(3))
    return PlanGraph(calls, (ordering("0e<1s", (("free", "hall"), ("open", "door"))), ordering("0e<2s"), *chain))


def nested_plan() -> PlanGraph:
    """A loop, a choice, a recovery with a chain, and a text with what XML and Graphviz would read as their own."""
    say = GroundAction("say", ("Hello & <bye>",), ("text",))
    sorry = Recovery(frozenset({Cause.ABORTED}), Then.RETRY, Flow((ActionCall(3, say),)))
    loop = Loop(4, Holds(("on",)), Flow((ActionCall(0, say),)), 3)
    choice = Choice(5, Holds(("on",)), Flow((ActionCall(1, say),)), Flow((ActionCall(2, say, recoveries=(sorry,)),)))
    return PlanGraph((loop, choice))


def shown(graph: PlanGraph) -> list[str]:
    return [str(ordering) for ordering in graph.orderings]


def any_order(graph: PlanGraph, chooser: random.Random) -> list[PlanEvent]:
    """A random order of all events that keeps every ordering."""
    left = {PlanEvent(call.index, moment): set[PlanEvent]() for call in graph.calls for moment in Moment}
    for call in graph.calls:
        left[PlanEvent(call.index, Moment.END)].add(PlanEvent(call.index, Moment.START))
    for one in graph.orderings:
        left[one.after].add(one.before)
    order: list[PlanEvent] = []
    while left:
        order.append(chooser.choice(sorted((event for event, before in left.items() if not before & left.keys()), key=str)))
        del left[order[-1]]
    return order


@st.composite
def plans(draw: st.DrawFn, most: int = 4) -> PlanGraph:
    """Any partial order of events: each ordering leads forward in a random order that keeps starts before ends."""
    count = draw(st.integers(0, most))
    events = [PlanEvent(index, moment) for index in range(count) for moment in Moment]
    shuffled = draw(st.permutations(events))
    rank = {event: position for position, event in enumerate(shuffled)}
    for index in range(count):
        start, end = PlanEvent(index, Moment.START), PlanEvent(index, Moment.END)
        if rank[start] > rank[end]:
            rank[start], rank[end] = rank[end], rank[start]
    pairs = [(one, other) for one in events for other in events if one.call != other.call and rank[one] < rank[other]]
    chosen = draw(st.lists(st.sampled_from(pairs), max_size=5, unique=True)) if pairs else []
    times = st.sampled_from((0.0, 0.0, 2.5))
    calls = tuple(
        call(index, invariant=draw(st.booleans()), release=draw(times), deadline=draw(st.sampled_from((inf, inf, 9.0))))
        for index in range(count)
    )
    delays = [draw(times) if after.moment is Moment.START else 0.0 for _, after in chosen]
    return PlanGraph(calls, tuple(Ordering(*pair, delay=delay) for pair, delay in zip(chosen, delays, strict=True)))


def closure(pairs: Iterable[tuple[T, T]]) -> set[tuple[T, T]]:
    """Return the pairs, and those that follow from them."""
    found = {*pairs}
    while more := {(one, last) for one, middle in found for again, last in found if middle == again} - found:
        found |= more
    return found
