"""All that walk through a plan agree on the order of what happens, and on the state after each moment."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import HealthCheck, assume, given, settings, strategies as st

from planner_bridge.explanations.needed_call import Course
from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.plan import Plan, PlanStep
from planner_bridge.model.problem import Problem
from planner_bridge.model.progression import EPSILON, NotApplicable, Progression, calls_of, happenings, snapshot
from planner_bridge.ordering.interference import forecast
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.planning.validate import trace, why_invalid
from pnm.core.logic.conditions import TRUE
from pnm.core.logic.expressions import UNKNOWN
from pnm.core.machine.plan_graph import Moment, PlanEvent, PlanGraphError
from tests.support.pddl.random_plans import walks
from tests.support.pddl.random_problems import Draw, Features, problems

NUDGES = st.sampled_from([0.0, 0.0, 4e-7, 3e-6, 2e-5, 0.001])
"""Seconds by which a step is late: within one happening, and not."""


@st.composite
def plans(draw: Draw) -> tuple[Problem, Plan]:
    """Draw a problem with a plan that can be carried out, events of which come at one time, or nearly so."""
    problem = replace(draw(problems(Features(timed=True))), goal=TRUE)
    plan = draw(walks(problem))
    late = [replace(step, start=step.start + draw(NUDGES)) for step in plan.steps]
    plan = replace(plan, steps=tuple(sorted(late, key=lambda step: step.start)))
    assume(plan.steps and not why_invalid(problem, plan))
    return problem, plan


@given(plans())
@settings(suppress_health_check=list(HealthCheck))
def test_all_that_walk_through_a_plan_agree_on_the_order_and_on_the_state_after_each_moment(drawn: tuple[Problem, Plan]) -> None:
    problem, plan = drawn
    calls, course = calls_of(problem, plan), happenings(problem, plan)
    states = trace(problem, plan)
    assert [time for time, _ in states] == [0.0, *(happening.time for happening in course)]
    together, apart = (Progression(snapshot(initial_knowledge(problem)), unmet=lambda *_: True) for _ in range(2))
    for happening, (_, state) in zip(course, states[1:], strict=True):
        events = [(event, calls[event.call].action) for event in happening.events]
        together.advance(events, happening.changes)
        assert together.state.facts() == state.facts()
        apart.advance((), happening.changes)
        for event in events:
            apart.advance([event])
        started = {event.call for event, action in events if event.moment is Moment.START and action.duration is not None}
        if any(event.call in started for event, _ in events if event.moment is Moment.END):
            return  # of an action that takes no time the effects are simultaneous: what one end adds, the other cannot delete
        assert apart.state.facts() == state.facts()
    assert not Course.of(problem, plan).as_it_is
    try:
        graph = plan_graph(problem, plan)
    except PlanGraphError:  # its causes alone do not give it an order that always works
        return
    places = {event: place for place, happening in enumerate(course) for event in happening.events}
    for ordering in graph.orderings:
        assert places[ordering.before] <= places[ordering.after], ordering
    if not problem.timed and all(call.action.duration is None or call.action.duration > 2 * EPSILON for call in calls):
        foreseen = forecast(graph, graph.order, {}, initial_knowledge(problem))
        left = {fluent: together.state.value(fluent) for fluent in foreseen.needed.writes}
        assert foreseen.values == {fluent: value for fluent, value in left.items() if value is not None and value is not UNKNOWN}


@given(st.lists(st.tuples(st.sampled_from([0.0, 1.0, 2.0]), NUDGES, st.sampled_from([0.0, 1.0, 2.0])), max_size=6))
def test_the_order_of_happenings(drawn: list[tuple[float, float, float]]) -> None:
    """By their times, no two of one time; ends, starts, and ends of what has just started; each start before its end."""
    steps = sorted((PlanStep("toggle", (), start + late, lasts) for start, late, lasts in drawn), key=lambda step: step.start)
    course = happenings(lamp(), Plan(tuple(steps), temporal=True))
    assert all(later.time - earlier.time > EPSILON for earlier, later in pairwise(course))
    seen: list[PlanEvent] = []
    for happening in course:
        starting = {event.call for event in happening.events if event.moment is Moment.START}
        ranks = [(event.call in starting) * (1 + (event.moment is Moment.END)) for event in happening.events]
        assert ranks == sorted(ranks)
        seen += happening.events
    assert len(set(seen)) == len(seen) == 2 * len(steps)
    assert all(seen.index(PlanEvent(call, Moment.START)) < seen.index(PlanEvent(call, Moment.END)) for call in range(len(steps)))


def lamp() -> Problem:
    """A lamp that must be on when `look` begins, and that `toggle` switches off at its end."""
    domain = parse_domain(
        "(define (domain lamps) (:requirements :durative-actions) (:predicates (on) (seen))"
        " (:durative-action toggle :parameters () :duration (>= ?duration 0) :condition () :effect (at end (not (on))))"
        " (:durative-action look :parameters () :duration (= ?duration 1) :condition (at start (on)) :effect (at end (seen))))"
    )
    return parse_problem("(define (problem p) (:domain lamps) (:init (on)) (:goal (seen)))", domain)


def test_the_graph_keeps_the_order_of_events_that_the_validator_has_apart() -> None:
    plan = Plan((PlanStep("toggle", (), 0.0, 1.000003), PlanStep("look", (), 1.0, 1.0)), temporal=True)
    assert why_invalid(lamp(), plan) == ""
    (ordering,) = plan_graph(lamp(), plan).orderings
    assert (ordering.before, ordering.after.call) == (PlanEvent(1, Moment.START), 0)


def test_an_unmet_condition_is_refused_or_noted_or_the_call_is_dropped() -> None:
    problem = replace(lamp(), init={})
    plan = Plan((PlanStep("look", (), 0.0, 1.0),), temporal=True)
    (call,), course = calls_of(problem, plan), happenings(problem, plan)

    def seen(progression: Progression) -> object:
        for happening in course:
            progression.advance([(event, call.action) for event in happening.events])
        return progression.state.value(("seen",))

    noted: list[object] = []
    with pytest.raises(NotApplicable, match="observed"):
        seen(Progression(initial_knowledge(problem)))
    assert seen(Progression(initial_knowledge(problem), unmet=lambda *what: noted.append(what[:2]) or True)) is True
    assert noted == [(0, "start")]
    assert not seen(Progression(initial_knowledge(problem), unmet=lambda *_: False))
