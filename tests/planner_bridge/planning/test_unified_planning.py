"""Our problems in unified-planning mean there what they mean here; as its simulator shows."""

from __future__ import annotations

from dataclasses import replace
from typing import Any as Anything

import pytest
import unified_planning.shortcuts as up
from hypothesis import given, strategies as st

from planner_bridge.model.problem import Domain, Problem
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.planning.solve import solve
from planner_bridge.planning.unified_planning.problems import to_unified_planning
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import TRUE, All, Any, Compare, Condition, Exists, ForAll, Holds, Implies, Not, evaluate
from pnm.core.logic.domain import ActionSchema, Declaration, Preference
from pnm.core.logic.effects import Effect, ForEach, Set, When, changes
from pnm.core.logic.expressions import Constant, Fluent, Value, ValueOf, Variable
from pnm.core.logic.trajectory import Constraint
from pnm.errors import InputError

THINGS = ("a", "b")
X, Y = Variable("?x", ("thing",)), Variable("?y", ("thing",))
FACTS: tuple[Fluent, ...] = (*((name, thing) for name in "pq" for thing in THINGS), ("r",))


def facts(scope: tuple[Variable, ...]) -> st.SearchStrategy[Fluent]:
    terms = st.sampled_from((*THINGS, *(variable.name for variable in scope)))
    return st.one_of(st.just(("r",)), st.tuples(st.sampled_from("pq"), terms))


def conditions_over(scope: tuple[Variable, ...], depth: int = 2) -> st.SearchStrategy[Condition]:
    terms = st.sampled_from((*THINGS, *(variable.name for variable in scope))).map(Constant)
    leaf = st.one_of(st.builds(Holds, facts(scope)), st.builds(lambda one, other: Compare("=", one, other), terms, terms))
    if not depth:
        return leaf
    inner = conditions_over(scope, depth - 1)
    quantified = [
        st.builds(lambda body, kind=kind, variable=variable: kind((variable,), body), conditions_over((*scope, variable), depth - 1))
        for kind in (ForAll, Exists)
        for variable in (X, Y)
    ]
    many = st.lists(inner, max_size=2).map(tuple)
    return st.one_of(leaf, inner.map(Not), many.map(All), many.map(Any), st.builds(Implies, inner, inner), *quantified)


def effects_over(scope: tuple[Variable, ...] = (), depth: int = 2) -> st.SearchStrategy[tuple[Effect, ...]]:
    one: list[st.SearchStrategy[Effect]] = [st.builds(lambda fact, value: Set(fact, Constant(value)), facts(scope), st.booleans())]
    if depth:
        one.append(st.builds(When, conditions_over(scope, 1), effects_over(scope, depth - 1)))
        one += [st.builds(ForEach, st.just((variable,)), effects_over((*scope, variable), depth - 1)) for variable in (X, Y)]
    return st.lists(st.one_of(one), min_size=1, max_size=3).map(tuple)


def problem_with_action(schema: ActionSchema, init: dict[Fluent, Value], goal: Condition = TRUE) -> Problem:
    declared = {name: Declaration(name, (X,)) for name in "pq"} | {"r": Declaration("r")}
    domain = Domain("d", types={"thing": ("object",)}, predicates=declared, actions={schema.name: schema})
    return Problem("d", domain, dict.fromkeys(THINGS, ("thing",)), init, goal=goal)


@given(effects_over(), st.sets(st.sampled_from(FACTS)))
def test_effects_do_there_what_they_do_here(done: tuple[Effect, ...], true: set[Fluent]) -> None:
    here = problem_with_action(ActionSchema("act", end_effects=done), dict.fromkeys(true, True))
    knowledge = KnowledgeBase(here.init, objects=here.objects_by_type)
    expected = {fact: fact in true for fact in FACTS} | changes(done, knowledge)
    there = to_unified_planning(here)
    with up.SequentialSimulator(there) as simulator:
        after = simulator.apply(simulator.get_initial_state(), there.action("act"))
        assert after is not None
        found = {fact: after.get_value(there.fluent(fact[0])(*map(there.object, fact[1:]))).bool_constant_value() for fact in FACTS}
    assert found == expected


@given(conditions_over((), 3), st.sets(st.sampled_from(FACTS)))
def test_conditions_hold_there_where_they_hold_here(goal: Condition, true: set[Fluent]) -> None:
    here = problem_with_action(ActionSchema("act"), dict.fromkeys(true, True), goal)
    knowledge = KnowledgeBase(here.init, objects=here.objects_by_type)
    there = to_unified_planning(here)
    with up.SequentialSimulator(there) as simulator:
        assert simulator.is_goal(simulator.get_initial_state()) == evaluate(goal, knowledge)


# --- what is said in other words -----------------------------------------------------------


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
    room, robot = Variable("?b", ("room",)), Variable("?r", ("robot",))
    move = ActionSchema(
        "move",
        (robot, room),
        precondition=Not(Compare("=", ValueOf(("in", "?r")), Constant("?b"))),
        end_effects=(Set(("in", "?r"), Constant("?b")),),
    )
    domain = Domain("d", types={"robot": (), "room": ()}, functions={"in": Declaration("in", (robot,), ("room",))}, actions={"move": move})
    things = {"r": ("robot",), "a": ("room",), "b": ("room",)}
    there = to_unified_planning(Problem("p", domain, things, {("in", "r"): "a"}, goal=Compare("=", ValueOf(("in", "r")), Constant("b"))))
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


def test_scaling_is_an_assignment_of_a_product() -> None:
    (burn,) = to_unified_planning(lamp(effect="(scale-up (used) 2)")).actions
    assert [str(one) for one in burn.effects[up.EndTiming()]] == ["lit(l) := false", "used := (used * 2)"]
