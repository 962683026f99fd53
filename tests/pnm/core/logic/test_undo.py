"""What it takes to undo effects; effects decided at the start, on objects, and as text."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import Holds, evaluate
from pnm.core.logic.effects import (
    Changes,
    Effects,
    ForEach,
    Set,
    When,
    changes,
    decided,
    effects_text,
    facts,
    ground_effects,
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
    FIGURES,
    MIXED_EFFECTS,
    STATES,
    TRUTHS,
    add,
    change_number,
    delete,
    happening,
    rooms_state,
)

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


def test_undo_takes_back_its_own_share_of_a_number() -> None:
    knowledge = rooms_state({("load",): 10.0})
    before, after = begin((change_number("increase", "load", 5.0),), knowledge)
    knowledge.update(changes((change_number("increase", "load", 2.0),), knowledge))
    assert undo(before, after, knowledge) == {("load",): 12.0}


@pytest.mark.parametrize("now", [UNKNOWN, "nobody", True])
def test_undo_leaves_a_number_alone_that_has_become_something_else(now: Value | Unknown) -> None:
    knowledge = rooms_state({("load",): 10.0})
    before, after = begin((change_number("increase", "load", 5.0),), knowledge)
    knowledge.update({("load",): now})
    assert undo(before, after, knowledge) == {}


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
