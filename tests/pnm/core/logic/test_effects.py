"""Effects: all at once, deletes before adds, and what they may do."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, strategies as st

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import TRUE, Holds
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
from pnm.core.logic.expressions import UNKNOWN, Constant, Unknown, Value, ValueOf, Variable, value_of
from tests.support.logic.effects import (
    ALL_FACTS,
    ALL_NUMBERS,
    ANY_EFFECTS,
    EFFECTS,
    FIGURES,
    NUMBERS,
    PLAIN,
    ROOMS,
    STATES,
    TRUTHS,
    add,
    at_hall,
    change_number,
    effects_of,
    happening,
    rooms_state,
)

# --- simultaneous ---


def test_two_numbers_swap() -> None:
    swap = (Set(("x",), ValueOf(("y",))), Set(("y",), ValueOf(("x",))))
    assert changes(swap, rooms_state({("x",): 1.0, ("y",): 2.0})) == {("x",): 2.0, ("y",): 1.0}


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


MOVED = st.builds(Set, NUMBERS, st.sampled_from((1.0, 2.0, 4.0)).map(Constant), st.sampled_from(("increase", "decrease")))


# --- simultaneous, whatever the order and however nested ---


@given(st.lists(effects_of(st.one_of(PLAIN, MOVED)), max_size=5), STATES, st.randoms(use_true_random=False))
def test_deletes_come_before_adds_and_increases_add_up_in_any_order(
    effects: list[Effect], before: KnowledgeBase, chooser: random.Random
) -> None:
    before.update({("n",): 10.0, ("m",): 20.0})
    happen = [(fluent, value_of(value, before), how) for fluent, value, how in happening(tuple(effects), before, before, ROOM)]
    expected: Changes = {fluent: False for fluent, value, _ in happen if value is False}
    expected.update({fluent: True for fluent, value, _ in happen if value is True})
    for fluent in (("n",), ("m",)):
        by = [value if how == "increase" else -value for one, value, how in happen if one == fluent]  # type: ignore[operator]
        if by:
            expected[fluent] = sum(by, before.value(fluent))  # type: ignore[arg-type]
    for _ in range(3):
        assert changes(tuple(effects), before, ROOM) == expected
        chooser.shuffle(effects)


ROOM = {"?x": "hall"}


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


@given(at_hall(PLAIN), STATES)
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


SETS = st.builds(
    Set,
    st.sampled_from([("battery", "r1"), ("at", "r1", "hall")]),
    st.sampled_from([0.0, 1.0, 2.5, True, False, "hall"]).map(Constant),
    st.sampled_from(OPERATIONS),
).filter(lambda effect: effect.operation == "assign" or not isinstance(effect.value.value, bool))


@given(SETS, SETS)
def test_effects_that_are_written_alike_are_the_same(one: Set, other: Set) -> None:
    assert (str(one) == str(other)) is (one == other)
