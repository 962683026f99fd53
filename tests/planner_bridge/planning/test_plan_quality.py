"""Plans worth executing: the metric counts, and no call can be left out."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given, strategies as st

from planner_bridge.model.plan import Plan, PlanningResult, PlanningStatus, PlanStep
from planner_bridge.model.problem import Problem
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.planning.solve import MAX_STEPS, reduced, solve
from planner_bridge.planning.validate import why_invalid
from tests.support.pddl.problems import rooms

SHOP = """
(define (domain shop)
  (:requirements :strips :action-costs)
  (:predicates (asked) (bought) (paid))
  (:functions (total-cost))
  (:action ask :parameters () :effect (and (asked) (increase (total-cost) 1)))
  (:action buy_asked :parameters () :precondition (asked) :effect (and (bought) (increase (total-cost) 1)))
  (:action buy :parameters () :effect (and (bought) (increase (total-cost) 1000)))
  {more})
"""
TEMPORAL = """
(define (domain walk)
  (:requirements :typing :durative-actions)
  (:types robot place)
  (:predicates (at ?r - robot ?p - place))
  (:durative-action move :parameters (?r - robot ?from ?to - place) :duration (= ?duration 4)
    :condition (at start (at ?r ?from)) :effect (and (at start (not (at ?r ?from))) (at end (at ?r ?to)))))
"""


RETURN = "(:action return_bottles :parameters () :precondition (bought) :effect (and (paid) (decrease (total-cost) 5)))"


def shop(metric: str = "(:metric minimize (total-cost))", rest: str = "", more: str = "") -> Problem:
    text = f"(define (problem p) (:domain shop) (:init (= (total-cost) 0)) (:goal (bought)) {rest} {metric})"
    return parse_problem(text, parse_domain(SHOP.format(more=more)))


def walk(goal: str) -> Problem:
    text = f"(define (problem p) (:domain walk) (:objects r1 r2 - robot a b c - place) (:init (at r1 a) (at r2 a)) (:goal {goal}))"
    return parse_problem(text, parse_domain(TEMPORAL))


def plan_of(*calls: str, cost: float | None = None) -> Plan:
    """A sequential plan of calls such as ``move r1 a b``."""
    words = [call.split() for call in calls]
    return Plan(tuple(PlanStep(name, tuple(arguments)) for name, *arguments in words), cost=cost)


def left(problem: Problem, plan: Plan) -> list[str]:
    """Return what is left of a valid plan."""
    assert not why_invalid(problem, plan)
    result = reduced(problem, PlanningResult(PlanningStatus.SOLVED, plan))
    assert result.plan is not None
    return [" ".join((step.action, *step.arguments)) for step in result.plan.steps]


# --- cost --------------------------------------------------------------------------------------


def test_the_metric_decides_and_the_best_plan_is_called_so() -> None:
    result = solve(shop())
    assert result.plan is not None
    assert (result.plan.cost, result.plan.is_best) == (2.0, True)
    assert str(result.plan).startswith("2 calls, cost 2, no plan is better\n")


def test_without_time_for_improvement_the_first_plan_is_taken_and_nothing_is_said_of_better_ones() -> None:
    result = solve(rooms(), improve=0.0)
    assert result.plan is not None
    assert not result.plan.is_best


def test_nothing_is_called_best_while_facts_are_unknown() -> None:
    result = solve(replace(shop(), unknown=frozenset({("asked",)})))
    assert result.plan is not None
    assert not result.plan.is_best


# --- needless calls ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("goal", "calls", "needed"),
    [
        ("(clean a)", ["move r1 a b", "sweep r2 a"], ["sweep r2 a"]),
        ("(clean a)", ["move r1 a b", "move r1 b a", "sweep r1 a"], ["sweep r1 a"]),
        ("(clean a)", ["sweep r1 a", "move r1 a b", "sweep r1 b", "move r1 b a"], ["sweep r1 a"]),
        ("(and (clean a) (at r1 b))", ["move r1 a b", "move r1 b a", "sweep r1 a", "move r1 a b"], ["sweep r1 a", "move r1 a b"]),
        ("(at r1 c)", ["move r1 a b", "move r1 b c"], ["move r1 a b", "move r1 b c"]),
        ("(at r1 a)", ["move r1 a b", "move r1 b a"], []),
    ],
)
def test_calls_that_are_not_needed_are_left_out_with_those_that_rest_on_them(goal: str, calls: list[str], needed: list[str]) -> None:
    assert left(rooms(goal=goal, ways="ab ba bc"), plan_of(*calls)) == needed


def test_a_call_that_makes_the_plan_cheaper_stays() -> None:
    plan = plan_of("ask", "buy_asked", "return_bottles", cost=-3.0)
    assert left(shop(more=RETURN), plan) == ["ask", "buy_asked", "return_bottles"]
    assert left(shop(metric="", more=RETURN), plan) == ["ask", "buy_asked"]


def test_a_call_that_a_constraint_asks_for_stays() -> None:
    assert left(shop(rest="(:constraints (sometime (asked)))"), plan_of("ask", "buy", cost=1001.0)) == ["ask", "buy"]


def test_plans_with_preferences_and_long_ones_stay_as_they_are() -> None:
    softly = rooms(goal="(and (clean a) (preference p (at r1 b)))", ways="ab ba")
    assert left(softly, plan_of("move r1 a b", "sweep r2 a")) == ["move r1 a b", "sweep r2 a"]
    rounds = ["move r1 a b", "move r1 b a"] * (MAX_STEPS // 2)
    assert len(left(rooms(goal="(clean a)", ways="ab ba"), plan_of(*rounds, "sweep r2 a"))) == MAX_STEPS + 1


def test_of_plans_with_times_needless_calls_are_left_out_as_well() -> None:
    steps = (PlanStep("move", ("r1", "a", "b"), 0.0, 4.0), PlanStep("move", ("r2", "a", "c"), 0.0, 4.0))
    assert left(walk("(at r2 c)"), Plan(steps, temporal=True)) == ["move r2 a c"]


@given(goals=st.sets(st.sampled_from(["(at r1 c)", "(at r2 d)", "(clean a)", "(clean b)", "(clean d)"]), min_size=1))
def test_no_call_of_a_plan_can_be_left_out(goals: set[str]) -> None:
    problem = rooms(goal=f"(and {' '.join(sorted(goals))})", ways="ab ba bc cb ad da dc")
    plan = solve(problem, improve=0.0).plan
    assert plan is not None
    for number in range(len(plan.steps)):
        shorter = replace(plan, steps=(*plan.steps[:number], *plan.steps[number + 1 :]))
        assert why_invalid(problem, shorter), f"{plan.steps[number]} of {plan} can be left out"
