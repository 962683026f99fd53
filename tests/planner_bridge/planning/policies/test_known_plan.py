"""A search for policies that begins with a plan, for robots that wait: their time is what a policy costs."""

from __future__ import annotations

from typing import Any

import pytest

from planner_bridge.model.plan import Plan, PlanStep
from planner_bridge.model.problem import Problem
from planner_bridge.pddl.reader import parse_domain, parse_problem
from planner_bridge.planning.policies import policy as room
from planner_bridge.planning.policies.encoding import OutcomePlanner
from planner_bridge.planning.policies.policy import PolicySearch
from planner_bridge.planning.policies.search import Interrupted, Search

SURE = """(:action step :parameters () :precondition (at-a) :effect (probabilistic 0.5 (and (not (at-a)) (at-b))))
  (:action step-on :parameters () :precondition (at-b) :effect (and (not (at-b)) (at-d)))
  (:action step-in :parameters () :precondition (at-d) :effect (and (not (at-d)) (at-c)))
  (:action walk :parameters () :precondition (at-a) :effect (and (not (at-a)) (at-e)))
  (:action walk-in :parameters () :precondition (at-e) :effect (and (not (at-e)) (at-c)))"""
RISKY = """(:action jump :parameters () :precondition (at-a)
    :effect (probabilistic 0.57 (and (not (at-a)) (at-c)) 0.03 (and (not (at-a)) (lost))))"""


def problem(actions: str) -> Problem:
    head = "(:requirements :strips :non-deterministic :probabilistic-effects) (:predicates (at-a) (at-b) (at-c) (at-d) (at-e) (lost))"
    domain = parse_domain(f"(define (domain d) {head} {actions})")
    return parse_problem("(define (problem p) (:domain d) (:init (at-a)) (:goal (at-c)))", domain)


def plan_of(*steps: tuple[str, str]) -> Plan:
    return Plan(tuple(PlanStep(name, (), float(number), 0.0, outcome) for number, (name, outcome) in enumerate(steps)), False)


def begun_with(whole: Problem, plan: Plan) -> PolicySearch:
    search = PolicySearch(whole)
    search.plan = plan
    return search


def test_the_first_policy_does_what_the_plan_does_and_a_better_one_may_follow() -> None:
    sure = problem(SURE)
    (first, *_) = (way.name for way in sure.outcomes("step"))
    found = list(begun_with(sure, plan_of(("step", first), ("step-on", ""), ("step-in", ""))).policies(60.0))
    assert [entry.action for entry in found[0].entries] == ["step-in", "step-on", "step"]
    assert all(policy.is_proved for policy in found)
    assert "walk" in [entry.action for entry in found[-1].entries], "it takes less"


def test_a_policy_that_is_likely_enough_comes_before_it_is_known_whether_there_is_a_certain_one(monkeypatch: pytest.MonkeyPatch) -> None:
    risky, run, certain = problem(RISKY), Search.run, list[Search]()
    (first, *_) = (way.name for way in risky.outcomes("jump"))

    def interrupted(search: Search, state: int) -> bool:
        if search is begun.certain and not search.entries:
            certain.append(search)
            if len(certain) == 1:
                raise Interrupted
        return run(search, state)

    monkeypatch.setattr(Search, "run", interrupted)
    begun = begun_with(risky, plan_of(("jump", first)))
    found = begun.policies(60.0)
    assert next(found).chance == pytest.approx(0.95)
    assert len(certain) == 1, "what is certain has been looked for once"
    assert not list(found), "no other one is better"
    assert len(certain) > 1, "it is looked for again while robots work"


def test_what_is_less_likely_than_the_plan_with_luck_is_no_policy(monkeypatch: pytest.MonkeyPatch) -> None:
    risky = problem(RISKY)
    (first, *_) = (way.name for way in risky.outcomes("jump"))
    search = begun_with(risky, plan_of(("jump", first)))
    planner = OutcomePlanner(risky, search.task, search.plan)
    assert planner.luck == pytest.approx(0.95), "an attempt that changes nothing is another attempt"

    def lucky(*arguments: Any) -> OutcomePlanner:
        made = OutcomePlanner(*arguments)
        made.luck = 0.99
        return made

    monkeypatch.setattr(room, "OutcomePlanner", lucky)
    monkeypatch.setattr(room, "_LIKELY", 0.99)
    assert not list(search.policies(60.0))


def test_a_plan_that_cannot_be_carried_out_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    sure = problem(SURE)
    planner = OutcomePlanner(sure, PolicySearch(sure).task, plan_of(("step-on", "")))
    assert planner.luck == 0.0
    steps = planner.plan(PolicySearch(sure).task.initial, {}, float("inf")) or []
    assert [action.name for action, _ in steps] == ["walk", "walk-in"], "Kairos is asked"


def test_a_policy_that_is_as_good_as_the_last_one_is_not_told() -> None:
    whole = problem("(:action try :parameters () :precondition (at-a) :effect (oneof (and (not (at-a)) (at-c)) (and)))")
    assert len([*PolicySearch(whole).policies(60.0)]) == 1, "whoever follows it would begin anew"
