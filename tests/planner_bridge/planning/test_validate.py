"""What makes a plan valid, rule by rule; Kairos' validator gives the same verdicts unless said otherwise."""

from __future__ import annotations

from typing import Final

import pytest

from planner_bridge.model.plan import Plan, PlanStep
from planner_bridge.model.problem import Problem
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.planning.kairos import validate
from planner_bridge.planning.validate import InvalidPlan, trace, why_invalid
from tests.support.pddl.problems import rooms

RULES: Final = parse_domain("""
(define (domain rules)
  (:requirements :typing :adl :durative-actions :numeric-fluents :timed-initial-literals)
  (:types thing kind)
  (:predicates (p) (q) (r) (p-and-q) (px ?x - thing))
  (:derived (p-and-q) (and (p) (q)))
  (:functions (f) (g) (unset) (total-cost))
  (:action add :parameters () :effect (p))
  (:action delete :parameters () :effect (not (p)))
  (:action flip :parameters () :effect (and (not (p)) (p)))
  (:action look :parameters () :precondition (p) :effect (r))
  (:action either :parameters () :precondition (or (p) (q)) :effect (r))
  (:action add-q :parameters () :effect (q))
  (:action none :parameters () :precondition (not (exists (?x - thing) (px ?x))) :effect (r))
  (:action whole :parameters () :precondition (p-and-q) :effect (r))
  (:action mark :parameters (?x - thing) :effect (px ?x))
  (:action count :parameters () :effect (increase (f) 1))
  (:action uncount :parameters () :effect (decrease (f) 1))
  (:action double :parameters () :effect (scale-up (f) 2))
  (:action reset :parameters () :effect (assign (f) 0))
  (:action copy-if :parameters () :effect (when (p) (assign (g) (f))))
  (:action enough :parameters () :precondition (>= (f) 1) :effect (r))
  (:action spend :parameters () :effect (increase (unset) 1))
  (:action pay :parameters () :effect (increase (total-cost) 1))
  (:durative-action end-read :parameters () :duration (= ?duration 2) :condition (at end (p)) :effect (at end (r)))
  (:durative-action remember :parameters () :duration (= ?duration 2) :condition () :effect (when (at start (p)) (at end (r))))
  (:durative-action hold :parameters () :duration (= ?duration 2) :condition (over all (p)) :effect (at end (r)))
  (:durative-action hold-own :parameters () :duration (<= ?duration 2) :condition (over all (p))
    :effect (and (at start (p)) (at end (not (p)))))
  (:durative-action hold-last :parameters () :duration (<= ?duration 2) :condition (over all (r))
    :effect (and (at start (p)) (at end (not (p)))))
  (:durative-action add-late :parameters () :duration (= ?duration 2) :condition () :effect (at end (p)))
  (:durative-action by-f :parameters () :duration (= ?duration (f)) :condition () :effect (and (at start (increase (f) 1)) (at end (r))))
  (:durative-action between :parameters () :duration (and (>= ?duration 1) (<= ?duration 3)) :condition () :effect (at end (r)))
  (:durative-action burn :parameters () :duration (<= ?duration 9) :condition (at start (>= (f) ?duration))
    :effect (at end (decrease (f) ?duration))))
""")


def over_rules(init: str = "", goal: str = "(and)") -> Problem:
    numbers = " ".join(f"(= ({name}) {value})" for name, value in (("f", 1), ("g", 0)))
    text = f"(define (problem x) (:domain rules) (:objects a b - thing k - kind) (:init {numbers} {init}) (:goal {goal}))"
    return parse_problem(text, RULES)


def timed_plan(text: str) -> Plan:
    """``0 look; 1.5 hold 2; 2 mark(a)``: start, action and duration."""
    steps = []
    for part in filter(None, text.split("; ")):
        start, call, *duration = part.split()
        name, _, arguments = call.rstrip(")").partition("(")
        steps.append(PlanStep(name, tuple(filter(None, arguments.split(","))), float(start), float(duration[0]) if duration else 0.0))
    return Plan(tuple(steps), temporal=True)


WAY = "get in each other's way"
VERDICTS: Final = [
    # what is both deleted and added is added
    ("", "0 flip; 1 look", ""),
    # what one looks at, no other may change at the same time, not even to what it is
    ("(p)", "0 look; 0 delete", "step 1, look(), and step 2, delete(), get in each other's way at 0 s: both have to do with (p)"),
    ("(p)", "0 look; 0 add", WAY),
    # a millionth of a second apart is at the same time
    ("(p)", "0 look; 0.000001 delete", WAY),
    ("(p)", "0 look; 0.000003 delete", ""),
    ("(p)", "0.000003 look; 0 delete", "step 1, look(), cannot start at 3e-06 s: expected (p); observed (p) is false"),
    # what is done twice at the same time
    ("", "0 add; 0 add", ""),
    ("(p)", "0 delete; 0 delete", ""),
    ("", "0 add; 0 delete", WAY),
    ("", "0 flip; 0 add", WAY),
    ("", "0 count; 0 count; 0 uncount", ""),
    ("", "0 count; 0 double", WAY),
    ("", "0 double; 0 double", WAY),
    ("", "0 reset; 0 reset", WAY),
    ("", "0 count; 0 enough", WAY),
    ("", "0 count; 0 copy-if", WAY),
    # looked at is what decides
    ("(p)", "0 either; 0 add-q", ""),
    ("(q)", "0 either; 0 add", WAY),
    ("(p) (q)", "0 whole; 0 count", ""),
    (
        "(p) (q)",
        "0 whole; 1 delete; 2 whole",
        "step 3, whole(), cannot start at 2 s: expected (p-and-q); observed (p-and-q) is false for want of (p)",
    ),
    # what is decided at the start
    ("(p)", "0 remember 2; 1 delete", ""),
    # facts that change by themselves
    ("(at 2 (p))", "2 look", "what changes by itself and step 1, look(), get in each other's way"),
    ("(at 2 (p))", "2.001 look", ""),
    ("(at 2 (not (p)))", "2 add", WAY),
    ("(at 2 (p))", "2 add", ""),
    ("(at 2 (p))", "2 hold 2", ""),
    ("(p) (at 2 (not (p)))", "0 hold 2", ""),
    ("(p) (at 1 (not (p)))", "0 hold 2", "step 1, hold(), cannot go on at 1 s: expected (p); observed (p) is false"),
    # over all is between the start and the end
    ("", "0 hold 2; 0 add", ""),
    ("", "0 hold 2", "cannot go on at 0 s"),
    ("(p)", "0 hold 2; 0 delete", "cannot go on at 0 s"),
    ("(p)", "0 hold 2; 1 delete", "cannot go on at 1 s"),
    ("(p)", "0 hold 2; 2 delete", ""),
    ("", "0 hold-own 2", ""),
    ("", "0 hold-last 0", ""),
    # at end is before the effects of the end
    ("(p)", "0 end-read 2; 1 delete", "step 1, end-read(), cannot end at 2 s: expected (p); observed (p) is false"),
    ("", "0 end-read 2; 0.5 add", ""),
    ("", "0 end-read 2; 0 add-late 2", "each other's way at 2 s"),
    # a duration is compared with its bounds before the start
    ("", "0 by-f 1", ""),
    ("", "0 by-f 2", "step 1, by-f(), cannot take 2 s: expected (= ?duration (f)); observed a bound of 1"),
    ("", "0 count; 0 by-f 1", ""),
    ("", "0 between 0.998", "cannot take 0.998 s: expected (>= ?duration 1)"),
    ("", "0 between 3.001", ""),
    ("", "0 burn 1", ""),
    ("", "0 burn 2", "cannot start at 0 s: expected (>= (f) 2); observed (f) is 1"),
    # numbers without a value
    ("", "0 spend", "(unset) is changed at 0 s, but it has no value"),
    ("", "0 pay", ""),
    # steps that are no steps
    ("", "0 fly", "step 1, fly(), is no action of the domain"),
    ("", "0 mark", "step 1, mark(), has 0 arguments: expected 1"),
    ("", "0 mark(c)", "step 1, mark(c), has c for ?x - thing: there is no such object"),
    ("", "0 mark(k)", "step 1, mark(k), has k for ?x - thing: it is of another type"),
    ("", "-1 add", "step 1, add(), starts at -1 s and takes 0 s: expected times from 0 on"),
]


@pytest.mark.parametrize(("init", "steps", "reason"), VERDICTS, ids=[f"{init} {steps}" for init, steps, _ in VERDICTS])
def test_rules(init: str, steps: str, reason: str) -> None:
    ours, theirs = why_invalid(over_rules(init), timed_plan(steps)), validate(over_rules(init), timed_plan(steps))
    assert reason in ours
    assert bool(ours) is bool(reason) is bool(theirs), theirs


def test_what_an_exists_has_found_false_is_looked_at() -> None:
    """Kairos overlooks it."""
    steps = timed_plan("0 none; 0 mark(a)")
    assert WAY in why_invalid(over_rules(""), steps)
    assert validate(over_rules(""), steps) == ""


def test_a_number_without_a_value_does_no_harm_where_it_does_not_matter() -> None:
    """Kairos is stricter: it refuses the plan as soon as it looks at the number."""
    goal = over_rules("(p)", "(or (> (unset) 0) (p))")
    assert why_invalid(goal, timed_plan("")) == ""
    assert validate(goal, timed_plan("")) != ""


def test_steps_without_times_come_one_after_the_other() -> None:
    robots = rooms(goal="(at r1 c)")
    moves = PlanStep("move", ("r1", "a", "b")), PlanStep("move", ("r1", "b", "c"), start=1.0)
    assert why_invalid(robots, Plan(moves)) == ""
    assert why_invalid(robots, Plan(moves[1:])) == "step 1, move(r1, b, c), cannot start: expected (at r1 b); observed (at r1 b) is false"
    assert why_invalid(robots, Plan(moves[:1])).startswith("the goal does not hold at the end: expected (at r1 c)")


def test_an_invalid_plan_leads_nowhere() -> None:
    with pytest.raises(InvalidPlan, match="cannot start"):
        trace(over_rules(), timed_plan("0 look"))
