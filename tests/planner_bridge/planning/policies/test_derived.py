"""Policies where derived facts count: exact answers, what the proof refuses, and a household whose doors may not open."""

from __future__ import annotations

import pytest

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.problem import Problem
from planner_bridge.pddl.reader import parse_domain, parse_problem
from planner_bridge.pipeline.achieve import achieve
from planner_bridge.planning.policies.policy import Policy, policies
from planner_bridge.planning.policies.proof import unproved
from planner_bridge.planning.policies.task import Unsuitable
from planner_bridge.tasks.settings import Settings
from pnm.actions.faults import Faults
from tests.support.files import ROOT

OUTCOMES = {
    "(and (open ?hallway) (decrease (battery ?robot) (door_use)))": """(and (decrease (battery ?robot) (door_use))
      (probabilistic 0.6 (open ?hallway)))""",
    """(not (free ?robot)) (not (on ?item ?furniture)) (holding ?robot ?item)
""": """(probabilistic 0.5 (and (not (free ?robot)) (not (on ?item ?furniture)) (holding ?robot ?item)))
""",
}
"""A door may stick, or be locked; a grasp may fail."""
HOUSE = """
(define (problem p) (:domain household)
  (:objects robot - robot dining trash closet - room hall_dining_trash hall_closet_dining hall_closet_trash - hallway
    dumpster charger - furniture)
  (:init
    (at robot dining) (came_from robot dining) (free robot) (charger charger) (open dumpster) (open charger)
    (belongs_to dining dining) (belongs_to trash trash) (belongs_to closet closet)
    (belongs_to dumpster trash) (belongs_to charger closet)
    (joins hall_dining_trash dining trash) (joins hall_dining_trash trash dining)
    (belongs_to hall_dining_trash dining) (belongs_to hall_dining_trash trash)
    (joins hall_closet_dining closet dining) (joins hall_closet_dining dining closet)
    (belongs_to hall_closet_dining closet) (belongs_to hall_closet_dining dining)
    (joins hall_closet_trash closet trash) (joins hall_closet_trash trash closet)
    (belongs_to hall_closet_trash closet) (belongs_to hall_closet_trash trash)
    {}
    (= (battery robot) {}) (= (navigation_use) 5) (= (grasp_use) 10) (= (door_use) 10) (= (reserve) 20) (= (reserve_behind_doors) 90))
  (:goal {}))
"""


def household(battery: int, is_open: str, goal: str) -> Problem:
    text = (ROOT / "domains" / "household" / "domain.pddl").read_text().replace(":adl", ":adl :probabilistic-effects")
    for certain, declared in OUTCOMES.items():
        assert certain in text
        text = text.replace(certain, declared)
    return parse_problem(HOUSE.format(is_open, battery, goal), parse_domain(text))


def found(problem: Problem) -> Policy:
    *_, best = policies(problem, 60.0)
    return best


CHARGED = "(and (at robot dumpster) (>= (battery robot) 20))"


def test_entries_name_what_derived_facts_follow_from() -> None:
    policy = found(problem := household(40, "(open hall_closet_dining)", CHARGED))
    assert policy.is_proved
    assert not {fluent[0] for entry in policy.entries for fluent in entry.facts} & problem.domain.rules.derived
    entries, initial = list(policy.entries), initial_knowledge(problem)
    number, door = next(
        (number, fluent)
        for number, entry in enumerate(entries)
        if entry.action == "charge"
        for fluent, value in entry.facts.items()
        if fluent[0] == "open" and value
    )
    entries[number] = entries[number]._replace(facts={**entries[number].facts, door: False})
    assert "(reachable robot closet)" in unproved(problem, entries, initial)


def test_the_robot_charges_before_the_door_that_may_not_open() -> None:
    problem = household(40, "", CHARGED)
    assert found(problem).chance == pytest.approx(1.0 - 0.4**3)  # three attempts at the door to the charger
    for seed in range(2):
        result = achieve(None, problem, faults=Faults(seed=seed), settings=Settings(improve=30.0))
        calls = [call.call.action for call in result.calls]
        doors = [action.arguments[1] for action in calls if action.name == "open_hallway"]
        assert set(doors[: doors.index("hall_closet_trash")] if "hall_closet_trash" in doors else doors) == {"hall_closet_dining"}
        assert result.goal_reached


def test_numbers_in_rules_are_too_much() -> None:
    domain = (
        (ROOT / "domains" / "household" / "domain.pddl")
        .read_text()
        .replace("(charger ?charger) (bel", "(charger ?charger) (> (battery ?robot) 1) (bel")
    )
    with pytest.raises(Unsuitable, match="derived facts about numbers that change"):
        found(parse_problem(HOUSE.format("", 40, CHARGED), parse_domain(domain)))
