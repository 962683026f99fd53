"""When plans that are being carried out are expected to be done with what they need, and what a planner makes of that."""

from __future__ import annotations

from dataclasses import replace

import pytest

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.plan import Plan
from planner_bridge.model.problem import Problem
from planner_bridge.model.progression import calls_of
from planner_bridge.ordering.interference import Forecast, awaited, forecast, read_write_sets, with_forecasts
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.planning.solve import solve
from planner_bridge.planning.validate import why_invalid
from pnm.core.knowledge_base import parse_fluent
from pnm.core.machine.plan_graph import Moment
from tests.support.pddl.vans import vans

PLACES = ("home near 15", "near shop 1", "depot far 10", "far shop 60")


def world(goal: str) -> Problem:
    return vans("v1 home v2 depot", *PLACES, goal=goal)


def plan_for(problem: Problem) -> Plan:
    result = solve(problem)
    assert result.plan is not None, result
    return result.plan


def expected(goal: str, *, under_way: float | None = None, lost: str = "") -> Forecast:
    """Forecast a plan for the goal; its first call may be under way, with so many seconds left, and a fact may be lost."""
    problem = world(goal)
    graph = plan_graph(problem, plan_for(problem))
    state = initial_knowledge(problem)
    events, left = graph.order, dict[int, float]()
    if under_way is not None:
        events, left = tuple(event for event in events if (event.call, event.moment) != (0, Moment.START)), {0: under_way}
        state.update({("at", "v1", "home"): False})
    if lost:
        state.update({parse_fluent(lost): False})
    return forecast(graph, events, left, state)


def released(forecast: Forecast, fact: str) -> float | None:
    return forecast.released.get(parse_fluent(fact))


def test_each_fact_is_released_when_the_last_call_that_needs_it_is_over() -> None:
    both = expected("(and (at v1 shop) (at v2 far))")
    assert released(both, "(at v1 home)") == pytest.approx(15.0)
    assert released(both, "(at v1 near)") == pytest.approx(16.0)
    assert released(both, "(at v2 depot)") == pytest.approx(10.0)


def test_what_the_goal_says_is_released_with_the_last_call() -> None:
    both = expected("(and (at v1 shop) (at v2 far))")
    assert released(both, "(at v2 far)") == released(both, "(at v1 shop)") == pytest.approx(16.0)


def test_what_is_left_behind_is_known() -> None:
    values = expected("(at v1 shop)").values
    assert values == {("at", "v1", "home"): False, ("at", "v1", "near"): False, ("at", "v1", "shop"): True}


def test_of_a_call_that_is_under_way_the_seconds_that_are_left_count() -> None:
    assert released(expected("(at v1 shop)", under_way=4.0), "(at v1 shop)") == pytest.approx(5.0)


def test_of_a_plan_that_does_not_work_any_more_nothing_is_expected() -> None:
    broken = expected("(at v1 shop)", lost="(at v1 home)")
    assert (dict(broken.released), dict(broken.values)) == ({}, {})
    assert parse_fluent("(at v1 shop)") in broken.needed.writes


@pytest.mark.parametrize(("goal", "van", "waits"), [("(at v1 near)", "v1", 15.0), ("(at v1 shop)", "v1", 16.0)])
def test_a_planner_weighs_waiting_for_a_busy_robot(goal: str, van: str, waits: float) -> None:
    problem, other = world("(served shop)"), expected(goal)
    waiting = with_forecasts(problem, [other])
    plan = plan_for(waiting)
    assert {step.arguments[0] for step in plan.steps} == {van}
    assert plan.steps[0].start >= waits
    needed = read_write_sets(calls_of(waiting, plan), problem.goal, initial_knowledge(waiting))
    assert awaited(needed, other) == (("at", "v1", goal[7:-1]), pytest.approx(waits))


def test_before_its_release_nothing_that_others_need_is_had_and_after_it_everything() -> None:
    problem = world("(at v1 depot)")
    with_way_back = replace(problem, init={**problem.init, ("way", "near", "depot"): True, ("seconds", "near", "depot"): 1.0})
    waiting = with_forecasts(with_way_back, [expected("(at v1 near)")])
    too_early = plan_for(replace(with_way_back, goal=problem.goal))
    assert why_invalid(waiting, too_early)
    assert plan_for(waiting).steps[0].start >= 15.0


def test_without_a_forecast_what_others_need_is_not_to_be_had_at_all() -> None:
    needed = expected("(at v1 near)").needed
    problem = with_forecasts(world("(at v1 shop)"), [Forecast(needed)])
    assert solve(problem).plan is None
    assert awaited(needed, Forecast(needed)) is None


def test_a_call_that_has_to_begin_anew_is_not_under_way_any_more() -> None:
    problem = world("(served shop)")
    graph = plan_graph(problem, plan_for(problem))
    begins_anew = replace(graph, steps=(replace(graph.steps[0], under_way=True), *graph.steps[1:]))
    state = initial_knowledge(problem)
    assert forecast(begins_anew, graph.order, {}, state) == forecast(graph, graph.order, {}, state)
