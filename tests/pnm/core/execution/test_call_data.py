"""Calls whose values come from knowledge, or are given before they begin: what is worked out is kept while knowledge is the same."""

from __future__ import annotations

from random import Random
from uuid import UUID

import pytest
from hypothesis import given, strategies as st

from pnm.core.execution.call_data import already_true, closed_call, denied_at_end, finished, intention, ready, unseen
from pnm.core.execution.call_requests import Calls
from pnm.core.execution.machine_index import index_of, prepare
from pnm.core.execution.questions import EvaluationContext
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.computed_values import Layer, Literal, Query
from pnm.core.logic.conditions import All, Compare, Condition, Holds, Not
from pnm.core.logic.effects import Effects, Set, names_written
from pnm.core.logic.expressions import UNKNOWN, Constant, ValueOf
from pnm.core.machine.bindings import DEFAULT, Bindings, goal_data
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import ActionCall, GroundAction, PlanGraph
from tests.support.benchmarks.workloads import checked, inline
from tests.support.runs.mutation.machines import random_plan, written_out

FLUENTS = [("at", "r1", "hall"), ("at", "r1", "kitchen"), ("free",), ("location", "r1"), ("battery",)]
VALUES = {"at": st.booleans(), "free": st.booleans(), "location": st.sampled_from(["hall", "undefined"]), "battery": st.just(5.0)}
CONSTANT = st.sampled_from(FLUENTS).flatmap(lambda fluent: VALUES[fluent[0]].map(lambda value: Set(fluent, Constant(value))))
OTHERS = st.just(Set(("battery",), Constant(1.0), "decrease"))
EFFECTS = st.lists(st.one_of(CONSTANT, CONSTANT, CONSTANT, OTHERS), max_size=3).map(tuple)
KNOWN = st.fixed_dictionaries({}, optional={fluent: st.one_of(VALUES[fluent[0]], st.just(UNKNOWN)) for fluent in FLUENTS})


@given(EFFECTS, EFFECTS, KNOWN, st.sets(st.sampled_from(sorted(VALUES))), st.sampled_from([None, 2.0]))
def test_what_is_constant_of_a_call(start: Effects, end: Effects, known: dict, sensed: set[str], duration: float | None) -> None:
    action = GroundAction("go", ("r1",), ("robot",), start_effects=start, end_effects=end, duration=duration)
    call = ActionCall(0, action, lasting=frozenset(FLUENTS[:2]))
    context = EvaluationContext(Layered(KnowledgeBase(known, sensed=dict.fromkeys(sensed, 1.0))), action)
    closed = closed_call(call)
    assert closed is not None
    assert (dict(closed.own), ()) == goal_data(action, DEFAULT, None, context)
    assert context.world.senses(names_written((*start, *end))) is all(context.world.is_sensed((name,)) for name in closed.names)
    if closed.effects is None:
        assert any(effect.operation != "assign" for effect in (*start, *end))
        return
    intended = closed.effects.intended(context.world)
    assert intended == intention(call, context)
    assert intended.end == finished(action, intended, context)
    assert closed.effects.are_done(context.world) == already_true(action, context)
    assert closed.expects or intended.expected or not unseen(intended.expected, action, context)


NEEDS = st.recursive(
    st.sampled_from([Holds(fluent) for fluent in FLUENTS[:3]] + [Compare(">", ValueOf(("battery",)), Constant(1.0))]),
    lambda inner: st.one_of(inner.map(Not), st.lists(inner, max_size=3).map(lambda parts: All(tuple(parts)))),
    max_leaves=4,
)


@given(NEEDS, NEEDS, KNOWN)
def test_what_a_call_needs_until_its_end_is_what_may_be_denied_there(over_all: Condition, at_end: Condition, known: dict) -> None:
    action = GroundAction("go", invariant=over_all, end_condition=at_end)
    closed, context = closed_call(ActionCall(0, action)), EvaluationContext(Layered(KnowledgeBase(known)), action)
    assert closed is not None
    holds = closed.needed is None or closed.needed.holds_by_facts(context.world)
    assert holds is not bool(denied_at_end(action, context))  # without sensors nothing is excused


def test_nothing_of_its_calls_is_worked_out_while_it_is_executed() -> None:
    plan, known = checked(5)
    machine = generate(plan)
    prepare(machine)
    index = index_of(machine)
    made = [len(table) for table in (index.closed, index.guards, index.conditions)]
    inline(Run(machine, Layered(KnowledgeBase(known)), id=UUID(int=1)))
    assert made == [5, 10, 10]
    assert [len(index.closed), len(index.guards), len(index.conditions)] == [5, 11, 11], "only the goal is asked for besides"


@pytest.mark.parametrize("number", range(40))
def test_any_machine_can_be_prepared(number: int) -> None:
    machine = generate(random_plan(Random(number)))
    prepare(machine if number % 2 else written_out(machine))


GIVEN = (("speed", Query(Literal.of("pace"), Layer.LOCAL)),)
GO = GroundAction(
    "go", ("?to",), ("to",), precondition=Holds(("open", "?to")), end_effects=(Set(("at", "?to"), Constant(True)),), given=GIVEN
)
STORED = st.sampled_from([None, 1, True, 1.0, "1", "hall", [1], [True]])
CHANGES = st.lists(st.tuples(st.sampled_from(["to", "pace", "other"]), st.booleans(), STORED), max_size=8)


def shown(values: object) -> str:
    return repr(values)  # unlike ==, it tells 1, 1.0 and true apart


@given(CHANGES)
def test_an_action_is_ready_with_what_is_known_now(changes: list[tuple[str, bool, object]]) -> None:
    known = Layered(KnowledgeBase(), KnowledgeBase())
    calls = Calls(UUID(int=1), generate(PlanGraph((ActionCall(0, GO),))), known, Bindings(), lambda action: None, asks=False)
    for name, is_local, value in changes:
        (known.local if is_local else known.world).store({name: value})
        kept, fresh = calls.context_of(0, None), EvaluationContext(known, GO)
        assert shown(kept.environment()) == shown(fresh.environment())
        assert shown(kept.given()) == shown(fresh.given())
        made = ready(GO, kept)
        assert shown(made) == shown(ready(GO, fresh))
        assert ready(GO, kept) is made, "it is made anew although nothing has changed"
