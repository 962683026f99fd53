"""Plans as text: read as planners print them, and refused where they name what the problem has not."""

from __future__ import annotations

import pytest

from planner_bridge.model.plan import plan_text, read_plan
from planner_bridge.pddl import parse_domain, parse_problem
from pnm.errors import InputError

DOMAIN = """(define (domain D) (:requirements :typing) (:types Truck place)
  (:predicates (At ?t - truck ?p - Place))
  (:action DRIVE-Truck :parameters (?t - Truck ?from ?to - place) :precondition (at ?t ?from) :effect (at ?t ?to)))"""
PROBLEM = "(define (problem P) (:domain d) (:objects T1 - truck Home depot - place) (:init (AT t1 home)) (:goal (at t1 DEPOT)))"


@pytest.mark.parametrize(
    "text", ["(drive-truck t1 home depot)", "0.0: (DRIVE-TRUCK T1 HOME DEPOT) [1]", "(DRIVE-Truck T1 Home depot) ; go"]
)
def test_capitals_do_not_count(text: str) -> None:
    plan = read_plan(text, parse_problem(PROBLEM, parse_domain(DOMAIN)))
    assert [(step.action, step.arguments) for step in plan.steps] == [("DRIVE-Truck", ("T1", "Home", "depot"))]
    assert plan_text(plan) == "(DRIVE-Truck T1 Home depot)\n"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("(drive-trucks t1 home depot)", "p:1:1: there is no action 'drive-trucks'; did you mean 'DRIVE-Truck'?"),
        ("\n (drive-truck t1 home t1)", "p:2:2: 't1' is no object for ?to of DRIVE-Truck; expected one of Home, depot"),
        ("(drive-truck t1 home)", "p:1:1: DRIVE-Truck takes 3 arguments (?t ?from ?to), found 2"),
    ],
)
def test_what_the_problem_has_not_is_refused_with_its_place(text: str, reason: str) -> None:
    with pytest.raises(InputError) as refused:
        read_plan(text, parse_problem(PROBLEM, parse_domain(DOMAIN)), "p")
    assert str(refused.value) == reason
