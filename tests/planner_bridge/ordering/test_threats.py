"""Every ordering that a plan needs is missed when it is not there, and none else: as all orders of the events of small plans show."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import combinations
from typing import Any

import pytest
from hypothesis import HealthCheck, assume, given, settings, strategies as st

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.plan import Plan, PlanStep
from planner_bridge.model.problem import Domain, Problem
from planner_bridge.model.progression import NotApplicable, Progression
from planner_bridge.ordering.partial_order import NEAR, PartialOrder, direct_orderings
from planner_bridge.ordering.plan_to_graph import causal_links, check_order, plan_graph
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.planning.validate import why_invalid
from pnm.core.logic.conditions import TRUE, All, Holds, Not, evaluate
from pnm.core.logic.domain import ActionSchema, Declaration
from pnm.core.logic.effects import Effects, Set
from pnm.core.logic.expressions import Constant
from pnm.core.logic.trajectory import Constraint
from pnm.core.machine.plan_graph import ActionCall, GroundAction, Moment, Ordering, PlanEvent, PlanGraph, PlanGraphError
from tests.support.pddl.problems import matches, rooms
from tests.support.pddl.random_plans import apart, walks
from tests.support.pddl.random_problems import Draw, Features, problems

FACTS = ("p", "q", "r")


def check(problem: Problem, graph: PlanGraph, *, projected: bool = False) -> None:
    links = causal_links(problem, [call.action for call in graph.calls])
    order = PartialOrder(graph.calls, graph.orderings, problem.timed, graph.due)
    check_order(graph, order, problem, links, projected=projected)


def is_noticed(problem: Problem, graph: PlanGraph) -> bool:
    try:
        check(problem, graph)
    except PlanGraphError:
        return True
    return False


def without(graph: PlanGraph, *gone: Ordering) -> PlanGraph:
    return replace(graph, orderings=tuple(one for one in graph.orderings if one not in gone))


Key = PlanEvent | int
"""An event, or a timed change by its number."""


def linearisations(problem: Problem, graph: PlanGraph) -> Iterator[tuple[Key, ...]]:
    """Yield every order of the events and timed changes that keeps the orderings; what is planned for before a change comes before it."""
    planned = {
        PlanEvent(call.index, moment): call.planned + (call.action.duration or 0.0) * (moment is Moment.END)
        for call in graph.calls
        for moment in Moment
    }
    waits: dict[Key, set[Key]] = {event: set() for event in planned}
    for number, change in enumerate(problem.timed):
        waits[number] = {event for event, time in planned.items() if time < change.time - NEAR}
    for first, second in direct_orderings(graph.calls, graph.orderings, problem.timed):
        waits[second].add(first)

    def rest(done: tuple[Key, ...]) -> Iterator[tuple[Key, ...]]:
        if len(done) == len(waits):
            yield done
        for key, before in waits.items():
            if key not in done and before.issubset(done):
                yield from rest((*done, key))

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
    return {works(problem, graph, order) for order in linearisations(problem, graph)}


# --- the definition: all orders of small graphs --------------------------------------------


def truth_values(draw: Draw) -> All:
    return All(tuple(Holds((name,)) if wanted else Not(Holds((name,))) for name, wanted in assignments(draw)))


def setting(draw: Draw) -> Effects:
    return tuple(Set((name,), Constant(value)) for name, value in assignments(draw))


def assignments(draw: Draw) -> list[tuple[str, bool]]:
    return draw(st.lists(st.tuples(st.sampled_from(FACTS), st.booleans()), max_size=2, unique_by=lambda one: one[0]))


@st.composite
def graphs_of_facts(draw: Draw) -> tuple[Problem, PlanGraph]:
    """Draw calls that need and change facts, with any orderings at all."""
    calls = []
    for index in range(draw(st.integers(1, 3))):
        needs, writes, lasts = truth_values(draw), setting(draw), draw(st.booleans())
        action = GroundAction(f"a{index}", precondition=needs, end_effects=writes)
        if lasts:
            within, ending, at_start = truth_values(draw), truth_values(draw), setting(draw)
            action = replace(action, invariant=within, end_condition=ending, start_effects=at_start, duration=1.0)
        calls.append(ActionCall(index, action))
    events = [PlanEvent(call.index, moment) for call in calls for moment in Moment]
    pairs = [(one, other) for one, other in combinations(events, 2) if one.call != other.call]
    chosen = draw(st.lists(st.sampled_from(pairs), max_size=5, unique=True)) if pairs else []
    schemas = {call.action.name: schema_of(call.action) for call in calls}
    domain = Domain("d", predicates={name: Declaration(name) for name in FACTS}, actions=schemas)
    init = {(name,): True for name in draw(st.sets(st.sampled_from(FACTS)))}
    problem = Problem("p", domain, init=init, goal=truth_values(draw))
    return problem, PlanGraph(tuple(calls), tuple(Ordering(*pair) for pair in chosen), problem.goal)


def schema_of(action: GroundAction) -> ActionSchema:
    parts: dict[str, Any] = {name: getattr(action, name) for name in ("name", "precondition", "invariant", "end_condition")}
    return ActionSchema(**parts, start_effects=action.start_effects, end_effects=action.end_effects)


@given(graphs_of_facts())
def test_of_facts_exactly_those_orders_are_refused_that_do_not_all_end_well(drawn: tuple[Problem, PlanGraph]) -> None:
    problem, graph = drawn
    ends = how_it_ends(problem, graph)
    if ends != {False}:  # a plan that never works is for the validator
        assert is_noticed(problem, graph) is (False in ends)


@pytest.mark.parametrize("timed", [False, True])
@settings(suppress_health_check=[HealthCheck.filter_too_much])
@given(st.data())
def test_whatever_is_read_and_written_no_order_that_ends_otherwise_is_let_through(timed: bool, data: st.DataObject) -> None:
    problem = replace(data.draw(problems(Features(timed=timed))), goal=TRUE)
    drawn = data.draw(walks(problem))
    drawn = replace(drawn, steps=drawn.steps[:3])
    plan = apart(drawn) if problem.is_timed else drawn
    assume(not why_invalid(problem, plan))  # a plan may need two ends at the very same moment: no ordering can bring that about
    try:
        whole = plan_graph(problem, plan)
    except PlanGraphError:  # nor can an ordering have an event come at the very moment of a change
        assume(not problem.timed)
        raise
    assert not is_noticed(problem, whole)
    gone = data.draw(st.lists(st.sampled_from(whole.orderings), max_size=2)) if whole.orderings else []
    graph = without(whole, *gone)
    if not is_noticed(problem, graph):
        assert len(how_it_ends(problem, graph)) == 1


# --- what is said ------------------------------------------------------------------------

MATCH = Plan((PlanStep("strike", ("m0",), 0.0, 8.0), PlanStep("mend", ("f0", "m0"), 0.0, 5.0)), temporal=True)


def test_what_an_action_needs_all_the_time_is_protected_until_its_end() -> None:
    problem = matches(1)
    graph = plan_graph(problem, MATCH)
    start, end = graph.orderings
    with pytest.raises(PlanGraphError, match=r"end of strike\(m0\)#0 may come between .* mend\(f0, m0\)#1.* needs \(light m0\)"):
        check(problem, without(graph, end))
    with pytest.raises(PlanGraphError, match=r"start of mend\(f0, m0\)#1 needs \(light m0\), but the initial state"):
        check(problem, without(graph, start))


def test_the_message_names_the_reader_the_fact_and_the_writer() -> None:
    problem = rooms(goal="(at r1 c)")
    graph = plan_graph(problem, Plan((PlanStep("move", ("r1", "a", "b"), 0.0), PlanStep("move", ("r1", "b", "c"), 1.0))))
    with pytest.raises(PlanGraphError) as refusal:
        check(problem, without(graph, *graph.orderings))
    assert str(refusal.value) == (
        "an ordering is missing: the start of move(r1, b, c)#1 needs (at r1 b), but the initial state may be the last that writes it before"
    )


def test_an_order_that_a_constraint_asks_for_is_missed() -> None:
    never_both = Constraint("always", (Not(All((Holds(("at", "r1", "b")), Holds(("at", "r2", "b"))))),))
    problem = replace(rooms(goal="(and)"), constraints=(never_both,))
    graph = plan_graph(problem, Plan((PlanStep("move", ("r1", "a", "b"), 0.0), PlanStep("move", ("r2", "a", "b"), 1.0))))
    assert graph.orderings
    with pytest.raises(PlanGraphError, match="does not keep"):
        check(problem, without(graph, *graph.orderings))


DOORS = """(define (domain d) (:requirements :durative-actions :timed-initial-literals) (:predicates (open) (in))
  (:durative-action pass :parameters () :duration (= ?duration 5) :condition (over all (open)) :effect (at end (in))))"""


def test_a_call_that_needs_a_timed_fact_may_not_come_before_it() -> None:
    problem = parse_problem("(define (problem p) (:domain d) (:init (at 70 (open))) (:goal (in)))", parse_domain(DOORS))
    graph = plan_graph(problem, Plan((PlanStep("pass", (), 70.0, 5.0),), temporal=True))
    with pytest.raises(PlanGraphError, match="needs"):
        check(problem, replace(graph, steps=tuple(replace(call, release=0.0) for call in graph.calls)))


def test_calls_that_are_under_way_end_before_what_needs_them() -> None:
    problem = rooms("(at r1 b) (at r2 a)", goal="(at r1 c)")
    move = plan_graph(rooms(), Plan((PlanStep("move", ("r1", "a", "b"), 0.0),))).calls[0]
    graph = plan_graph(problem, Plan((PlanStep("move", ("r1", "b", "c"), 0.0),)), [move])
    with pytest.raises(PlanGraphError, match="the initial state"):
        check(problem, without(graph, *graph.orderings), projected=True)
