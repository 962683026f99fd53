"""Our problems in unified-planning mean there what they mean here; its simulator is the judge."""

from __future__ import annotations

import unified_planning.shortcuts as up
from hypothesis import given, settings
from hypothesis import strategies as st

from planner_bridge.model import ActionSchema, Declaration, Domain, Problem
from planner_bridge.up.problems import to_unified_planning
from pnm.conditions import TRUE, All, Any, Compare, Condition, Exists, ForAll, Holds, Implies, Not, evaluate
from pnm.effects import Effect, ForEach, Set, When, changes
from pnm.expressions import Constant, Fluent, Value, Variable
from pnm.knowledge import KnowledgeBase

THINGS = ("a", "b")
X, Y = Variable("?x", ("thing",)), Variable("?y", ("thing",))
FACTS: tuple[Fluent, ...] = (*((name, thing) for name in "pq" for thing in THINGS), ("r",))


def facts(scope: tuple[Variable, ...]) -> st.SearchStrategy[Fluent]:
    terms = st.sampled_from((*THINGS, *(variable.name for variable in scope)))
    return st.one_of(st.just(("r",)), st.tuples(st.sampled_from("pq"), terms))


def conditions(scope: tuple[Variable, ...], depth: int = 2) -> st.SearchStrategy[Condition]:
    terms = st.sampled_from((*THINGS, *(variable.name for variable in scope))).map(Constant)
    leaf = st.one_of(st.builds(Holds, facts(scope)), st.builds(lambda one, other: Compare("=", one, other), terms, terms))
    if not depth:
        return leaf
    inner = conditions(scope, depth - 1)
    quantified = [
        st.builds(lambda body, kind=kind, variable=variable: kind((variable,), body), conditions((*scope, variable), depth - 1))
        for kind in (ForAll, Exists)
        for variable in (X, Y)
    ]
    many = st.lists(inner, max_size=2).map(tuple)
    return st.one_of(leaf, inner.map(Not), many.map(All), many.map(Any), st.builds(Implies, inner, inner), *quantified)


def effects(scope: tuple[Variable, ...] = (), depth: int = 2) -> st.SearchStrategy[tuple[Effect, ...]]:
    one: list[st.SearchStrategy[Effect]] = [st.builds(lambda fact, value: Set(fact, Constant(value)), facts(scope), st.booleans())]
    if depth:
        one.append(st.builds(When, conditions(scope, 1), effects(scope, depth - 1)))
        one += [st.builds(ForEach, st.just((variable,)), effects((*scope, variable), depth - 1)) for variable in (X, Y)]
    return st.lists(st.one_of(one), min_size=1, max_size=3).map(tuple)


def problem(schema: ActionSchema, init: dict[Fluent, Value], goal: Condition = TRUE) -> Problem:
    declared = {name: Declaration(name, (X,)) for name in "pq"} | {"r": Declaration("r")}
    domain = Domain("d", types={"thing": ("object",)}, predicates=declared, actions={schema.name: schema})
    return Problem("d", domain, dict.fromkeys(THINGS, ("thing",)), init, goal=goal)


@settings(max_examples=60, deadline=None)
@given(effects(), st.sets(st.sampled_from(FACTS)))
def test_effects_do_there_what_they_do_here(done: tuple[Effect, ...], true: set[Fluent]) -> None:
    here = problem(ActionSchema("act", end_effects=done), dict.fromkeys(true, True))
    knowledge = KnowledgeBase(here.init, objects=here.objects_by_type)
    expected = {fact: fact in true for fact in FACTS} | changes(done, knowledge)
    there = to_unified_planning(here)
    with up.SequentialSimulator(there) as simulator:
        after = simulator.apply(simulator.get_initial_state(), there.action("act"))
        assert after is not None
        found = {fact: after.get_value(there.fluent(fact[0])(*map(there.object, fact[1:]))).bool_constant_value() for fact in FACTS}
    assert found == expected


@settings(max_examples=60, deadline=None)
@given(conditions((), 3), st.sets(st.sampled_from(FACTS)))
def test_conditions_hold_there_where_they_hold_here(goal: Condition, true: set[Fluent]) -> None:
    here = problem(ActionSchema("act"), dict.fromkeys(true, True), goal)
    knowledge = KnowledgeBase(here.init, objects=here.objects_by_type)
    there = to_unified_planning(here)
    with up.SequentialSimulator(there) as simulator:
        assert simulator.is_goal(simulator.get_initial_state()) == evaluate(goal, knowledge)
