"""Why a plan has a call: what needs it, the way to the goal, and calls that nothing needs."""

from __future__ import annotations

from dataclasses import replace
from threading import Event

from hypothesis import HealthCheck, given, settings

from planner_bridge.explanations.answer import Known, Solves
from planner_bridge.explanations.needed_call import Course, why_call_of_plan, why_plan
from planner_bridge.model.plan import Plan, read_plan
from planner_bridge.model.problem import Problem
from planner_bridge.planning.kairos import DEFAULT_PLANNER, search
from planner_bridge.planning.solve import solve
from planner_bridge.planning.validate import why_invalid
from tests.support.pddl.explanations.doors import house
from tests.support.pddl.random_problems import problems as random_problems


def plan_of(problem: Problem) -> Plan:
    plan = solve(problem, timeout=10.0, improve=0.0).plan
    assert plan
    return plan


def test_a_call_that_nothing_needs_is_said_to_be_so_and_the_plan_without_it_is_valid() -> None:
    problem = house("(open door)", "(has r1 cup)")
    plan = read_plan("(open_door r1 door hall kitchen) (pass r1 door hall kitchen) (take r1 cup kitchen)".replace(") ", ")\n"), problem)
    answer = why_call_of_plan(problem, replace(plan, temporal=False), 0)
    assert (answer.known, answer.statement.partition(":")[0]) == (Known.PLAN, "nothing needs #0 open_door(r1, door, hall, kitchen)")
    (claim,) = answer.claims
    assert isinstance(claim, Solves)
    assert why_invalid(claim.problem, claim.plan) == ""


def test_a_detour_is_needed_only_for_the_way_back() -> None:
    problem = house("(open door)", "(at r1 hall)")
    plan = read_plan("(move r1 hall yard)\n(move r1 yard hall)", problem)
    texts = [str(why_call_of_plan(problem, plan, number)) for number in range(2)]
    assert "#1 move(r1, yard, hall) needs it: (at r1 yard)" in texts[0]
    assert "the goal needs it: (at r1 hall)" in texts[1]


@given(random_problems())
@settings(suppress_health_check=list(HealthCheck))
def test_a_call_is_superfluous_exactly_if_the_plan_without_it_is_valid(problem: Problem) -> None:
    found = search(problem, DEFAULT_PLANNER, 0.3, Event()).plan  # without a reason where there is none, which may take long
    plan = found if found and not why_invalid(problem, found) else Plan()
    course = Course.of(problem, plan)
    for number in range(len(plan.steps)):
        without = replace(plan, steps=(*plan.steps[:number], *plan.steps[number + 1 :]))
        assert bool(course.needs(number)) is bool(why_invalid(problem, without))


def test_the_overview_names_what_each_call_is_for() -> None:
    problem = house("")
    lines = [reason.statement for reason in why_plan(problem, plan_of(problem)).reasons]
    assert lines[2] == "#2 take(r1, cup, kitchen): for the goal (has r1 cup)"
    nothing = house("", "(at r1 hall)")
    assert why_plan(nothing, plan_of(nothing)).statement == "there is nothing to do: the goal is empty, holds already, or comes by itself"
