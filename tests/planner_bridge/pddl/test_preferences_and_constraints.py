"""Preferences, trajectory constraints and task networks: kept as they are, and written so that they mean the same."""

from __future__ import annotations

import pytest

from planner_bridge.model.problem import Metric
from planner_bridge.pddl import parse_domain
from pnm.core.logic.conditions import TRUE
from pnm.core.logic.domain import Preference
from pnm.core.logic.expressions import Arithmetic, ValueOf
from tests.support.pddl.text import EXTENDED

domain_with, problem_with, action, durative = EXTENDED.domain_with, EXTENDED.problem_with, EXTENDED.action, EXTENDED.durative


def told(preference: Preference) -> str:
    """The name of a preference, its moment, its variables, and what is wanted."""
    wanted = preference.wanted if isinstance(preference.wanted, tuple) else (preference.wanted,)
    return " ".join(filter(None, (preference.name, preference.moment, *map(str, preference.variables), *map(str, wanted))))


@pytest.mark.parametrize(
    ("text", "hard", "soft"),
    [
        ("(preference p (idle))", "(and)", ["p (idle)"]),
        ("(preference (idle))", "(and)", ["(idle)"]),
        ("(and (busy) (and (preference p (idle)) (preference P (busy))))", "(busy)", ["p (idle)", "p (busy)"]),
        (
            "(and (idle) (forall (?l - room) (and (dirty ?l) (forall (?r - robot) (preference p (at ?r ?l))))))",
            "(and (idle) (forall (?l - room) (dirty ?l)))",
            ["p ?l - room ?r - robot (at ?r ?l)"],
        ),
        ("(forall (?l - room) (forall (?l - closet) (preference p (dirty ?l))))", "(and)", ["p ?l - room ?l - closet (dirty ?l)"]),
        ("(forall (?l - room) (and))", "(forall (?l - room) (and))", []),
        ("(and (or (idle) (busy)) (preference p (imply (idle) (busy))))", "(or (idle) (busy))", ["p (imply (idle) (busy))"]),
    ],
)
def test_preferences_are_told_apart_from_what_must_hold(text: str, hard: str, soft: list[str]) -> None:
    problem = problem_with(f"(:goal {text})")
    assert (str(problem.goal), [*map(told, problem.preferences)]) == (hard, soft)
    schema = action(f":precondition {text}")
    assert (str(schema.precondition), [*map(told, schema.preferences)]) == (hard, soft)


def test_preferences_of_durative_actions_have_a_moment() -> None:
    schema = durative(
        ":condition (and (at start (idle)) (preference p (at start (busy))) (at end (preference q (idle)))"
        " (over all (and (busy) (preference r (idle)))) (forall (?x - room) (and (at end (dirty ?x)) (preference (over all (dirty ?x))))))"
    )
    hard = "(idle)", "(busy)", "(forall (?x - room) (dirty ?x))"
    assert (str(schema.precondition), str(schema.invariant), str(schema.end_condition)) == hard
    soft = ["p at start (busy)", "q at end (idle)", "r over all (idle)", "over all ?x - room (dirty ?x)"]
    assert [*map(told, schema.preferences)] == soft


def test_a_metric_counts_preferences_wherever_they_are() -> None:
    problem = problem_with(
        "(:goal (preference Wish (idle))) (:constraints (preference c (always (idle))))"
        " (:metric minimize (+ (is-violated wish) (is-violated C) (is-violated care) (is-violated law) (total-time)))",
        "(:action a :precondition (preference care (idle))) (:constraints (preference law (sometime (busy))))",
    )
    counted = tuple(ValueOf(("is-violated", name)) for name in ("Wish", "c", "care", "law"))
    assert problem.metric == Metric("minimize", Arithmetic("+", (*counted, ValueOf(("total-time",)))))


def test_a_predicate_may_be_called_preference() -> None:
    domain = parse_domain("(define (domain d) (:predicates (preference ?x)) (:action a :parameters (?x) :precondition (preference ?x)))")
    assert str(domain.actions["a"].precondition) == "(preference ?x)"


@pytest.mark.parametrize("text", ["", "(:constraints)", "(:constraints ())", "(:constraints (and))"])
def test_there_may_be_no_constraints(text: str) -> None:
    assert problem_with(f"(:goal ()) {text}").constraints == ()


def test_constraints_hold_for_every_choice_and_may_be_wishes() -> None:
    domain = domain_with(
        "(:constraints (and (forall (?l - room) (and (always (dirty ?l)) (forall (?r - robot) (sometime (at ?r ?l)))))"
        " (forall (?l - room) (preference p (forall (?r - robot) (sometime (at ?r ?l)))))"
        " (preference q (and (always (idle)) (sometime (busy)))) (preference (within 3 (forall (?l - room) (dirty ?l))))))"
    )
    assert [*map(str, domain.constraints)] == [
        "(forall (?l - room) (always (dirty ?l)))",
        "(forall (?l - room ?r - robot) (sometime (at ?r ?l)))",
    ]
    assert [*map(told, domain.preferences)] == [
        "p ?l - room (forall (?r - robot) (sometime (at ?r ?l)))",
        "q (always (idle)) (sometime (busy))",
        "(within 3 (forall (?l - room) (dirty ?l)))",
    ]


TASK = "(:task deliver :parameters (?r - robot ?l - room))"
METHOD = "(:method m ; how (\n  :parameters (?r - robot ?l - room)\n  :task (deliver ?r ?l)\n  :ordered-subtasks (and (a ?r ?l)))"
NETWORK = "(:htn :parameters () :subtasks (and (t1 (deliver r2 hall))) :ordering ())"


def test_task_networks_are_kept_as_they_stand() -> None:
    domain = domain_with(f"{TASK} {METHOD} (:action a :parameters (?r - robot ?l - room) :effect (at ?r ?l))")
    assert domain.hierarchy == (TASK, METHOD)
    assert [*map(str, domain.actions["a"].end_effects)] == ["(at ?r ?l)"]
    problem = problem_with(f"{NETWORK} (:init (idle))")
    assert (problem.network, problem.goal) == (NETWORK, TRUE)
