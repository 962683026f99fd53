"""Quantifiers over too many choices of objects: counted before anything ranges over them, and refused."""

from __future__ import annotations

import pytest

from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.pddl.reader import MAX_READ
from pnm.core.logic.conditions import choices_in
from pnm.errors import InputError

DOMAIN = """(define (domain d)
    (:requirements :adl :constraints :preferences :derived-predicates :durative-actions)
    (:types t u) (:predicates (p ?x ?y ?z - t) (q ?x - t) (done) (none))
    {section}
    (:action a :parameters (?w - t) :precondition (and (q ?w) {precondition}) :effect (and (done) {effect})))"""
PROBLEM = """(define (problem p) (:domain d)
    (:objects {objects} - t e - u) (:init)
    (:goal (and (done) {goal}))
    {constraints})"""
MANY = "(forall (?x ?y - t) (exists (?z - t ?v - u) (p ?x ?y ?z)))"


def problem(count: int, **parts: str):
    empty = dict.fromkeys(("section", "precondition", "effect", "goal", "constraints"), "")
    texts = {**empty, **parts, "objects": " ".join(f"o{number}" for number in range(count))}
    return parse_problem(PROBLEM.format(**texts), parse_domain(DOMAIN.format(**texts)))


CASES = {
    "the goal": {"goal": MANY},
    "a condition of a": {"precondition": f"(or (done) (not {MANY}))"},
    "the effects of a": {"effect": "(forall (?x - t) (forall (?y ?z - t) (when (q ?x) (p ?x ?y ?z))))"},
    "the rule of none": {"section": f"(:derived (none) {MANY})"},
    "(always ": {"constraints": f"(:constraints (always {MANY}))"},
    "(forall (?x - t ?y - t) (sometime ": {"section": "(:constraints (forall (?x ?y - t) (sometime (forall (?z - t) (p ?x ?y ?z)))))"},
    "(at end ": {"goal": f"(preference one {MANY})"},
    "(forall (?x - t) (at end ": {"goal": "(forall (?x - t) (preference one (forall (?y ?z - t) (p ?x ?y ?z))))"},
}


@pytest.mark.parametrize("what", CASES)
def test_quantifiers_over_too_many_choices_are_refused_where_the_objects_are_declared(what: str) -> None:
    assert MAX_READ < 60**3
    with pytest.raises(InputError) as caught:
        problem(60, **CASES[what])
    assert str(caught.value).startswith(f"problem.pddl:2:5: the quantifiers in {what}"), str(caught.value)
    assert f"over {2 * 60**3 if 'effects' in what else 60**3} choices of objects; expected {MAX_READ} at most" in str(caught.value)
    assert problem(20, **CASES[what]).name == "p"


def test_choices_are_counted_without_being_made() -> None:
    huge = "(and (forall (?x - t) (q ?x)) (exists (?x ?y - t) (or (p ?x ?y o1) (forall (?z - t) (p ?x ?y ?z)))) (q o1))"
    goal = problem(3, goal=huge).goal
    assert choices_in(goal, lambda _: 3) == 3 + 9 + 27
    assert choices_in(goal, lambda _: 10**9) == 10**9 + 10**18 + 10**27
    assert choices_in(goal, lambda _: 0) == 0
    assert choices_in(problem(3).goal, lambda _: 10**9) == 0
