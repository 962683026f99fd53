"""Why there is no plan: short reasons that are right, and nothing called proved that rests on another arithmetic than ours."""

from __future__ import annotations

import time

import pytest
from hypothesis import HealthCheck, example, given, settings, strategies as st

from planner_bridge.model.grounding import initial_knowledge, problem_now
from planner_bridge.model.guards import ForbiddenCall, forbid
from planner_bridge.model.plan import PlanningStatus
from planner_bridge.model.problem import Problem
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.planning import reachability
from planner_bridge.planning.reachability import GoalLiteral, Reachability, TooLarge, literal_of, why_unreachable
from planner_bridge.planning.solve import solve
from pnm.core.logic.expressions import UNKNOWN
from tests.support.pddl.problems import fleet, hard, rooms
from tests.support.pddl.random_problems import Features, problems as random_problems

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
        "(at r1 c) and (clean c) cannot be reached: move(r1, a, c) would do the first, but (way a c) is never true"
    )
    closed = parse_problem(CLOSED.replace("(at r1 dock))))", "(at r1 kitchen))))"), parse_domain(FETCH))
    assert why_unreachable(closed).startswith("(holding r1 cup) and (at r1 kitchen) cannot be reached: ")


def test_an_action_that_is_not_to_be_tried_again_is_the_reason() -> None:
    forbidden = forbid(rooms(ways="ab bc", goal="(at r1 c)"), frozenset({ForbiddenCall("move", ("r1", "b", "c"))}))
    assert why_unreachable(forbidden) == ("(at r1 c) cannot be reached: move(r1, b, c) would do it, but move(r1, b, c) must not be used")


def add(rest: str) -> str:
    return f"(:action add :parameters () {rest})"


ROUND = "(:action open :parameters () :precondition (q) :effect (r)) (:action add :parameters () :precondition (or (p) (r)) :effect (p))"
LASTING = "(:durative-action add :parameters () :duration (= ?duration (/ 1 (a))) :condition () :effect (at end (p)))"
CIRCLE = "(:action one :parameters () :precondition (q) :effect (p)) (:action two :parameters () :precondition (p) :effect (q))"
BESIDE = "(:action open :parameters () :precondition (q) :effect (r)) (:action go :parameters () :precondition (and (r) (s)) :effect (p))"


@pytest.mark.parametrize(
    ("goal", "init", "actions", "reason"),
    [
        ("(p)", "", "", "(p) cannot be reached: no action brings it about"),
        ("(not (p))", "(p)", "", "(not (p)) cannot be reached: no action brings it about"),
        ("(p)", "(= (a) 1)", add(":precondition (> (a) 2) :effect (p)"), "add() would do it, but (> (a) 2) [now 1] is"),
        (
            "(p)",
            "(= (a) 1) (= (b) 2)",
            add(":precondition (>= (a) (b)) :effect (p)"),
            "but (>= (a) (b)) [now (a) is 1, (b) is 2] is never true",
        ),
        ("(p)", "", LASTING, "add() would do it, but (a) has no value"),
        ("(p)", "", add(":precondition (or (q) (r)) :effect (p)"), "add() would do it, but (q) is never true"),
        ("(p)", "", add(":precondition (or (p) (q)) :effect (p)"), "(p) cannot be reached: add() would do it, but (q) is never true"),
        ("(p)", "", add(":precondition (or (p) (imply (p) (q))) :effect (p)"), ""),
        ("(p)", "", ROUND, "(p) cannot be reached: add() would do it, but (p) is never true"),
        ("(p)", "", add(":precondition (and (q) (r)) :effect (p)"), "but (q) and (r) are never true"),
        ("(p)", "", add(":effect (when (q) (p))"), "add() would do it, but (q) is never true"),
        ("(both)", "(p)", "(:derived (both) (and (p) (q)))", "(both) cannot be reached: (q) is never true"),
        ("(p)", "", CIRCLE, "(p) cannot be reached"),
        ("(p)", "", BESIDE, "(p) cannot be reached: go() would do it, but (s) is never true"),  # what it needs itself, and no more
    ],
)
def test_the_condition_that_is_never_true_is_named(goal: str, init: str, actions: str, reason: str) -> None:
    assert reason in why_unreachable(small(goal, init, actions=actions))


def test_a_robot_whose_place_is_unknown_may_be_anywhere() -> None:
    problem = parse_problem(CLOSED.replace("(on cup", "(door_open) (on cup"), parse_domain(FETCH))
    world = initial_knowledge(problem)
    world.update({("at", "r1", place): UNKNOWN for place in ("dock", "hall", "kitchen")})
    found = solve(problem_now(problem, world))
    assert found.status is PlanningStatus.NO_PLAN
    assert found.message == (
        "(holding r1 cup) cannot be reached with what is known: grasp(r1, cup, kitchen) would do it, but (at r1 kitchen) is unknown; "
        "(at r1 dock) cannot be reached with what is known: (at r1 dock) is unknown"
    )
    world.update({("door_open",): False, ("at", "r1", "kitchen"): False})
    assert solve(problem_now(problem, world)).status is PlanningStatus.UNSOLVABLE  # wherever it is: the door is closed


@given(st.booleans().flatmap(lambda timed: random_problems(Features(timed=timed))))
@settings(suppress_health_check=list(HealthCheck))
@example(fleet(goal="(in p0 a2)"))
@example(hard(3))
def test_what_a_plan_reaches_is_not_called_unreachable(problem: Problem) -> None:
    found = solve(problem, timeout=2.0)
    assert not (found.plan and why_unreachable(problem))


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


def test_what_takes_too_long_to_explain_is_not_explained(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reachability, "_STEPS", 50_000)
    # every room needs every tool, every tool all others, and each way to them leads through all rooms
    domain = parse_domain(
        """(define (domain d) (:requirements :typing :adl) (:types room tool)
        (:predicates (at ?a - room) (has ?t - tool) (key ?a - room))
        (:action go :parameters (?a ?b - room) :precondition (and (at ?a) (key ?b) (forall (?t - tool) (or (has ?t) (key ?a))))
          :effect (and (at ?b) (not (at ?a))))
        (:action forge :parameters (?t - tool ?a - room)
          :precondition (and (at ?a) (forall (?u - tool) (imply (not (= ?u ?t)) (has ?u)))) :effect (has ?t))
        (:action cut :parameters (?a - room ?t - tool) :precondition (has ?t) :effect (key ?a)))"""
    )

    def reason(rooms: int, tools: int) -> str:
        names = [f"r{index}" for index in range(rooms)], [f"t{index}" for index in range(tools)]
        objects = f"(:objects {' '.join(names[0])} - room {' '.join(names[1])} - tool)"
        text = f"(define (problem p) (:domain d) {objects} (:init (at r0)) (:goal (at {names[0][-1]})))"
        return why_unreachable(parse_problem(text, domain))

    assert reason(4, 3).startswith("(at r3) cannot be reached: go(r0, r3) would do it")
    assert reason(60, 12) == ""


# --- laws ----------------------------------------------------------------------------------


@given(random_problems())
@settings(suppress_health_check=list(HealthCheck))
def test_no_achiever_has_a_cheaper_lack_than_what_it_achieves(problem: Problem) -> None:
    reached = Reachability(problem, problem.unknown)
    reached.settle(problem.goal)
    seen = set[GoalLiteral]()
    waiting = [literal for lack in reached.of(problem.goal) if (literal := literal_of(lack))]
    while waiting:
        literal = waiting.pop()
        if literal in seen:
            continue
        seen.add(literal)
        way = reached.way(literal)
        for achiever in way.achievers if way.lack else ():
            lack = reached.of(achiever.condition, achiever.env)
            assert reached.cost(lack) >= reached.cost(way.lack)
            waiting += [literal for condition in lack if (literal := literal_of(condition))]


def test_a_time_that_is_over_ends_the_search() -> None:
    problem = rooms(ways="ab")
    with pytest.raises(TooLarge):
        Reachability(problem, problem.unknown).settle(problem.goal, time.monotonic() - 1.0)
