"""Roll-outs: what attempts use up, plans that are followed again, and what is not estimated because it is known."""

from __future__ import annotations

from dataclasses import replace
from random import Random

import pytest

from planner_bridge.model.plan import Plan, PlanningResult, PlanningStatus
from planner_bridge.model.problem import Problem
from planner_bridge.model.rates import Call, Counts, End, Rates, Times
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.pipeline.odds import AttemptEnd, AttemptOdds, Leads
from planner_bridge.pipeline.roll_outs import RememberedPlans, odds_of_goal, played, used_up
from planner_bridge.planning.solve import solve
from planner_bridge.tasks.settings import Settings
from pnm.actions.faults import NO_FAULTS
from pnm.core.logic.effects import Set
from pnm.core.logic.expressions import Arithmetic, Constant, Fluent, Value
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.plan_graph import GroundAction

CART = """
(define (domain cart)
  (:requirements :strips :numeric-fluents)
  (:predicates (at ?a) (next ?a ?b))
  (:functions (charge) (use))
  (:action go :parameters (?a ?b) :precondition (and (at ?a) (next ?a ?b) (>= (charge) (use)))
    :effect (and (not (at ?a)) (at ?b) (decrease (charge) (use))))
  (:action plug_in :parameters () :precondition (at a) :effect (assign (charge) 100)))
"""
CHARGE: Fluent = ("charge",)


def cart(charge: int = 100, use: int = 10) -> Problem:
    ways = " ".join(f"(next {way})" for way in ("a b", "b c", "c d", "d e"))
    known = f"(= (charge) {charge}) (= (use) {use})"
    text = f"(define (problem p) (:domain cart) (:objects a b c d e) (:init (at a) {ways} {known}) (:goal (at e)))"
    return parse_problem(text, parse_domain(CART))


def planned(problem: Problem) -> Plan:
    found = solve(problem, improve=0.0).plan
    assert found is not None
    return found


def settings(retries: int) -> Settings:
    rates = Rates({Call("go", "go"): Counts({End.SUCCEEDED: 200, End.ABORTED: 200}, Times({35: 200}, 400_000), Times({35: 200}, 400_000))})
    return Settings(improve=0.0, bindings=Bindings({"go": Binding(retries=retries)}), learned=rates)


def test_attempts_that_fail_use_up_as_much_as_those_that_succeed() -> None:
    odds = odds_of_goal(cart(), planned(cart()), settings(8), NO_FAULTS, seconds=600.0, most=60).rolled
    assert odds is not None
    left = odds.numbers[CHARGE]
    assert len({*left}) > 5
    assert abs(sum(left) / len(left) - 60.0) < 8.0, "on average, calls use what their action says"


def test_attempts_that_last_longer_use_up_more() -> None:
    ends = (AttemptEnd(Leads.DONE, 0.5, ((1.0, 1.0), (3.0, 1.0))), AttemptEnd(Leads.AGAIN, 0.5, ((0.0, 1.0),)))
    use = Set(CHARGE, Constant(10), "decrease")
    action = GroundAction("go", ("a", "b"), ("a", "b"), end_effects=(use,))
    faults, used = played(lambda _: AttemptOdds(ends, "learned"), frozenset({"charge"})), dict[float | None, Value]()
    assert faults.drawn is not None
    for number in range(50):
        fault = faults.drawn(action, Random(number))
        assert fault is not None
        (effect,) = fault.failed
        assert isinstance(effect, Set)
        assert isinstance(effect.value, Arithmetic)
        share = effect.value.operands[0]
        assert isinstance(share, Constant)
        used[fault.seconds] = share.value
    assert used == {0.0: 0.0, 1.0: 0.5, 3.0: 1.5}, "a call uses on average what its action says"


def test_where_nothing_is_used_up_the_times_of_runs_without_a_new_plan_are_those_of_the_plan() -> None:
    assert used_up(cart()) == {"charge"}
    assert not used_up(cart(use=0))
    odds = odds_of_goal(cart(use=0), planned(cart()), settings(30), NO_FAULTS, seconds=600.0, most=5)
    assert odds.alone is not None
    assert odds.rolled is not None
    assert odds.rolled.runs == 5
    assert odds.rolled.times == odds.alone.times


@pytest.mark.parametrize(("charge", "searches"), [(100, 0), (95, 0), (40, 0), (39, 1)])
def test_a_plan_is_followed_again_where_less_is_left_and_it_is_still_valid(charge: int, searches: int) -> None:
    other, seen = replace(cart(), init={**cart().init, CHARGE: charge}), list[float]()
    memory = RememberedPlans(cart(), PlanningResult(PlanningStatus.SOLVED, planned(cart())), float("inf"), frozenset({"charge"}))

    def search(timeout: float) -> PlanningResult:
        seen.append(timeout)
        return solve(other, improve=0.0)

    for _ in range(2):
        found = memory.plan(other, 30.0, search).plan
        assert found is not None
        assert len(found.steps) == 4 + searches
    assert len(seen) == searches
