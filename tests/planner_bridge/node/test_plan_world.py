"""A node that has plans only: what others may ask of their world, and tell."""

from __future__ import annotations

import math
import re

import pytest

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.world import names_of_world
from planner_bridge.node.problem_service import NOTHING, ServedProblem
from pnm.errors import InputError
from pnm.language.plan import parse_plans
from tests.support.runs.simulated import in_virtual_time
from tests.support.tasks.world import PROBLEM, served

UNDECLARED = """
actions:
  move:
    params: ?r ?to
    preconditions:
      at_start:
        - (free ?r)
        - Comparison: [gt, ["(battery ?r)", 5]]
    effects:
      at_end:
        - (at ?r ?to)
        - assign: ["(place ?r)", "?to"]
tour:
  facts:
    - (at r1 hall)
    - (= (speed) 2)
    - (= (place r1) hall)
  goal: {not: (lost r1)}
  plan:
    - if: (rainy)
      then: [{move: {r: r1, to: hall}}]
    - move: {r: r1, to: kitchen}
"""
DECLARED = """
types: robot room - object
predicates:
  - (at ?r - robot ?x - room)
  - (open)
  - (ready ?r - robot)
functions:
  - (battery ?r - robot) - number
  - (place ?r - robot) - room
derived:
  - fact: (ready ?r - robot)
    condition: {and: [(open), "(at ?r hall)"]}
actions:
  move: {params: "?r - robot ?to - room"}
problem:
  objects: r1 r2 - robot hall kitchen - room
  init:
    - (at r1 hall)
plan:
  - move: {r: r1, to: kitchen}
"""


def node_of(text: str) -> ServedProblem:
    plans = parse_plans(text).values()
    return served(initial_knowledge(*plans), NOTHING, plans=plans)


async def node_answers(world: ServedProblem, *questions: str) -> list[str]:
    return [answer for _, answer in await world.query(questions)]


@in_virtual_time
async def test_facts_of_plans_that_declare_nothing_are_asked_for_and_told() -> None:
    world = node_of(UNDECLARED)
    conditions = ("(and (free r1) (not (lost r1)) (not (rainy)))", "(>= (speed) 2)")
    asked = ("(at r1 hall)", "(at r1 cellar)", "(speed)", "(place r1)", "(battery r1)", *conditions)
    assert await node_answers(world, *asked) == ["true", "false", "2", "hall", "unknown", "false", "true"]
    told = ["(at r1 cellar)", "(= (battery r1) 7)", "(= (place r1) cellar)", "(lost r1)"]
    assert await world.update(told, ["(at r1 hall)"], ["(speed)"]) == 6
    assert await node_answers(world, *asked) == ["false", "true", "unknown", "cellar", "7", "false", "unknown"]
    assert dict(await world.query([]))["(at r1 cellar)"] == "true"


@pytest.mark.parametrize(
    ("text", "question", "said"),
    [
        (UNDECLARED, "(att r1 hall)", "questions[0]:1:2: unknown predicate 'att'; did you mean 'at'?"),
        (UNDECLARED, "(at r1)", "questions[0]:1:1: (at ?x0 - object ?x1 - object) takes 2 arguments, found 1"),
        (UNDECLARED, "(exists (?p) (at r1 ?p))", "the plans declare no objects; expected a condition without exists"),
        (DECLARED, "(at r1 hal)", "questions[0]:1:8: unknown object 'hal'; did you mean 'hall'?"),
        (DECLARED, "(at hall r1)", "questions[0]:1:5: 'hall' is of type room; expected robot"),
    ],
)
@in_virtual_time
async def test_what_plans_do_not_speak_of_is_refused(text: str, question: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        await node_of(text).query([question])
    assert str(caught.value).startswith(said)


@in_virtual_time
async def test_declarations_of_plans_count_as_those_of_a_problem_do() -> None:
    world = node_of(DECLARED)
    asked = ("(exists (?x - room) (at r1 ?x))", "(place r2)", "(battery r2)", "(ready r1)")
    assert await node_answers(world, *asked) == ["true", "undefined", "unknown", "false"]
    assert await world.update(["(open)", "(= (place r2) kitchen)"], [], []) == 2
    assert await node_answers(world, *asked) == ["true", "kitchen", "unknown", "true"]
    with pytest.raises(InputError, match="'ready' is a derived predicate"):
        await world.update(["(ready r2)"], [], [])
    with pytest.raises(InputError, match="no domain and problem are loaded"):
        await world.load("  ", "(define (problem p) (:domain plans) (:goal (open)))")


REPORTS = [
    (DECLARED, ("at", "r1", "hall"), True, ""),
    (DECLARED, ("at", "visitor", "hall"), True, ""),
    (DECLARED, ("place", "r1"), "hall", ""),
    (DECLARED, ("at", "hall", "r1"), True, "hall is a room; expected a robot"),
    (DECLARED, ("at", "r1"), True, "(at r1) has 1 arguments; expected 2"),
    (DECLARED, ("battery", "r1"), True, "(battery r1) is reported as a predicate"),
    (DECLARED, ("battery", "r1"), math.inf, "expected a finite number"),
    (DECLARED, ("ready", "r1"), True, "facts of ready follow from rules"),
    (DECLARED, ("flies", "r1"), True, "there is no predicate or function 'flies'"),
    (UNDECLARED, ("flies", "r1"), True, ""),
    (UNDECLARED, ("at", "r9", "cellar"), True, ""),
    (UNDECLARED, ("at", "r1"), True, "(at r1) has 1 arguments; expected 2"),
    (UNDECLARED, ("battery", "r1"), True, "(battery r1) is reported as a predicate"),
]


@pytest.mark.parametrize(("text", "fluent", "value", "said"), REPORTS)
def test_reports_are_checked_as_far_as_plans_declare_or_use_names(text, fluent, value, said) -> None:
    names = names_of_world(None, parse_plans(text).values())
    if said:
        with pytest.raises(InputError, match=re.escape(said)):
            names.check_report(fluent, value)
    else:
        names.check_report(fluent, value)


def test_beside_a_problem_its_names_are_those_that_count() -> None:
    names = names_of_world(PROBLEM, parse_plans(UNDECLARED).values())
    names.check_report(("rainy",), True)
    names.check_report(("lost", "anything"), True)
    for fluent, said in ((("charged", "anything"), "there is no object 'anything'"), (("flies", "r1"), "there is no predicate")):
        with pytest.raises(InputError, match=said):
            names.check_report(fluent, True)


def test_plans_that_declare_a_name_differently_leave_it_unchecked() -> None:
    other = DECLARED.replace("(battery ?r - robot) - number", "(battery) - number")
    names = names_of_world(None, (*parse_plans(DECLARED).values(), *parse_plans(other).values()))
    names.check_report(("battery", "r1"), 1.0)
    names.check_report(("battery",), 1.0)
