"""All orders of the events of a small plan graph, and whether the plan works in each of them: the oracle of causal order."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.plan_simulation import NotApplicable, PlanSimulation
from planner_bridge.model.problem import Problem
from pnm.core.logic.evaluation import evaluate
from pnm.core.machine.plan_graph import Moment, PlanEvent, PlanGraph


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


def works(problem: Problem, graph: PlanGraph, order: tuple[PlanEvent, ...]) -> bool:
    """Return whether all conditions hold when the events happen in this order, and the goal after them.

    The moment of an instantaneous action lies somewhere between its start and its end: what it needs must be there all the time.
    """
    simulation = PlanSimulation(initial_knowledge(problem))
    try:
        for event in order:
            action = graph.calls[event.call].action
            simulation.advance([(event, replace(action, invariant=action.precondition) if action.duration is None else action)])
    except NotApplicable:
        return False
    return evaluate(problem.goal, simulation.state) is True


def how_it_ends(problem: Problem, graph: PlanGraph) -> set[bool]:
    """Return whether the plan works, in all orders."""
    return {works(problem, graph, order) for order in linearisations(graph)}
