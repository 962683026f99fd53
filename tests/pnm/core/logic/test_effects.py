"""Effects: all at once, deletes before adds, and what they may do."""

from __future__ import annotations

import random
from collections.abc import Iterator
from itertools import permutations

import pytest
from hypothesis import given, strategies as st

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import TRUE, Holds, Not, evaluate
from pnm.core.logic.effects import (
    OPERATIONS,
    Changes,
    Effect,
    Effects,
    ForEach,
    Set,
    When,
    assignments,
    changes,
    effects_text,
    every_effect,
    facts,
    ground_effects,
    names_written,
    possible_assignments,
    read,
    written,
)
from pnm.core.logic.expressions import UNKNOWN, Constant, Environment, Fluent, Unknown, Value, ValueOf, Variable, bind
from tests.support.logic.effects import (
    ALL_FACTS,
    ALL_NUMBERS,
    EFFECTS,
    FIGURES,
    PLAIN,
    ROOMS,
    STATES,
    TRUTHS,
    add,
    change_number,
    delete,
    rooms_state,
)

# --- simultaneous ---


@pytest.mark.parametrize("before", [True, False, UNKNOWN])
@pytest.mark.parametrize("effects", list(permutations([add("p"), delete("p"), delete("q")])))
def test_a_fact_both_deleted_and_added_is_added(effects: Effects, before: Value | Unknown) -> None:
    assert changes(effects, rooms_state({("p",): before, ("q",): before})) == {("p",): True, ("q",): False}


def test_two_numbers_swap() -> None:
    swap = (Set(("x",), ValueOf(("y",))), Set(("y",), ValueOf(("x",))))
    assert changes(swap, rooms_state({("x",): 1.0, ("y",): 2.0})) == {("x",): 2.0, ("y",): 1.0}


def test_conditions_are_asked_before_anything_changes() -> None:
    toggle = (When(Holds(("on",)), (delete("on"),)), When(Not(Holds(("on",))), (add("on"),)))
    assert changes(toggle, rooms_state({("on",): True})) == {("on",): False}
    assert changes(toggle, rooms_state()) == {("on",): True}
    assert changes(toggle, rooms_state({("on",): UNKNOWN})) == {}


def test_universal_effects_happen_for_every_object() -> None:
    room = Variable("?room", ("room",))
    clean = ForEach((room,), (When(Holds(("dirty", "?room")), (delete("dirty", "?room"), add("clean", "?room"))),))
    assert changes((clean,), rooms_state({("dirty", "hall"): True})) == {("dirty", "hall"): False, ("clean", "hall"): True}
    assert changes((ForEach((room,), (add("seen", "?by", "?room"),)),), rooms_state(), {"?by": "r1", "?room": "elsewhere"}) == {
        ("seen", "r1", "hall"): True,
        ("seen", "r1", "kitchen"): True,
    }


@pytest.mark.parametrize(
    ("operation", "by", "after"),
    [
        ("assign", 2.0, 2.0),
        ("increase", 2.0, 10.0),
        ("decrease", 2.0, 6.0),
        ("scale-up", 2.0, 16.0),
        ("scale-down", 2.0, 4.0),
        ("scale-down", 0.0, UNKNOWN),
        ("increase", UNKNOWN, UNKNOWN),
        ("assign", UNKNOWN, UNKNOWN),
    ],
)
def test_numeric_effects(operation: str, by: float | Unknown, after: float | Unknown) -> None:
    effect = change_number(operation, "x", ValueOf(("by",)))
    assert changes((effect,), rooms_state({("x",): 8.0, ("by",): by})) == {("x",): after}


@pytest.mark.parametrize("before", [None, UNKNOWN, True, False, "hall"])
def test_what_is_no_number_cannot_be_increased(before: Value | Unknown | None) -> None:
    knowledge = rooms_state({} if before is None else {("x",): before})
    assert changes((change_number("increase", "x", 1.0),), knowledge) == {("x",): UNKNOWN}


def test_whole_numbers_are_numbers() -> None:
    assert changes((change_number("increase", "x", 1.0),), rooms_state({("x",): 3})) == {("x",): 4.0}


def test_increases_accumulate() -> None:
    both = (change_number("increase", "x", 1.0), change_number("decrease", "x", ValueOf(("x",))), change_number("increase", "x", 5.0))
    assert changes(both, rooms_state({("x",): 3.0})) == {("x",): 6.0}


NESTED_FACTS = st.builds(Set, st.sampled_from((("p",), ("at", "?x"), ("at", "hall"))), st.builds(Constant, st.booleans()))
NESTED_NUMBERS = st.builds(
    Set, st.sampled_from((("n",), ("m",))), st.builds(Constant, st.sampled_from((1.0, 2.0, 4.0))), st.sampled_from(("increase", "decrease"))
)
NESTED = st.recursive(
    st.one_of(NESTED_FACTS, NESTED_NUMBERS),
    lambda inner: st.one_of(
        st.builds(When, st.sampled_from((TRUE, Holds(("p",)), Not(Holds(("at", "?x"))))), st.lists(inner, max_size=3).map(tuple)),
        st.builds(ForEach, st.just((Variable("?x"),)), st.lists(inner, max_size=3).map(tuple)),
    ),
    max_leaves=8,
)


def literals(effect: Effect, before: KnowledgeBase, env: Environment) -> Iterator[tuple[Fluent, str, Value]]:
    """Every single thing that happens: added, deleted, or increased by so much."""
    match effect:
        case Set(fluent, Constant(bool() as value), _):
            yield bind(fluent, env), "add" if value else "delete", True
        case Set(fluent, Constant(value), operation):
            yield bind(fluent, env), "increase", float(value) if operation == "increase" else -float(value)
        case When(condition, inner):
            if evaluate(condition, before, env) is True:
                for one in inner:
                    yield from literals(one, before, env)
        case ForEach(_, inner):
            for room in ROOMS:
                for one in inner:
                    yield from literals(one, before, {**env, "?x": room})


# --- simultaneous, whatever the order and however nested ---


@given(st.lists(NESTED, max_size=5), st.lists(st.sampled_from(ROOMS)), st.randoms(use_true_random=False))
def test_deletes_come_before_adds_and_increases_add_up_in_any_order(effects: list[Effect], lit: list[str], chooser: random.Random) -> None:
    before = rooms_state({**{("at", room): True for room in lit}, ("n",): 10.0, ("m",): 20.0})
    happening = [one for effect in effects for one in literals(effect, before, {"?x": "hall"})]
    expected: Changes = {fluent: False for fluent, what, _ in happening if what == "delete"}
    expected.update({fluent: True for fluent, what, _ in happening if what == "add"})
    for fluent in {fluent for fluent, what, _ in happening if what == "increase"}:
        by = sum(float(value) for one, what, value in happening if what == "increase" and one == fluent)
        expected[fluent] = float(before.value(fluent) or 0.0) + by  # type: ignore[arg-type]
    for _ in range(3):
        assert changes(tuple(effects), before, {"?x": "hall"}) == expected
        chooser.shuffle(effects)


ANY_EFFECTS = st.lists(EFFECTS, max_size=4).map(lambda effects: ground_effects(tuple(effects), {"?x": "hall"}))


# --- what effects may do ---


@given(ANY_EFFECTS, STATES)
def test_nothing_changes_that_is_not_said_to_be_written(effects: Effects, before: KnowledgeBase) -> None:
    after = changes(effects, before)
    assert set(after) <= written(effects, before)
    assert {fluent[0] for fluent in after} <= names_written(effects)


@given(ANY_EFFECTS, STATES, st.data())
def test_only_what_is_read_decides(effects: Effects, before: KnowledgeBase, data: st.DataObject) -> None:
    after = changes(effects, before)
    others = {*ALL_FACTS, *ALL_NUMBERS} - read(effects, before)
    before.update({fluent: data.draw(FIGURES if fluent in ALL_NUMBERS else TRUTHS) for fluent in sorted(others)})
    assert changes(effects, before) == after


def test_what_is_read_are_conditions_right_hand_sides_and_numbers_that_are_moved() -> None:
    effects = (
        change_number("increase", "n", ValueOf(("m",))),
        change_number("assign", "k", 1.0),
        ForEach((Variable("?x"),), (When(Holds(("at", "?x")), (add("p"),)),)),
    )
    assert read(effects, rooms_state()) == {("n",), ("m",), ("at", "hall"), ("at", "kitchen")}


@given(st.lists(EFFECTS, max_size=4).map(tuple), STATES, st.sampled_from(ROOMS))
def test_grounding_first_gives_the_same(effects: Effects, before: KnowledgeBase, room: str) -> None:
    env = {"?x": room}
    assert changes(ground_effects(effects, env), before) == changes(effects, before, env)


@given(ANY_EFFECTS, STATES)
def test_what_happens_is_among_what_may_be_written(effects: Effects, before: KnowledgeBase) -> None:
    unconditional = [(fluent, effect) for fluent, effect, _ in possible_assignments(effects, before)]
    assert {fluent for fluent, _ in unconditional} == written(effects, before)
    assert all((fluent, effect) in unconditional for fluent, effect, _ in assignments(effects, before))
    if not any(isinstance(part, When) for part in every_effect(effects)):
        assert unconditional == [(fluent, effect) for fluent, effect, _ in assignments(effects, before)]


@given(st.lists(PLAIN, max_size=4).map(lambda effects: ground_effects(tuple(effects), {"?x": "hall"})), STATES)
def test_plain_facts_do_not_depend_on_the_state(effects: Effects, before: KnowledgeBase) -> None:
    assert facts(effects, before) == changes(effects, before) == facts(effects, rooms_state())


@pytest.mark.parametrize(
    "effects",
    [
        (change_number("assign", "x", 1.0),),
        (add("p"), change_number("increase", "x", 1.0)),
        (When(TRUE, (add("p"),)),),
        (ForEach((Variable("?x"),), (When(Holds(("p",)), (add("at", "?x"),)),)),),
    ],
    ids=effects_text,
)
def test_numbers_and_conditions_are_no_plain_facts(effects: Effects) -> None:
    assert facts(effects, rooms_state({("p",): True, ("x",): 1.0})) is None


def test_plain_facts_of_every_object() -> None:
    assert facts((ForEach((Variable("?x"),), (add("at", "?x"),)),), rooms_state()) == {("at", "hall"): True, ("at", "kitchen"): True}
    assert facts((), rooms_state()) == {}


SETS = st.builds(
    Set,
    st.sampled_from([("battery", "r1"), ("at", "r1", "hall")]),
    st.sampled_from([0.0, 1.0, 2.5, True, False, "hall"]).map(Constant),
    st.sampled_from(OPERATIONS),
).filter(lambda effect: effect.operation == "assign" or not isinstance(effect.value.value, bool))


@given(SETS, SETS)
def test_effects_that_are_written_alike_are_the_same(one: Set, other: Set) -> None:
    assert (str(one) == str(other)) is (one == other)
