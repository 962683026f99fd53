"""Why there is no plan: short reasons that are right, and nothing called proved that rests on another arithmetic than ours."""

from __future__ import annotations

import pytest

from planner_bridge.model.forbidden_actions import ForbiddenCall, forbid
from planner_bridge.model.plan import PlanningStatus
from planner_bridge.model.problem import Problem
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.planning.solve import solve
from planner_bridge.planning.unreachable import why_unreachable
from tests.support.pddl.problems import fleet, hard, matches, rooms, tanks

FETCH = """
(define (domain fetch)
  (:requirements :typing :durative-actions :negative-preconditions)
  (:types robot place item)
  (:predicates (at ?r - robot ?p - place) (on ?i - item ?p - place) (holding ?r - robot ?i - item) (hand_empty ?r - robot)
    (door_open) (linked ?a ?b - place) (through_door ?a ?b - place))
  (:durative-action move :parameters (?r - robot ?from ?to - place) :duration (= ?duration 2)
    :condition (and (at start (at ?r ?from)) (at start (linked ?from ?to)))
    :effect (and (at start (not (at ?r ?from))) (at end (at ?r ?to))))
  (:durative-action move_through :parameters (?r - robot ?from ?to - place) :duration (= ?duration 2)
    :condition (and (at start (at ?r ?from)) (at start (through_door ?from ?to)) (over all (door_open)))
    :effect (and (at start (not (at ?r ?from))) (at end (at ?r ?to))))
  (:durative-action grasp :parameters (?r - robot ?i - item ?p - place) :duration (= ?duration 1)
    :condition (and (over all (at ?r ?p)) (at start (on ?i ?p)) (at start (hand_empty ?r)))
    :effect (and (at start (not (hand_empty ?r))) (at end (not (on ?i ?p))) (at end (holding ?r ?i)))))
"""
CLOSED = """
(define (problem fetch1) (:domain fetch)
  (:objects r1 - robot dock hall kitchen - place cup - item)
  (:init (at r1 dock) (hand_empty r1) (on cup kitchen) (linked dock hall) (linked hall dock)
    (through_door hall kitchen) (through_door kitchen hall))
  (:goal (and (holding r1 cup) (at r1 dock))))
"""


def small(goal: str, init: str = "", *, actions: str = "") -> Problem:
    """A problem about p, q, r and the numbers a and b."""
    domain = parse_domain(f"""(define (domain small)
      (:requirements :adl :typing :numeric-fluents :durative-actions :timed-initial-literals :derived-predicates)
      (:predicates (p) (q) (r) (s) (both)) (:functions (a) (b)) {actions})""")
    return parse_problem(f"(define (problem x) (:domain small) (:init {init}) (:goal {goal}))", domain)


def test_a_closed_door_is_the_reason() -> None:
    found = solve(parse_problem(CLOSED, parse_domain(FETCH)))
    assert found.reason == (
        "proved unsolvable: (holding r1 cup) cannot be reached: grasp(r1, cup, kitchen) would do it, "
        "but move_through(r1, hall, kitchen) needs (door_open), which is never true"
    )


def test_goals_with_the_same_reason_have_it_said_once() -> None:
    nowhere = rooms(ways="ab", goal="(and (at r1 b) (at r1 c) (clean c))")
    assert why_unreachable(nowhere) == (
        "(at r1 c) and (clean c) cannot be reached: move(r1, a, c) would do it, but (way a c) is never true"
    )
    closed = parse_problem(CLOSED.replace("(at r1 dock))))", "(at r1 kitchen))))"), parse_domain(FETCH))
    assert why_unreachable(closed).startswith("(holding r1 cup) and (at r1 kitchen) cannot be reached: ")


def test_an_action_that_is_not_to_be_tried_again_is_the_reason() -> None:
    forbidden = forbid(rooms(ways="ab bc", goal="(at r1 c)"), frozenset({ForbiddenCall("move", ("r1", "b", "c"))}))
    assert why_unreachable(forbidden) == (
        "(at r1 c) cannot be reached: move(r1, b, c) would do it, but (not (forbidden-move r1 b c)) is never true"
    )


@pytest.mark.parametrize(
    ("goal", "init", "actions", "reason"),
    [
        ("(p)", "", "", "(p) cannot be reached: no action brings it about"),
        ("(not (p))", "(p)", "", "(not (p)) cannot be reached: no action brings it about"),
        ("(p)", "(= (a) 1)", "(:action add :parameters () :precondition (> (a) 2) :effect (p))", "add() would do it, but (> (a) 2) is"),
        ("(p)", "", "(:action add :parameters () :precondition (or (q) (r)) :effect (p))", "add() would do it, but (q) is never true"),
        ("(p)", "", "(:action add :parameters () :precondition (and (q) (r)) :effect (p))", "but (q) and (r) are never true"),
        ("(p)", "", "(:action add :parameters () :effect (when (q) (p)))", "add() would do it, but (q) is never true"),
        ("(both)", "(p)", "(:derived (both) (and (p) (q)))", "(both) cannot be reached: (q) is never true"),
        (
            "(p)",
            "",
            "(:action one :parameters () :precondition (q) :effect (p)) (:action two :parameters () :precondition (p) :effect (q))",
            "(p) cannot be reached",
        ),
    ],
)
def test_the_condition_that_is_never_true_is_named(goal: str, init: str, actions: str, reason: str) -> None:
    assert reason in why_unreachable(small(goal, init, actions=actions))


@pytest.mark.parametrize(
    "problem",
    [rooms(), matches(), tanks(), fleet(goal="(in p0 a2)"), hard(3), small("(p)", "(at 5 (p))")],
    ids=["rooms", "what a start makes true over all", "numbers", "fleet", "found by search only", "time"],
)
def test_what_may_be_reached_is_not_explained(problem: Problem) -> None:
    assert why_unreachable(problem) == ""


EITHER = """(:action one :parameters () :precondition (s) :effect (and (p) (not (s))))
            (:action two :parameters () :precondition (s) :effect (and (q) (not (s))))"""


@pytest.mark.parametrize(
    ("init", "actions", "status"),
    [
        ("(s) (= (a) 1)", "", PlanningStatus.UNSOLVABLE),
        ("(s) (= (a) 1.5)", "", PlanningStatus.UNSOLVABLE),
        ("(s) (= (a) 1.5)", "(:action more :parameters () :precondition (> (a) 1) :effect (r))", PlanningStatus.UNSOLVABLE),
        ("(s) (= (a) 1.5)", "(:action more :parameters () :precondition (> (* (a) (a)) 1) :effect (r))", PlanningStatus.NO_PLAN),
        ("(s) (= (a) 1)", "(:action more :parameters () :precondition (> (a) 1) :effect (r))", PlanningStatus.UNSOLVABLE),
        ("(s) (= (a) 1)", "(:action more :parameters () :precondition (> (a) 0.000001) :effect (r))", PlanningStatus.NO_PLAN),
        ("(s) (= (a) 1)", "(:action more :parameters () :precondition (> (/ (a) 3) 1) :effect (r))", PlanningStatus.NO_PLAN),
    ],
)
def test_what_only_a_search_rules_out_is_proved_with_whole_numbers_alone(init: str, actions: str, status: PlanningStatus) -> None:
    assert solve(small("(and (p) (q))", init, actions=EITHER + actions)).status is status
