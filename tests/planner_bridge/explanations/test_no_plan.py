"""Why there is no plan: where trees end, goals that exclude each other, and nothing called proved that is not.

A whole tree is in docs/guides/why.md.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

from planner_bridge.explanations.answer import Answer, Known
from planner_bridge.explanations.no_plan import AnswerLimit, why_no_plan
from planner_bridge.model.forbidden_actions import ForbiddenCall, forbid
from planner_bridge.model.plan import PlanningResult, PlanningStatus
from planner_bridge.model.problem import Problem
from planner_bridge.pddl import parse_domain, parse_problem
from tests.support.pddl.explanations.doors import house
from tests.support.pddl.problems import hard, rooms

GAVE_UP = PlanningResult(PlanningStatus.TIMED_OUT, message="after 1 s")


def why(problem: Problem) -> Answer:
    limit = AnswerLimit.of(30)
    found = limit.first_plan(problem)
    assert found.plan is None
    return why_no_plan(problem, found, limit)


def test_a_search_that_gave_up_proves_nothing() -> None:
    answer = why_no_plan(hard(), GAVE_UP, AnswerLimit.of(0.0))
    assert [(part.known, part.claims) for part in answer.every()] == [(Known.NOT_PROVED, ())]
    assert "time-out: after 1 s" in answer.statement


def test_goals_that_exclude_each_other_are_named_without_the_others() -> None:
    answer = why(house("(open door)", "(and (has r1 cup) (at r1 yard) (at r1 hall))"))
    assert (answer.statement, answer.known) == ("there is no plan", Known.SEARCH)
    (conflict,) = answer.reasons
    assert conflict.statement == "(at r1 yard) and (at r1 hall) exclude each other"
    assert [reason.known for reason in conflict.reasons] == [Known.PLAN, Known.PLAN]


def test_goals_of_which_it_is_not_known_whether_each_is_possible_are_not_said_to_exclude_each_other() -> None:
    problem = house("(open door)", "(and (at r1 yard) (at r1 hall))")
    found = PlanningResult(PlanningStatus.UNSOLVABLE)
    (conflict,) = why_no_plan(problem, found, AnswerLimit.of(0.0)).reasons
    assert conflict.statement == "(and (at r1 yard) (at r1 hall)) is impossible"
    assert {reason.known for reason in conflict.reasons} == {Known.NOT_PROVED}


def test_what_is_unknown_proves_nothing() -> None:
    problem = replace(house(), unknown=frozenset({("key", "r1", "door")}))
    answer = why(problem)
    assert "(key r1 door) is unknown, and counted as false" in answer.statement
    assert not any(part.known.is_certain or part.claims for part in answer.every())


def test_what_must_not_be_used_is_where_the_tree_ends() -> None:
    answer = why(forbid(rooms(ways="ab bc", goal="(at r1 c)"), frozenset({ForbiddenCall("move", ("r1", "b", "c"))})))
    assert [*answer.every()][-1].statement == "move(r1, b, c) must not be used any more"


def test_two_doors_are_both_named() -> None:
    text = str(why(rooms(ways="ab", goal="(at r1 c)")))
    assert "move(r1, a, c) would make it so, but needs (way a c)" in text
    assert "move(r1, b, c) would make it so, but needs (way b c)" in text
    assert "1 more way to it is closed as well" not in text.splitlines()[0]


CIRCLE = """(define (domain circle) (:requirements :adl :derived-predicates :numeric-fluents) (:predicates (p) (q) (both)) (:functions (n))
  (:derived (both) (and (p) (q)))
  (:action one :parameters () :precondition (q) :effect (p)) (:action two :parameters () :precondition (p) :effect (q))
  (:action go :parameters () :precondition (> (n) 2) :effect (p)))"""


@pytest.mark.parametrize(
    ("goal", "init", "last"),
    [
        ("(q)", "(= (n) 1)", "(> (n) 2) is false, and no action changes that"),
        ("(q)", "", "(n) has no value"),
        ("(both)", "(= (n) 1)", "(> (n) 2) is false, and no action changes that"),
    ],
)
def test_the_end_of_the_tree_is_what_is_missing(goal: str, init: str, last: str) -> None:
    problem = parse_problem(f"(define (problem x) (:domain circle) (:init {init}) (:goal {goal}))", parse_domain(CIRCLE))
    assert last in [part.statement for part in why(problem).every()]


def test_a_circle_is_called_one() -> None:
    domain = parse_domain(CIRCLE.replace("(:action go :parameters () :precondition (> (n) 2) :effect (p))", ""))
    answer = why(parse_problem("(define (problem x) (:domain circle) (:init) (:goal (p)))", domain))
    assert [*answer.every()][-1].statement == "(p) would be needed for itself"


def test_without_its_constraints_there_would_be_a_plan() -> None:
    text = "(define (problem x) (:domain circle) (:init) (:goal (q)) (:constraints (always (not (p)))))"
    answer = why(parse_problem(text, parse_domain(CIRCLE.replace(":adl", ":adl :constraints").replace("(> (n) 2)", "(and)"))))
    assert [reason.known for reason in answer.reasons] == [Known.PLAN]
    assert answer.reasons[0].statement.startswith("there is a plan without these constraints: (always (not (p)))")
