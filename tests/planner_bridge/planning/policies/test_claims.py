"""What no policy may claim, and that its search comes to an end."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from threading import Event
from unittest.mock import Mock

import pytest

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.plan import PlanningStatus
from planner_bridge.model.problem import Problem
from planner_bridge.pddl.reader import parse_domain, parse_problem
from planner_bridge.planning.policies import policy as room
from planner_bridge.planning.policies.grounding import policy_task
from planner_bridge.planning.policies.policy import Policy, PolicySearch, Thinking, policies
from planner_bridge.planning.policies.search import Search
from planner_bridge.planning.policies.task import PolicyAction, Unsuitable
from planner_bridge.planning.solve import solve
from pnm.core.machine.bindings import Bindings

HEADER = "(:requirements :adl :durative-actions :fluents :non-deterministic :probabilistic-effects)"


def problem(actions: str, init: str = "", goal: str = "(done)", declared: str = "(done)", functions: str = "(unused)") -> Problem:
    domain = parse_domain(f"(define (domain d) {HEADER} (:predicates {declared}) (:functions {functions}) {actions})")
    return parse_problem(f"(define (problem p) (:domain d) (:init {init}) (:goal {goal}))", domain)


def test_an_effect_that_depends_on_what_the_start_changes_is_refused() -> None:
    go = """(:durative-action go :parameters () :duration (= ?duration 1) :condition (at start (alive))
      :effect (and %s (when (at start (not (warm))) (at end (not (alive)))) (at end (oneof (done) (and)))))"""
    declared, goal = "(warm) (alive) (done)", "(and (done) (alive))"
    with pytest.raises(Unsuitable, match="depend on what held before the start"):
        policies(problem(go % "(at start (warm))", "(alive)", goal, declared), 10.0)
    assert not any(policies(problem(go % "", "(alive)", goal, declared), 10.0)), "it is cold, so it is not alive at the end"
    assert next(policies(problem(go % "", "(alive) (warm)", goal, declared), 10.0)).is_proved


def test_a_duration_that_actions_change_is_refused() -> None:
    actions = """(:durative-action brake :parameters () :duration (= ?duration 1) :condition (at start (not (slow)))
        :effect (and (at end (slow)) (at end (assign (speed) 10))))
      (:durative-action go :parameters () :duration (= ?duration (speed)) :condition (and (at start (slow)) (at start (>= (battery) 2)))
        :effect (and (at end (decrease (battery) ?duration)) (at end (oneof (done) (and)))))"""
    init, functions = "(= (battery) 4) (= (speed) 0)", "(battery) (speed)"
    with pytest.raises(Unsuitable, match="durations that depend on what actions change"):
        policies(problem(actions, init, "(and (done) (>= (battery) 2))", "(slow) (done)", functions), 10.0)


@pytest.mark.parametrize("more", ["", "(:action set :parameters () :precondition (done) :effect (trap))"], ids=["never changes", "changes"])
def test_nothing_is_proved_of_a_state_of_which_facts_are_unknown(more: str) -> None:
    go = "(:action go :parameters () :precondition (not (trap)) :effect (oneof (done) (and)))"
    known = problem(go + more, declared="(trap) (done)")
    assert next(policies(known, 10.0)).is_proved
    assert not any(found.is_proved for found in policies(replace(known, unknown=frozenset({("trap",)})), 10.0))


def test_an_outcome_that_hardly_ever_comes_about_is_no_division_by_zero() -> None:
    go = "(:action go :parameters () :precondition (not (done)) :effect (probabilistic 1e-17 (done) 1.0 (and)))"
    assert [*policies(problem(go), 10.0)][-1].chance == 1.0


def test_a_stretch_that_leads_nowhere_comes_to_an_end() -> None:
    go = "(:action go :parameters () :effect (oneof (done) (and)))"
    turning = problem(f"(:action turn :parameters () :effect (turned)) {go}", declared="(done) (turned)")
    endless = Policy(turning, (room.PolicyEntry({}, "turn", (), 1.0, 1.0, 1.0),))
    assert endless.plan(initial_knowledge(turning)) is None


def test_a_fault_of_the_search_is_told_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(search: PolicySearch, *_: object) -> Iterator[Policy]:
        raise ZeroDivisionError("of the search")
        yield Policy(search.problem, ())

    monkeypatch.setattr(PolicySearch, "policies", failing)
    with pytest.raises(ZeroDivisionError, match="of the search"):
        solve(problem("(:action go :parameters () :effect (oneof (done) (and)))"), timeout=1e6)


def test_states_are_given_an_action_once_where_values_come_near_slowly(monkeypatch: pytest.MonkeyPatch) -> None:
    last, chance = 8, 0.01
    steps = "".join(
        f"(:action step{at} :precondition (at{at}) :effect (and (not (at{at})) (at{at + 1}) (oneof (side) (not (side)))))"
        for at in range(last)
    )
    again = f"""(:action try :precondition (and (at{last}) (not (tired))) :effect (and (tired) (probabilistic {chance} (done))))
      (:action rest :precondition (and (at{last}) (tired)) :effect (not (tired)))"""
    declared = "".join(f"(at{at})" for at in range(last + 1))
    slow = problem(steps + again, "(at0)", declared=f"{declared} (side) (tired) (done)")
    asked, action_of = Counter[int](), Search._action

    def counted(self: Search, state: int) -> PolicyAction | None:
        asked[state] += 1
        return action_of(self, state)

    monkeypatch.setattr(Search, "_action", counted)
    assert [*policies(slow, 60.0)][-1].is_proved
    assert max(asked.values()) <= 8


def test_what_the_proof_assumes_to_be_seen_is_said_where_nothing_sees_it() -> None:
    go = problem("(:action go :parameters () :effect (oneof (done) (and)))")
    assert solve(go, improve=0.0, bindings=Bindings()).message == ""
    unseen = solve(go, improve=0.0, bindings=Bindings(assumed=frozenset({"done"})))
    assert unseen.message == "nothing tells 1 and 2 of go apart: there the policy may not go on"


def test_what_takes_too_long_to_be_made_ready_has_no_policy(monkeypatch: pytest.MonkeyPatch) -> None:
    objects, asked, stop = " ".join(f"o{number}" for number in range(40)), list[bool](), Event()
    action = "(:action go :parameters (?a ?b ?c ?d) :precondition (not (done)) :effect (oneof (done) (and)))"
    domain = parse_domain(f"(define (domain d) {HEADER} (:predicates (done)) {action})")
    many = parse_problem(f"(define (problem p) (:domain d) (:objects {objects}) (:init) (:goal (done)))", domain)

    def is_over() -> bool:
        asked.append(True)
        return len(asked) > 100

    with pytest.raises(Unsuitable, match="not all found in time"):
        policy_task(many, is_over=is_over)
    assert len(asked) == 101, "it was the last time"
    stop.set()
    made = Mock(return_value=None)
    monkeypatch.setattr("planner_bridge.planning.policies.grounding.modelled_duration", made)
    assert solve(many, cancel=stop).status is PlanningStatus.CANCELLED
    assert not made.called, "nothing is made ready that nobody waits for"


def test_without_a_policy_a_plan_is_followed_as_long_as_its_rest_works(monkeypatch: pytest.MonkeyPatch) -> None:
    actions = """(:action rest :parameters () :effect (rested))
      (:action go :parameters (?a ?b - place) :precondition (and (at ?a) (rested))
        :effect (oneof (and (not (at ?a)) (at ?b)) (and) (and (not (at ?a)) (lost))))
      (:action search :parameters () :precondition (lost) :effect (oneof (and (not (lost)) (at b)) (and)))"""
    text = f"(define (domain d) {HEADER} (:types place) (:constants a b c - place) (:predicates (at ?p - place) (rested) (lost)) {actions})"
    lost = parse_problem("(define (problem p) (:domain d) (:init (at a)) (:goal (at c)))", parse_domain(text))
    monkeypatch.setattr(PolicySearch, "policies", lambda *_: iter(()))
    monkeypatch.setattr(PolicySearch, "is_in_vain", True)
    found = solve(lost)
    assert found.message == "no policy was found in time"
    assert isinstance(found.policy, Thinking)
    state = initial_knowledge(lost)

    def follows(*facts: str) -> list[str] | None:
        state.update(dict.fromkeys([("at", "a"), ("at", "b"), ("lost",)], False))
        state.update({tuple(fact.split()): True for fact in facts})
        plan = found.policy and found.policy.stretch(state)
        return plan and [f"{step.action} {' '.join(step.arguments)}" for step in plan.steps]

    assert follows("at a") == ["rest ", "go a c"], "up to what may end in several ways"
    assert follows("at a", "rested") == ["go a c"], "not again what has been done"
    assert follows("lost") is None, "there a planner is asked"
    again = solve(lost, before=found.policy)
    assert isinstance(again.policy, Thinking)
    assert again.policy.search.is_hard, "for which nobody waits"


def test_a_better_policy_that_has_led_nowhere_is_not_followed_again() -> None:
    go = problem("(:action go :parameters () :effect (oneof (done) (and)))")
    best, other, newer = (Policy(go, ()) for _ in range(3))
    thinking = Thinking(PolicySearch(go), 0.0)
    thinking.found = best, other
    thinking.follow(best)
    thinking.follow(other)
    assert thinking.policies == (other,)
    thinking.found = newer, *thinking.found
    thinking.follow(other)
    assert thinking.policies == (newer, other), "what was never followed may be of use later"
