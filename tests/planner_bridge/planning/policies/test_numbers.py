"""Policies with numbers: a battery that lasts whatever doors do, exact answers, and what the proof refuses."""

from __future__ import annotations

import re

import pytest

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.problem import Problem
from planner_bridge.ordering.robot_time import ExpectedTimes
from planner_bridge.pddl.reader import parse_domain, parse_problem
from planner_bridge.planning.policies.grounding import Seconds, policy_task
from planner_bridge.planning.policies.numbers import MOST_VALUES
from planner_bridge.planning.policies.policy import Policy, policies
from planner_bridge.planning.policies.proof import unproved
from planner_bridge.planning.policies.task import Unsuitable
from planner_bridge.planning.solve import solve
from pnm.core.machine.bindings import Binding, Bindings

DOOR = """
(define (domain door) (:requirements :typing :negative-preconditions :fluents :non-deterministic) (:types place)
  (:predicates (at ?p - place) (way ?p ?q - place) (door ?p ?q - place) (open ?p ?q - place) (locked ?p ?q - place) (dock ?p - place))
  (:functions (battery) (use ?p ?q - place))
  (:action drive :parameters (?p ?q - place)
    :precondition (and (at ?p) (way ?p ?q) (>= (battery) (use ?p ?q)))
    :effect (and (not (at ?p)) (at ?q) (decrease (battery) (use ?p ?q))))
  (:action try :parameters (?p ?q - place)
    :precondition (and (at ?p) (door ?p ?q) (not (open ?p ?q)) (not (locked ?p ?q)) (>= (battery) 5))
    :effect (and (decrease (battery) 5) (oneof (open ?p ?q) (locked ?p ?q) (and))))
  (:action pass :parameters (?p ?q - place)
    :precondition (and (at ?p) (open ?p ?q) (>= (battery) 5))
    :effect (and (not (at ?p)) (at ?q) (decrease (battery) 5)))
  (:action charge :parameters (?p - place) :precondition (and (at ?p) (dock ?p)) :effect (assign (battery) 100)))
"""
HOUSE = """
(define (problem p) (:domain door) (:objects dock hall garden yard street lobby room - place)
  (:init (at hall) (= (battery) 22) (dock dock) (door hall room) (way hall dock) (way dock hall)
    (way hall garden) (way garden yard) (way yard street) (way street lobby) (way lobby room)
    (= (use hall dock) 20) (= (use dock hall) 20) (= (use hall garden) 30) (= (use garden yard) 5) (= (use yard street) 5)
    (= (use street lobby) 5) (= (use lobby room) 2.5))
  (:goal (at room)))
"""
"""The door may be locked, or stick; round it it is 47.5. After one attempt with 22 there is no way but that through the door."""


def house(battery: float = 22, domain: str = DOOR) -> Problem:
    return parse_problem(HOUSE.replace("(= (battery) 22)", f"(= (battery) {battery})"), parse_domain(domain))


def found(problem: Problem, seconds: Seconds | None = None) -> Policy:
    *_, best = policies(problem, 60.0, seconds)
    return best


def test_the_battery_is_charged_before_the_door_that_may_not_open() -> None:
    policy = found(house())
    assert policy.is_proved
    stretch = policy.stretch(initial_knowledge(house()))
    assert stretch is not None
    assert [step.action for step in stretch.steps] == ["drive", "charge", "drive", "try"]
    stretch = policy.stretch(initial_knowledge(house(77.7)))  # a value that was never counted on
    assert stretch is not None
    assert [step.action for step in stretch.steps] == ["try"]
    assert any("(>= (battery)" in fact for entry in policy.as_json()["entries"] for fact in entry["facts"])  # type: ignore[attr-defined]


def test_of_many_values_some_count_and_the_proof_is_about_all() -> None:
    domain = DOOR.replace("(battery) 5)", "(battery) 4.7)").replace("(and (at ?p) (dock ?p))", "(and (at ?p) (dock ?p) (< (battery) 100))")
    text = HOUSE.replace("(use hall dock) 20", "(use hall dock) 17.313").replace("(use hall garden) 30", "(use hall garden) 28.441")
    problem = parse_problem(text.replace(" 5)", " 4.177)"), parse_domain(domain))
    (scale,) = policy_task(problem).scales
    assert len(scale.values) > MOST_VALUES
    policy = found(problem)
    assert policy.is_proved
    stretch = policy.stretch(initial_knowledge(problem))
    assert stretch is not None
    assert [step.action for step in stretch.steps] == ["drive", "charge", "drive", "try"]


def test_what_only_holds_for_rounded_values_is_no_policy() -> None:
    domain = parse_domain("""(define (domain tanks) (:requirements :typing :fluents :equality :non-deterministic) (:types tank)
      (:functions (level ?t - tank))
      (:action pour :parameters (?from ?to - tank) :precondition (and (>= (level ?from) 2) (not (= ?from ?to)))
        :effect (oneof (and (decrease (level ?from) 2) (increase (level ?to) 2)) (and))))""")
    text = "(define (problem p) (:domain tanks) (:objects a b - tank) (:init (= (level a) 6) (= (level b) 7)) (:goal (= (level b) {})))"
    assert not [*policies(parse_problem(text.format(4), domain), 60.0)]
    assert found(parse_problem(text.format(5), domain)).is_proved


@pytest.mark.parametrize("wrong", ["less in the battery", "nothing about it"])
def test_the_proof_refuses_what_the_battery_does_not_last_for(wrong: str) -> None:
    entries = list(found(house()).entries)
    assert unproved(house(), entries, initial_knowledge(house())) == ""
    tries = [number for number, entry in enumerate(entries) if entry.action == "try"]
    number = min(tries, key=lambda number: entries[number].numbers["battery",][0])
    entries[number] = entries[number]._replace(numbers={("battery",): (5.0, 100.0)} if wrong == "less in the battery" else {})
    assert unproved(house(), entries, initial_knowledge(house())) != ""


def test_entries_are_chosen_by_expected_seconds() -> None:
    rates = ExpectedTimes(Bindings({"try": Binding(seconds=200.0), "drive": Binding(seconds=30.0)}))
    for policy, measure, first in ((found(house(80)), "calls", "try"), (found(house(80), rates.expected), "s", "drive")):
        assert policy.is_proved
        assert policy.measure == measure
        assert policy.entry(initial_knowledge(house(80))).action == first


def test_the_metric_counts_where_there_is_one() -> None:
    metric = re.sub(r"\(decrease \(battery\) (\(use \?p \?q\)|5)\)", r"(decrease (battery) \1) (increase (total-cost) \1)", DOOR)
    domain = parse_domain(metric.replace("(:functions", "(:functions (total-cost)"))
    problem = parse_problem(HOUSE.replace("(:init", "(:metric minimize (total-cost)) (:init (= (total-cost) 0)"), domain)
    policy = found(problem)
    assert policy.is_proved
    assert policy.measure == "of the metric"


def test_a_plan_with_numbers_comes_with_its_policy() -> None:
    result = solve(house())
    assert result.policy is not None
    assert result.policy.is_proved


def test_numbers_that_depend_on_each_other_are_said_to_be_too_much() -> None:
    domain = DOOR.replace("(:functions", "(:functions (spare)").replace(
        "(assign (battery) 100)", "(and (assign (battery) (spare)) (decrease (spare) 1))"
    )
    with pytest.raises(Unsuitable, match=r"what is done with \(battery\) depends on more than itself"):
        found(parse_problem(HOUSE.replace("(:init", "(:init (= (spare) 100)"), parse_domain(domain)))
