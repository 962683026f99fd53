"""What unified-planning has other words for than PDDL, or none; that our problems mean the same there is in `test_semantics`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any as Anything

import pytest
import unified_planning.shortcuts as up

from planner_bridge.model.problem import Problem
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.planning.solve import solve
from planner_bridge.planning.unified_planning import to_unified_planning
from pnm.core.logic.conditions import TRUE, Holds
from pnm.core.logic.domain import Preference
from pnm.core.logic.expressions import Variable
from pnm.core.logic.trajectory import Constraint
from pnm.errors import InputError


def apply(simulator: Anything, state: Anything, *calls: Anything) -> Anything:
    for call in calls:
        state = simulator.apply(state, call)
    return state


def problem_of(domain: str, things: str = "", init: str = "", goal: str = "(and)", more: str = "") -> Problem:
    text = f"(define (problem p) (:domain d) (:objects {things}) (:init {init}) (:goal {goal}) {more})"
    return parse_problem(text, parse_domain(f"(define (domain d) {domain})"))


def test_one_name_for_several_things_becomes_several_names() -> None:
    here = problem_of(
        """(:types room) (:predicates (room ?x - room)) (:functions (room))
        (:action room :parameters (?room - room) :precondition (>= (room) 1) :effect (and (room ?room) (decrease (room) 1)))""",
        "room - room",
        "(= (room) 1)",
        "(room room)",
    )
    found = solve(here, planner="aries", timeout=60)
    assert found.plan is not None, found.reason
    assert [str(step) for step in found.plan.steps] == ["room(room)"]


def test_what_may_be_of_one_type_or_another_is_guarded() -> None:
    here = problem_of(
        """(:types cup box robot - object) (:predicates (held ?x) (seen ?x - (either cup box)))
        (:action lift :parameters (?x - (either cup box)) :effect (held ?x))
        (:action look :effect (forall (?x - (either cup box)) (seen ?x)))""",
        "c - cup b - box r - robot",
        goal="(and (held c) (forall (?x - (either cup box)) (seen ?x)))",
    )
    there = to_unified_planning(here)
    with up.SequentialSimulator(there) as simulator:
        state = simulator.get_initial_state()
        lift = there.action("lift")
        assert [simulator.is_applicable(state, lift, [there.object(name)]) for name in "cbr"] == [True, True, False]
        assert simulator.is_goal(apply(simulator, state, there.action("look")(), lift(there.object("c"))))


def test_a_thing_of_two_types_is_both() -> None:
    here = problem_of(
        """(:types tool toy - object) (:predicates (used ?x) (loved ?x))
        (:action use :parameters (?x - tool) :effect (used ?x)) (:action love :parameters (?x - toy) :effect (loved ?x))""",
        "drum - (either tool toy) saw - tool",
    )
    there = to_unified_planning(here)
    with up.SequentialSimulator(there) as simulator:
        state = simulator.get_initial_state()
        for action, fit in (("use", [True, True]), ("love", [True, False])):
            things = (there.object(name) for name in ("drum", "saw"))
            assert [simulator.is_applicable(state, there.action(action), [thing]) for thing in things] == fit


def test_functions_may_have_objects_for_values() -> None:
    here = problem_of(
        """(:types robot room) (:functions (in ?r - robot) - room)
        (:action move :parameters (?r - robot ?b - room) :precondition (not (= (in ?r) ?b)) :effect (assign (in ?r) ?b))""",
        "r - robot a b - room",
        "(= (in r) a)",
        "(= (in r) b)",
    )
    there = to_unified_planning(here)
    with up.SequentialSimulator(there) as simulator:
        state = simulator.get_initial_state()
        calls = [there.action("move")(there.object("r"), there.object(name)) for name in "ab"]
        assert [simulator.is_applicable(state, call) for call in calls] == [False, True]
        assert simulator.is_goal(apply(simulator, state, calls[1]))


LAMP = """(:types lamp) (:predicates (lit ?l - lamp) (dark)) (:functions (power ?l - lamp) (used) (times))
    (:durative-action burn :parameters (?l - lamp) :duration {duration}
     :condition (and (at start (dark)) (over all (lit ?l)) (at end (not (dark))))
     :effect (and (at start (lit ?l)) (at end (not (lit ?l))) (at end (increase (times) 1)) (at end {effect})))"""


def lamp(duration: str = "(= ?duration 5)", effect: str = "(increase (used) ?duration)", more: str = "") -> Problem:
    init = "(dark) (= (used) 0) (= (times) 0) (= (power l) 3) (at 4 (not (dark)))"
    return problem_of(LAMP.format(duration=duration, effect=effect), "l - lamp", init, "(>= (used) 1)", more)


def test_actions_last_and_facts_change_by_themselves_there_as_here() -> None:
    there = to_unified_planning(lamp())
    (burn,) = there.actions
    start, end = up.StartTiming(), up.EndTiming()
    during = up.OpenTimeInterval(start, end)
    lit, dark, used = (there.fluent(name) for name in ("lit", "dark", "used"))
    assert burn.duration == up.FixedDuration(up.Int(5))
    assert burn.conditions == {up.TimePointInterval(start): [dark()], during: [lit(burn.l)], up.TimePointInterval(end): [up.Not(dark())]}
    assert {when: list(map(str, effects)) for when, effects in burn.effects.items()} == {
        start: ["lit(l) := true"],
        end: ["lit(l) := false", "used += 5"],
    }
    assert {timing: list(map(str, effects)) for timing, effects in there.timed_effects.items()} == {
        up.GlobalStartTiming(4): ["dark := false"]
    }
    assert used.type == up.IntType()
    assert not there.has_fluent("times"), "what nothing reads is left out"


def test_a_duration_may_be_an_interval() -> None:
    (burn,) = to_unified_planning(lamp("(and (>= ?duration 2) (<= ?duration (power ?l)))", "(increase (used) 1)")).actions
    assert str(burn.duration) == "[2, power(l)]"


@pytest.mark.parametrize(
    ("problem", "named"),
    [
        (lamp("(>= ?duration 2)", "(increase (used) 1)"), "the duration of burn, which has not one upper"),
        (lamp("(<= ?duration 2)"), "an effect that depends on a duration the planner chooses"),
        (replace(lamp(), constraints=(Constraint("within", (TRUE,), (5.0,)),)), "the constraint within"),
        (replace(lamp(), preferences=(Preference("p", TRUE),)), "preferences"),
        (replace(lamp(), network="(:htn)"), "task networks"),
        (lamp(more="(:metric minimize (+ (total-time) (used)))"), r"the use of \(total-time\)"),
    ],
)
def test_what_unified_planning_cannot_say_is_named(problem: Problem, named: str) -> None:
    with pytest.raises(InputError, match=named):
        to_unified_planning(problem)


@pytest.mark.parametrize(
    ("metric", "there"),
    [
        ("minimize (times)", "minimize actions-cost: {'burn': 1, 'default': None}"),
        ("minimize (total-time)", "minimize makespan"),
        ("minimize (used)", "minimize used"),
        ("maximize (+ (used) (power l))", "maximize (used + power(l))"),
    ],
)
def test_metrics(metric: str, there: str) -> None:
    assert [str(one) for one in to_unified_planning(lamp(more=f"(:metric {metric})")).quality_metrics] == [there]


def test_constraints_hold_for_every_choice_of_objects() -> None:
    constraint = Constraint("always", (Holds(("lit", "?l")),), variables=(Variable("?l", ("lamp",)),))
    assert [str(one) for one in to_unified_planning(replace(lamp(), constraints=(constraint,))).trajectory_constraints] == [
        "Always(lit(l))"
    ]


@pytest.mark.parametrize(("power", "kind"), [("3", up.IntType()), ("2.5", up.RealType())])
def test_numbers_are_whole_if_all_are(power: str, kind: Anything) -> None:
    burning = lamp("(= ?duration (power ?l))")
    assert to_unified_planning(replace(burning, init={**burning.init, ("power", "l"): float(power)})).fluent("used").type == kind
