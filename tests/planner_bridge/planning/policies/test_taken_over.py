"""What a search for a policy has found is used by the next one for the same goal: dead ends, entries and plans."""

from __future__ import annotations

from dataclasses import replace
from random import Random
from typing import Any

import pytest
from hypothesis import given, strategies as st

from planner_bridge.model.guards import ForbiddenCall, forbid, without_guards
from planner_bridge.model.problem import Problem
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.planning.policies.encoding import OutcomePlanner, Step
from planner_bridge.planning.policies.policy import PolicySearch, policies
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.core.logic.effects import Set
from pnm.core.logic.expressions import Constant, Fluent, Value
from pnm.core.machine.plan_graph import GroundAction
from tests.support.pddl.chance import Exact, random_problem
from tests.support.tasks.replanning import pursued

STEPS = """(define (domain steps) (:requirements :strips :typing :non-deterministic) (:types place)
  (:predicates (at ?p - place) (next ?a ?b - place) (fallen))
  (:action step :parameters (?a ?b - place) :precondition (and (at ?a) (next ?a ?b) (not (fallen)))
    :effect (oneof (and (at ?b) (not (at ?a))) (fallen)))
  (:action rise :parameters () :precondition (fallen) :effect (not (fallen))))"""
WAY = """(define (problem way) (:domain steps) (:objects a b c d - place)
  (:init (at a) (next a b) (next b c) (next c d) (next b d)) (:goal (at d)))"""


def elsewhere(problem: Problem, state: frozenset[tuple[Fluent, Value]], calls: frozenset[ForbiddenCall]) -> Problem:
    """Return the problem from a state, without these calls."""
    return forbid(replace(problem, init={fluent: value for fluent, value in state if value is not False}), calls)  # type: ignore[attr-defined]


@given(st.integers(0, 10_000), st.sampled_from(["", "counts", "derives"]))
def test_a_policy_is_as_good_as_one_that_is_looked_for_anew(seed: int, kind: str) -> None:
    problem = random_problem(seed, counts=kind == "counts", derives=kind == "derives")
    chance, before = Random(seed), PolicySearch(problem)
    for _ in before.policies(60.0):
        pass
    entries = before.certain.entries if before.certain else []
    used = [ForbiddenCall(entry.action.name, entry.action.arguments) for entry in entries if entry.action]
    for _ in range(3):
        state = chance.choice(sorted(Exact(problem).transitions, key=str) or [Exact(problem).initial])
        now = elsewhere(problem, state, frozenset(chance.sample(used, min(len(used), chance.choice([0, 1, 2])))))
        again = [*PolicySearch(now, before=before).policies(60.0)][-1:]
        anew = [*policies(now, 60.0)][-1:]
        assert [one.is_proved for one in again] == [one.is_proved for one in anew]
        assert sum(one.chance for one in again) == pytest.approx(Exact(now).best_chance, abs=1e-5)


def test_no_plan_is_looked_for_where_a_policy_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    way = parse_problem(WAY, parse_domain(STEPS))
    before = PolicySearch(way)
    assert next(before.policies(60.0)).is_proved
    monkeypatch.delattr(OutcomePlanner, "plan")
    for state in ([("at", "a"), ("fallen",)], [("at", "b")], [("at", "b"), ("fallen",)]):
        init = {fluent: value for fluent, value in way.init.items() if fluent[0] == "next"} | dict.fromkeys(state, True)
        assert next(PolicySearch(replace(way, init=init), before=before).policies(60.0)).is_proved
    with pytest.raises(AttributeError):
        next(PolicySearch(replace(way, goal=parse_problem(WAY.replace("(at d)", "(at c)"), way.domain).goal), before=before).policies(60.0))


@pytest.mark.parametrize(
    ("change", "old", "new"),
    [
        ("a fact that was never to be", "(at a)", "(at a) (next c b)"),
        ("another object", "c d", "c d e"),
        ("one that is nowhere", "(at a) ", ""),
        ("two places at once", "(at a)", "(at a) (at b)"),
    ],
)
def test_what_is_another_task_is_looked_into_anew(change: str, old: str, new: str) -> None:
    domain = parse_domain(STEPS)
    before = PolicySearch(parse_problem(WAY, domain))
    assert next(before.policies(60.0)).is_proved
    assert PolicySearch(parse_problem(WAY.replace(old, new, 1), domain), before=before).certain is None, change


def test_a_call_that_is_allowed_again_may_lead_out_of_a_dead_end() -> None:
    way = parse_problem(WAY, parse_domain(STEPS))
    forbidden = forbid(way, frozenset(ForbiddenCall("step", (place, "d")) for place in "bc"))
    before = PolicySearch(forbidden)
    assert not [*before.policies(60.0)]
    assert next(PolicySearch(way, before=before).policies(60.0)).is_proved
    assert without_guards(forbidden).domain.actions == way.domain.actions


def test_after_a_failure_the_policy_is_made_of_what_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    asked, plan = list[int](), OutcomePlanner.plan

    def counted(self: OutcomePlanner, state: int, *rest: Any) -> list[Step] | None:
        asked.append(state)
        return plan(self, state, *rest)

    def draw(action: GroundAction, _: Random) -> Fault | None:
        """The first step is a failure, although the robot falls: another end than those that are declared."""
        if action.outcomes and not drawn:
            drawn.append(action)
            return Fault(action.name, FaultKind.ABORT, for_good=True, failed=(Set(("fallen",), Constant(True)),))
        return Fault(action.name, outcome="1") if action.outcomes else None

    drawn: list[GroundAction] = []
    monkeypatch.setattr(OutcomePlanner, "plan", counted)
    result, _ = pursued(parse_problem(WAY, parse_domain(STEPS)), Faults(drawn=draw))
    assert (result.goal_reached, result.replans, len(result.failures)) == (True, 1, 1)
    assert len(asked) == 1
