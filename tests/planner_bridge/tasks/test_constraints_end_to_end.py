"""Constraints from PDDL text to the goal: planned for, kept, planned for again; with times."""

from __future__ import annotations

import pytest

from planner_bridge.model.problem import Problem
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.tasks.replanning import PlanAgain
from planner_bridge.tasks.result import TaskResult
from planner_bridge.tasks.settings import Settings
from pnm.actions.faults import Fault, FaultKind, Faults, HiddenChange
from tests.support.pddl.problems import ROOMS
from tests.support.tasks.replanning import pursued
from tests.support.tasks.rooms import ROUND, done, ring


def statuses(result: TaskResult) -> list[str]:
    return [one.status for one in result.constraints]


# --- planned for, and kept ---


@pytest.mark.parametrize(
    ("constraint", "calls"),
    [
        ("(sometime (clean d))", ["move(r1, a, d)", "sweep(r1, d)", "move(r1, d, c)"]),
        ("(always (not (at r1 b)))", ["move(r1, a, d)", "move(r1, d, c)"]),
        ("(forall (?a - room) (sometime-after (at r1 ?a) (clean d)))", ["move(r1, a, d)", "sweep(r1, d)", "move(r1, d, c)"]),
        ("(and (sometime-before (at r1 c) (clean d)) (at end (not (clean a))))", ["move(r1, a, d)", "sweep(r1, d)", "move(r1, d, c)"]),
    ],
)
def test_a_plan_keeps_the_constraints_and_so_does_its_run(constraint: str, calls: list[str]) -> None:
    result, _ = pursued(ring(constraint))
    assert result.goal_reached, result.reason
    assert done(result) == calls
    assert set(statuses(result)) == {"fulfilled"}


def test_calls_that_a_constraint_keeps_apart_are_not_carried_out_at_once() -> None:
    both = ring(
        "(always (not (and (at r1 b) (at r2 b))))", init="(at r1 a) (at r2 a)", goal="(and (at r1 c) (at r2 c))", ways="(way a b) (way b c)"
    )
    result, _ = pursued(both)
    assert result.goal_reached, result.reason
    assert statuses(result) == ["fulfilled"]


def test_constraints_of_a_domain_are_kept() -> None:
    constrained = ROOMS.replace(":strips", ":adl :constraints :strips", 1).replace(
        "(:action move", "(:constraints (forall (?r - robot) (always (not (at ?r b)))))\n (:action move", 1
    )
    text = f"(define (problem p) (:domain rooms) (:objects r1 - robot a b c d - room) (:init (at r1 a) {ROUND}) (:goal (at r1 c)))"
    result, _ = pursued(parse_problem(text, parse_domain(constrained)))
    assert done(result) == ["move(r1, a, d)", "move(r1, d, c)"]
    assert statuses(result) == ["fulfilled"]


TAKEN_TO_C = Faults(
    (Fault("sweep(r1, d)", FaultKind.ABORT, times=2),), (HiddenChange({("at", "r1", "d"): False, ("at", "r1", "c"): True}, at=1.9),)
)
"""The robot is in d, cannot sweep it, and is carried to c."""


# --- planned for again ---


@pytest.mark.parametrize("constraint", ["(sometime (clean d))", "(and (sometime-after (at r1 d) (clean d)) (always (not (at r1 b))))"])
def test_a_goal_that_holds_is_not_reached_while_something_is_missing(constraint: str) -> None:
    result, truth = pursued(ring(constraint), TAKEN_TO_C)
    assert result.goal_reached, result.reason
    assert isinstance(result.episodes[0].decision, PlanAgain)
    assert truth.value(("clean", "d")) is True


def test_what_may_not_happen_again_is_avoided_after_a_failure() -> None:
    back = HiddenChange({("at", "r1", "b"): False, ("at", "r1", "a"): True, ("way", "a", "d"): True, ("way", "d", "c"): True}, at=1.9)
    faults = Faults((Fault("move(r1, b, c)", FaultKind.ABORT, times=2),), (back,))
    result, _ = pursued(ring("(at-most-once (at r1 b))", ways="(way a b) (way b c)"), faults)
    assert result.goal_reached, result.reason
    assert done(result) == ["move(r1, a, b)", "move(r1, a, d)", "move(r1, d, c)"]
    assert statuses(result) == ["fulfilled"]


WALKS = """
(define (domain walks) (:requirements :adl :durative-actions :constraints)
  (:predicates (at ?a) (way ?a ?b) (lit))
  (:durative-action walk :parameters (?a ?b) :duration (= ?duration 4)
    :condition (and (at start (at ?a)) (over all (way ?a ?b)))
    :effect (and (at start (not (at ?a))) (at end (at ?b))))
  (:durative-action light :parameters () :duration (= ?duration 1) :condition () :effect (at end (lit)))
  (:durative-action darken :parameters () :duration (= ?duration 1) :condition (at start (lit)) :effect (at end (not (lit)))))
"""


def walk(constraints: str, goal: str = "(at c)", init: str = "") -> Problem:
    text = f"(define (problem p) (:domain walks) (:objects a b c) (:init (at a) (way a b) (way b c) {init}) (:goal {goal})"
    return parse_problem(f"{text} (:constraints {constraints}))", parse_domain(WALKS))


TRIED_TWICE = Faults((Fault("walk(b, c)", FaultKind.ABORT, times=2),))
"""After four seconds in vain the robot is still in b; it is then eight seconds after the start."""


# --- times ---


def test_a_deadline_that_a_new_plan_can_meet_is_met() -> None:
    result, _ = pursued(walk("(within 13 (at c))"), TRIED_TWICE)
    assert result.goal_reached, result.reason
    assert (result.replans, statuses(result)) == (1, ["fulfilled"])


def test_a_deadline_that_no_plan_can_meet_any_more_ends_the_task() -> None:
    result, _ = pursued(walk("(within 11 (at c))"), TRIED_TWICE, Settings(planner_timeout=0.5))  # it finds none, but no proof either
    assert not result.goal_reached
    assert "; no plan" in result.reason
    assert statuses(result) == ["violated"]


def test_what_a_constraint_forbids_for_some_time_is_not_done_too_early() -> None:
    result, _ = pursued(walk("(hold-during 0 3 (not (lit)))", "(and (at c) (lit))"))
    assert result.goal_reached, result.reason
    assert statuses(result) == ["fulfilled"]
