"""Decimals become whole numbers for the planner, wherever that changes nothing about the plans."""

from __future__ import annotations

from fractions import Fraction

import pytest
from hypothesis import given, strategies as st

from planner_bridge.model.plan import PlanningStatus
from planner_bridge.model.problem import Problem
from planner_bridge.pddl.reader import parse_domain, parse_problem
from planner_bridge.planning.normal_form import calculates_with_whole_numbers, in_whole_numbers
from planner_bridge.planning.solve import solve

ADD = "(:action add :parameters () :effect (increase (a) 0.1))"
BUY = "(:action buy :parameters () :precondition (>= (a) 0.25) :effect (and (p) (decrease (a) 0.25) (increase (total-cost) 0.5)))"
LASTING = "(:durative-action add :parameters () :duration (= ?duration {}) :effect (at end (increase (a) 0.5)))"


def counting(goal: str, init: str, actions: str) -> Problem:
    """A problem about the number a."""
    facts = " ".join(f"(q{number})" for number in range(4))
    domain = parse_domain(f"""(define (domain counting) (:requirements :adl :numeric-fluents :durative-actions)
      (:predicates (p) {facts}) (:functions (a) (total-cost)) {actions})""")
    return parse_problem(f"(define (problem x) (:domain counting) (:init {init}) (:goal {goal}))", domain)


@pytest.mark.parametrize(
    ("goal", "init", "actions", "whole"),
    [
        ("(p)", "(= (a) 0.5) (= (total-cost) 0)", BUY, True),
        ("(= (a) 1.6)", "(= (a) 0.1)", "(:action double :parameters () :effect (scale-up (a) 2))", True),
        ("(= (a) 0.5)", "(= (a) 1)", "(:action halve :parameters () :effect (scale-down (a) 2))", False),
        ("(= (a) 0.25)", "(= (a) 0.5)", "(:action square :parameters () :effect (assign (a) (* (a) (a))))", False),
        ("(= (a) 1)", "(= (a) 0.3333333)", ADD, False),
        ("(= (a) 1)", "(= (a) 0)", LASTING.format("(a)"), False),
        ("(p)", "(= (a) 0)", LASTING.format("2") + BUY, True),
        ("(= (a) 1)", "(= (a) 0.3)", "(:action add :parameters () :effect (increase (a) (* 0.5 (a))))", False),
    ],
)
def test_what_can_be_whole(goal: str, init: str, actions: str, whole: bool) -> None:
    problem = counting(goal, init, actions)
    assert not calculates_with_whole_numbers(problem)
    assert calculates_with_whole_numbers(in_whole_numbers(problem)) is whole
    assert whole or in_whole_numbers(problem) is problem


def test_whole_numbers_stay_as_they_are() -> None:
    problem = counting("(= (a) 3)", "(= (a) 0)", ADD.replace("0.1", "1"))
    assert in_whole_numbers(problem) is problem


TENTHS = st.integers(-12, 12).map(lambda number: Fraction(number, 10))
CHANGES = st.lists(st.tuples(st.sampled_from(["increase", "decrease", "assign"]), TENTHS), min_size=1, max_size=4)


@given(first=TENTHS, changes=CHANGES, relation=st.sampled_from(["=", ">", ">=", "<", "<="]), wanted=TENTHS)
def test_a_plan_is_found_whenever_exact_fractions_have_one(
    first: Fraction, changes: list[tuple[str, Fraction]], relation: str, wanted: Fraction
) -> None:
    actions = "".join(
        f"(:action x{number} :parameters () :precondition (q{number}) :effect (and (not (q{number})) ({operation} (a) {float(by)})))"
        for number, (operation, by) in enumerate(changes)
    )
    once = " ".join(f"(q{number})" for number in range(len(changes)))
    problem = counting(f"({relation} (a) {float(wanted)})", f"{once} (= (a) {float(first)})", actions)
    reached, waiting = set[tuple[Fraction, frozenset[int]]](), [(first, frozenset(range(len(changes))))]
    while waiting:
        value, left = state = waiting.pop()
        if state not in reached:
            reached.add(state)
            for number in left:
                operation, by = changes[number]
                after = {"increase": value + by, "decrease": value - by, "assign": by}[operation]
                waiting.append((after, left - {number}))
    holds = {"=": Fraction.__eq__, ">": Fraction.__gt__, ">=": Fraction.__ge__, "<": Fraction.__lt__, "<=": Fraction.__le__}[relation]
    found = solve(problem)
    if any(holds(value, wanted) for value, _ in reached):
        assert found.plan is not None, found
    else:
        assert found.status is PlanningStatus.UNSOLVABLE, found
