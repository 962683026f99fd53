"""Odds of policies: exact values, an independent solution of their chains, and runs of the machine."""

from __future__ import annotations

from dataclasses import replace
from math import sqrt

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from planner_bridge.model import plan
from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.plan import Plan, PlanStep
from planner_bridge.model.problem import Problem
from planner_bridge.ordering.plan_to_graph import stretch_graph
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.pipeline.odds import AttemptOdds, KnownRobots, Odds
from planner_bridge.pipeline.policy_odds import PolicyChain, RestOfPlan
from planner_bridge.pipeline.roll_outs import odds_of_goal
from planner_bridge.planning.policies.policy import Policy, PolicyEntry, policies
from planner_bridge.planning.solve import solve
from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.settings import Settings
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.core.execution.call_results import CallResult
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import CallOutcome
from tests.support.pddl.chance import Exact, random_problem

ABORTS = Fault("knock", FaultKind.ABORT, chance=0.2)
ONCE = Bindings({"knock": Binding(retries=0)})


def door(effect: str) -> Problem:
    domain = f"""(define (domain door) (:requirements :adl :non-deterministic :probabilistic-effects) (:predicates (open) (stuck) (round))
      (:action turn :parameters () :precondition (stuck) :effect (oneof (round) (not (round))))
      (:action knock :parameters () :precondition (not (stuck)) :effect {effect}))"""
    return parse_problem("(define (problem p) (:domain door) (:init) (:goal (open)))", parse_domain(domain))


def exact(problem: Problem, policy: plan.Policy | None, *faults: Fault, bindings: Bindings = ONCE) -> Odds | None:
    assert policy is not None
    chain = PolicyChain.of(problem, policy, bindings, KnownRobots(faults=Faults(faults)).attempts(bindings, {}, is_timed=False))
    return chain.odds() if chain else None


def test_what_is_tried_until_it_succeeds_has_the_odds_of_a_geometric_series() -> None:
    problem = door("(probabilistic 0.25 (open))")
    result = solve(problem)
    assert result.plan is not None
    odds = odds_of_goal(problem, result.plan, Settings(bindings=ONCE), Faults((ABORTS,)), policy=result.policy, seconds=0.0)
    assert odds.alone is not None
    assert odds.alone.chance == pytest.approx(0.8 * 0.25 / (1.0 - 0.8 * 0.75))
    assert odds.alone.actions == pytest.approx(1.0 / (1.0 - 0.8 * 0.75))
    assert sum(odds.alone.times) / len(odds.alone.times) == pytest.approx(2.5, abs=0.3), "an action takes a second"
    assert odds.rests == {"declared": ["knock"], "declared outcomes": ["knock"]}
    patient = exact(problem, result.policy, Fault("knock", FaultKind.ABORT, chance=0.0))
    assert patient is not None
    assert (patient.chance, patient.interval) == (1.0, (1.0, 1.0))


def test_the_chance_is_the_mean_over_what_learned_chances_may_be() -> None:
    problem, known = door("(probabilistic 0.25 (open))"), KnownRobots(faults=Faults((Fault("knock", FaultKind.ABORT, chance=0.4),)))

    def chance(rests: str) -> float:
        def attempts(action: GroundAction) -> AttemptOdds | None:
            found = known.attempts(ONCE, {}, is_timed=False)(action)
            return replace(found, rests=rests, total=5.0) if found else None

        policy = solve(problem).policy
        assert policy is not None
        chain = PolicyChain.of(problem, policy, ONCE, attempts)
        assert chain is not None
        return chain.odds().chance

    nodes, weights = np.polynomial.legendre.leggauss(64)
    done = (1.0 + nodes) / 2.0
    density = 6.0 * done**2 * (1.0 - done)  # of a beta distribution with 3 successes and 2 failures, on half of the length
    mean = float(weights @ (density * 0.25 * done / (1.0 - 0.75 * done)))
    at_mean = 0.6 * 0.25 / (1.0 - 0.6 * 0.75)
    assert mean - at_mean > 0.04
    assert chance("learned from 4 of knock") == pytest.approx(mean, abs=0.005)
    assert chance("assumed") == pytest.approx(at_mean), "what is only assumed is no estimate"


def test_a_trap_takes_its_chance_and_even_ones_are_said_to_be() -> None:
    problem = door("(oneof (open) (and) (stuck))")
    knock, turn = PolicyEntry({("stuck",): False}, "knock", (), 1, 2.0, 0.5), PolicyEntry({("stuck",): True}, "turn", (), 1, 2.0, 0.0)
    for entries in ((knock,), (knock, turn)):  # a state without an entry, and states that nothing leads out of
        odds = exact(problem, Policy(problem, entries), Fault("knock", FaultKind.ABORT, chance=0.0))
        assert odds is not None
        assert odds.chance == pytest.approx(0.5)
        assert odds.actions == pytest.approx(1.5)


def test_what_is_left_of_a_stretch_comes_before_what_the_policy_has_after_it() -> None:
    problem, twice = door("(probabilistic 0.25 (open))"), Bindings({"knock": Binding(retries=1)})
    policy, known = solve(problem).policy, KnownRobots(faults=Faults((ABORTS,)))
    assert policy is not None
    stretch = policy.stretch(initial_knowledge(problem))
    assert stretch is not None
    graph = stretch_graph(problem, stretch)
    (call,) = graph.calls
    whole = 0.96 * 0.25 / (1.0 - 0.96 * 0.75)
    for result, first in (
        (CallResult(call), 0.96),
        (CallResult(call, CallOutcome.RUNNING, 1, 4.0), 0.96),
        (CallResult(call, CallOutcome.RUNNING, 2, 4.0), 0.8),
    ):
        rest = RestOfPlan(graph, twice, {0: result}, {}, 0.0, 5.0)
        odds = rest.odds(known, rest.chain(known, policy, problem))
        assert odds is not None
        assert odds.told is not None
        assert odds.told.chance == pytest.approx(first * (0.25 + 0.75 * whole))
        assert odds.told.rests == "declared: knock; declared outcomes: knock"
    over = CallResult(call, CallOutcome.SUCCEEDED, 1, 4.0, 5.0, declared="1")
    assert replace(rest, results={0: over}).odds(known, rest.chain(known, policy, problem)) is None


def test_exact_odds_are_those_of_runs_of_the_machine() -> None:
    problem = door("(probabilistic 0.25 (open))")
    result, never = solve(problem), Fault("knock", FaultKind.ABORT, times=0)
    assert result.plan is not None
    chosen = Settings(improve=0.0, bindings=ONCE, limits=Limits(replans=0))
    rolled = odds_of_goal(
        problem, result.plan, chosen, Faults((ABORTS, never)), policy=result.policy, seconds=600.0, most=150
    ).rolled  # what never happens makes nothing exact
    odds = exact(problem, result.policy, ABORTS)
    assert rolled is not None
    assert odds is not None
    assert abs(rolled.chance - odds.chance) < 4.0 * sqrt(0.25 / 150)
    means = [sum(each.times) / len(each.times) for each in (rolled, odds)]
    assert means[0] == pytest.approx(means[1], abs=0.7)


def test_new_plans_bring_nothing_where_no_call_fails() -> None:
    domain = """(define (domain vending) (:requirements :adl :probabilistic-effects) (:predicates (coin) (drink) (jammed))
      (:action insert :parameters () :precondition (not (jammed)) :effect (probabilistic 0.5 (coin)))
      (:action press :parameters () :precondition (coin) :effect (and (not (coin)) (probabilistic 0.6 (drink) 0.4 (jammed)))))"""
    problem = parse_problem("(define (problem p) (:domain vending) (:init) (:goal (drink)))", parse_domain(domain))
    policy, never = solve(problem).policy, Fault("insert", FaultKind.ABORT, chance=0.0)
    assert policy is not None
    plan = Plan((PlanStep("insert", outcome="1"), PlanStep("press", outcome="1")))
    odds = odds_of_goal(problem, plan, Settings(improve=0.0), Faults((never,)), policy=policy, seconds=600.0, most=50)
    assert odds.alone is not None
    assert odds.rolled is not None
    assert odds.alone.chance == pytest.approx(0.6)
    assert odds.rolled.chance == pytest.approx(0.6, abs=0.02), "what outcomes lead to is no new plan"


def test_outcomes_that_nothing_tells_apart_have_no_exact_odds() -> None:
    problem = door("(oneof (open) (and))")
    assert exact(problem, solve(problem, improve=0.0).policy, bindings=Bindings(assumed=frozenset({"open"}))) is None


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**9))
def test_chances_and_actions_are_those_of_an_independent_solution(seed: int) -> None:
    problem = random_problem(seed)
    for policy in policies(problem, 5.0):
        odds = exact(problem, policy, Fault("none", FaultKind.ABORT))
        assert odds is not None
        chance, actions, _ = Exact(problem).played(policy)
        assert odds.chance == pytest.approx(chance)
        assert chance < 1.0 - 1e-9 or odds.actions == pytest.approx(actions, rel=1e-6)
