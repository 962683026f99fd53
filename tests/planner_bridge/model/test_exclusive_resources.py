"""Resources that actions have for themselves are known to the planner: a robot is never planned in two places at once."""

from __future__ import annotations

from itertools import combinations

from planner_bridge.model.guards import relied_on, with_turns
from planner_bridge.model.problem import Problem
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.planning.solve import solve
from pnm.core.machine.bindings import Binding, Bindings

VISITS = """
(define (domain visits)
  (:requirements :durative-actions :typing)
  (:types robot place)
  (:predicates (at ?r - robot ?a - place) (seen ?a - place) (waved ?r - robot))
  (:durative-action visit :parameters (?r - robot ?a - place) :duration (= ?duration 5) :condition () :effect (at end (seen ?a)))
  (:durative-action drive :parameters (?v - robot ?from ?to - place) :duration (= ?duration 5)
    :condition (at start (at ?v ?from)) :effect (and (at start (not (at ?v ?from))) (at end (at ?v ?to))))
  (:durative-action wave :parameters (?r - robot ?a - place) :duration (= ?duration 5)
    :condition (over all (at ?r ?a)) :effect (at end (waved ?r))))
"""
ROBOT_ALONE = Bindings(
    {"visit": Binding(resources=("{r}/base",)), "drive": Binding(resources=("{v}/base",)), "wave": Binding(resources=("{r}/base",))}
)


def visits(goal: str, robots: str = "r1") -> Problem:
    things = f"(:objects {robots} - robot a b c - place)"
    text = f"(define (problem p) (:domain visits) {things} (:init (at r1 a)) (:goal {goal}))"
    return parse_problem(text, parse_domain(VISITS))


def overlapping(problem: Problem, bindings: Bindings) -> int:
    """Return how many pairs of calls of the plan go on at the same time."""
    plan = solve(problem, bindings=bindings).plan
    assert plan is not None
    pairs = combinations(plan.steps, 2)
    return sum(one.start < other.start + other.duration and other.start < one.start + one.duration for one, other in pairs)


def test_a_robot_is_not_planned_in_two_places_at_once() -> None:
    everything = visits("(and (seen a) (seen b) (seen c))")
    assert overlapping(everything, Bindings()) == 3
    assert overlapping(everything, ROBOT_ALONE) == 0


def test_two_robots_are_planned_at_the_same_time_all_the_same() -> None:
    plan = solve(visits("(and (seen a) (seen b))", robots="r1 r2"), bindings=ROBOT_ALONE).plan
    assert plan is not None
    assert plan.makespan < 6.0


def test_it_is_said_where_a_domain_relies_on_resources() -> None:
    assert relied_on(visits("(seen a)").domain, ROBOT_ALONE) == {"{r}/base": ("drive", "visit", "wave")}
    others = Bindings({name: binding for name, binding in ROBOT_ALONE.actions.items() if name != "visit"})
    assert relied_on(visits("(seen a)").domain, others) == {"{r}/base": ("wave",)}
    assert relied_on(visits("(seen a)").domain, Bindings({"drive": ROBOT_ALONE.of("drive")})) == {}


def test_without_resources_the_problem_stays_as_it_is() -> None:
    problem = visits("(seen a)")
    assert with_turns(problem, Bindings()) is problem
