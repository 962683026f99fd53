"""Orders of the events of a plan graph, and whether the plan works in them: all orders of a small one, the most telling of a large one.

The oracle of causal order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from graphlib import TopologicalSorter
from random import Random

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.problem import Problem
from planner_bridge.model.progression import NotApplicable, Progression
from planner_bridge.ordering.partial_order import NEAR, direct_orderings
from pnm.core.logic.conditions import evaluate
from pnm.core.machine.plan_graph import Moment, Ordering, PlanEvent, PlanGraph

Key = PlanEvent | int
"""An event, or a timed change by its number."""
Before = Mapping[Key, Iterable[Key]]


def linearisations(graph: PlanGraph) -> Iterator[tuple[PlanEvent, ...]]:
    """Yield every order of the events that keeps each start before its end, and every ordering."""
    waits = {PlanEvent(call.index, moment): set[PlanEvent]() for call in graph.calls for moment in Moment}
    for call in graph.calls:
        waits[PlanEvent(call.index, Moment.END)].add(PlanEvent(call.index, Moment.START))
    for ordering in graph.orderings:
        waits[ordering.after].add(ordering.before)

    def rest(done: tuple[PlanEvent, ...]) -> Iterator[tuple[PlanEvent, ...]]:
        if len(done) == len(waits):
            yield done
        for event, before in waits.items():
            if event not in done and before.issubset(done):
                yield from rest((*done, event))

    return rest(())


def works(problem: Problem, graph: PlanGraph, order: Iterable[Key]) -> bool:
    """Return whether all conditions hold when the events happen in this order, and the goal after them.

    The moment of an instantaneous action lies somewhere between its start and its end: what it needs must be there all the time.
    """
    simulation = Progression(initial_knowledge(problem))
    try:
        for key in order:
            if isinstance(key, int):
                simulation.advance((), problem.timed[key].changes)
                continue
            action = graph.calls[key.call].action
            simulation.advance([(key, replace(action, invariant=action.precondition) if action.duration is None else action)])
    except NotApplicable:
        return False
    return evaluate(problem.goal, simulation.state) is True


def how_it_ends(problem: Problem, graph: PlanGraph) -> set[bool]:
    """Return whether the plan works, in all orders."""
    return {works(problem, graph, order) for order in linearisations(graph)}


def fails_when_turned(problem: Problem, graph: PlanGraph, ordering: Ordering, random: Random) -> bool:
    """Return whether an order is found that has the two events of the ordering the other way round, and in which the plan fails.

    Tried are the orders that have the one as early as they can, or the other as late, and a few others.
    """
    before = _relation(problem, graph)
    before[ordering.before].add(ordering.after)
    early, late = _reached(ordering.after, before), _reached(ordering.before, _turned(before))
    ranks: list[Callable[[Key], float]] = [
        lambda key: key not in early,
        lambda key: key in late,
        lambda key: 0 if key in early else 2 if key in late else 1,
        lambda key: 0 if key in early else 1 if key in late else 2,
    ]
    drawn = [{key: random.random() for key in before} for _ in range(8)]
    return any(not works(problem, graph, _sorted(before, rank)) for rank in (*ranks, *(one.__getitem__ for one in drawn)))


def _relation(problem: Problem, graph: PlanGraph) -> dict[Key, set[Key]]:
    """Return what comes directly before every event and timed change; what is planned for before a change comes before it."""
    planned = {
        PlanEvent(call.index, moment): call.planned + (call.action.duration or 0.0) * (moment is Moment.END)
        for call in graph.calls
        for moment in Moment
    }
    before: dict[Key, set[Key]] = {event: set() for event in planned}
    for number, change in enumerate(problem.timed):
        before[number] = {event for event, time in planned.items() if time < change.time - NEAR}
    for first, second in direct_orderings(graph.calls, graph.orderings, problem.timed):
        before[second].add(first)
    return before


def _turned(before: Before) -> dict[Key, list[Key]]:
    after: dict[Key, list[Key]] = {key: [] for key in before}
    for key, earlier in before.items():
        for one in earlier:
            after[one].append(key)
    return after


def _reached(first: Key, following: Before) -> set[Key]:
    reached, waiting = {first}, [first]
    while waiting:
        new = set(following[waiting.pop()]) - reached
        reached |= new
        waiting += new
    return reached


def _sorted(before: Before, rank: Callable[[Key], float]) -> list[Key]:
    """Return an order that keeps the relation and, as far as that allows, the ranks."""
    sorter, order, ready = TopologicalSorter(before), list[Key](), list[Key]()
    sorter.prepare()
    while sorter.is_active():
        ready += sorter.get_ready()
        ready.sort(key=rank, reverse=True)
        order.append(ready.pop())
        sorter.done(order[-1])
    return order
