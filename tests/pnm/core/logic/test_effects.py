"""Effects: all at once, deletes before adds, what they may do, when they are decided, and what it takes to undo them."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, strategies as st

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import TRUE, Holds, evaluate
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
    decided,
    effects_text,
    every_effect,
    facts,
    ground_effects,
    names_written,
    possible_assignments,
    read,
    read_early,
    undo,
    values_before,
    written,
)
from pnm.core.logic.expressions import UNDEFINED, UNKNOWN, Constant, Fluent, Unknown, Value, ValueOf, Variable, value_of
from tests.support.logic.effects import (
    ALL_FACTS,
    ALL_NUMBERS,
    ANY_EFFECTS,
    EFFECTS,
    FIGURES,
    MIXED_EFFECTS,
    NUMBERS,
    PLAIN,
    ROOMS,
    STATES,
    TRUTHS,
    add,
    at_hall,
    change_number,
    delete,
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
    assert changes((effect,), rooms_state({("x",): 8, ("by",): by})) == {("x",): after}


@pytest.mark.parametrize("before", [None, UNKNOWN, True, False, "hall"])
def test_what_is_no_number_cannot_be_increased(before: Value | Unknown | None) -> None:
    knowledge = rooms_state({} if before is None else {("x",): before})
    assert changes((change_number("increase", "x", 1.0),), knowledge) == {("x",): UNKNOWN}


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


# --- decided at the start ---


@given(MIXED_EFFECTS, STATES, STATES)
def test_early_conditions_are_asked_at_the_start_and_others_at_the_end(mixed: Effects, start: KnowledgeBase, end: KnowledgeBase) -> None:
    expected = changes(tuple(Set(*one) for one in happening(mixed, start, end, {})), end)
    assert changes(decided(mixed, start), end) == expected
    assert written(decided(mixed, start), end) <= written(mixed, end)
    assert decided(decided(mixed, start), end) == decided(mixed, start)


@given(MIXED_EFFECTS, STATES, STATES, st.data())
def test_only_what_is_read_early_decides_at_the_start_and_only_what_is_read_at_the_end(
    mixed: Effects, start: KnowledgeBase, end: KnowledgeBase, data: st.DataObject
) -> None:
    after = changes(decided(mixed, start), end)
    for moment, matters in ((start, read_early(mixed, start)), (end, read(mixed, end))):
        others = {*ALL_FACTS, *ALL_NUMBERS} - matters
        moment.update({fluent: data.draw(FIGURES if fluent in ALL_NUMBERS else TRUTHS) for fluent in sorted(others)})
    assert changes(decided(mixed, start), end) == after


def test_effects_without_early_conditions_are_left_as_they_are() -> None:
    effects = (add("p"), When(Holds(("p",)), (add("q"),)), ForEach((Variable("?x"),), (When(Holds(("at", "?x")), (delete("p"),)),)))
    assert decided(effects, rooms_state()) is effects
    assert ground_effects((When(Holds(("at", "?x")), (add("q"),), True),), {"?x": "hall"}) == (
        When(Holds(("at", "hall")), (add("q"),), True),
    )


def begin(effects: Effects, knowledge: KnowledgeBase) -> tuple[Changes, Changes]:
    """Apply the effects; return what was there before and what they made of it."""
    after = changes(effects, knowledge)
    before = values_before(after, knowledge)
    knowledge.update(after)
    return before, after


def seen(knowledge: KnowledgeBase) -> list[object]:
    """What conditions can tell of the state: an absent fact is false, an absent number unknown."""
    return [evaluate(Holds(fluent), knowledge) for fluent in ALL_FACTS] + [value_of(ValueOf(fluent), knowledge) for fluent in ALL_NUMBERS]


# --- undo ---


@given(ANY_EFFECTS, STATES)
def test_undo_restores_the_state(effects: Effects, knowledge: KnowledgeBase) -> None:
    at_first = seen(knowledge)
    knowledge.update(undo(*begin(effects, knowledge), knowledge))
    assert seen(knowledge) == at_first


@given(ANY_EFFECTS, STATES, st.dictionaries(st.sampled_from(ALL_FACTS), TRUTHS))
def test_undo_leaves_facts_alone_that_others_have_changed_since(effects: Effects, knowledge: KnowledgeBase, later: Changes) -> None:
    before, after = begin(effects, knowledge)
    theirs = knowledge.update(later)
    knowledge.update(undo(before, after, knowledge))
    assert {fluent: knowledge.value(fluent) for fluent in theirs} == theirs


@pytest.mark.parametrize(("now", "undone"), [(17.0, {("load",): 12.0}), (UNKNOWN, {}), ("nobody", {}), (True, {})])
def test_undo_takes_back_its_own_share_of_what_is_still_a_number(now: Value | Unknown, undone: Changes) -> None:
    knowledge = rooms_state({("load",): 10.0})
    before, after = begin((change_number("increase", "load", 5.0),), knowledge)
    knowledge.update({("load",): now})
    assert undo(before, after, knowledge) == undone


LOCATION: Fluent = ("location", "r1")


# --- objects ---


def test_a_fluent_gets_an_object_by_name_by_variable_or_from_another_fluent() -> None:
    knowledge = rooms_state({("target",): "kitchen"})
    assert changes((Set(LOCATION, Constant("hall")),), knowledge) == {LOCATION: "hall"}
    assert changes((Set(LOCATION, Constant("?to")),), knowledge, {"?to": "hall"}) == {LOCATION: "hall"}
    assert changes((Set(LOCATION, ValueOf(("target",))),), knowledge) == {LOCATION: "kitchen"}
    everywhere = ForEach((Variable("?x", ("room",)),), (Set(("next", "?x"), Constant("?x")),))
    assert changes((everywhere,), knowledge) == {("next", "hall"): "hall", ("next", "kitchen"): "kitchen"}


def test_objects_are_put_back() -> None:
    knowledge = rooms_state({LOCATION: "hall"})
    effects = (Set(LOCATION, Constant("kitchen")), Set(("location", "r2"), Constant("hall")))
    before, after = begin(effects, knowledge)
    assert before == {LOCATION: "hall", ("location", "r2"): UNDEFINED}
    assert undo(before, after, knowledge) == before
    knowledge.update({LOCATION: "cellar"})
    assert undo(before, after, knowledge) == {("location", "r2"): UNDEFINED}


def test_a_constant_object_is_as_plain_as_a_fact() -> None:
    plain = (add("p"), Set(LOCATION, Constant("hall")), Set(("held",), Constant(UNDEFINED)))
    assert facts(plain, rooms_state()) == {("p",): True, LOCATION: "hall", ("held",): UNDEFINED}
    assert facts((Set(LOCATION, ValueOf(("target",))),), rooms_state({("target",): "hall"})) is None


# --- text ---


@pytest.mark.parametrize(
    ("effects", "text"),
    [
        ((), "(and)"),
        ((add("at", "?x"),), "(at ?x)"),
        ((delete("p"), change_number("increase", "n", 1.5)), "(and (not (p)) (increase (n) 1.5))"),
        ((When(Holds(("p",)), (add("q"),)),), "(when (p) (q))"),
        ((ForEach((Variable("?x", ("room",)),), (add("at", "?x"), delete("p"))),), "(forall (?x - room) (and (at ?x) (not (p))))"),
    ],
)
def test_effects_are_written_as_pddl(effects: Effects, text: str) -> None:
    assert effects_text(effects) == text
