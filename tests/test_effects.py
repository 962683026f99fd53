"""Effects: all at once, deletes before adds, and what it takes to undo them."""

from __future__ import annotations

from itertools import permutations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pnm.conditions import TRUE, Condition, Holds, Not, evaluate
from pnm.effects import (
    OPERATIONS,
    Changes,
    Effects,
    ForEach,
    Set,
    When,
    changes,
    facts,
    ground_effects,
    names_written,
    read,
    show_effects,
    unconditional,
    undo,
    values_before,
    written,
)
from pnm.expressions import UNKNOWN, Arithmetic, Constant, Expression, Fluent, Unknown, Value, ValueOf, Variable, value_of
from pnm.knowledge import KnowledgeBase

ROOMS = ("hall", "kitchen")


def add(*fluent: str) -> Set:
    return Set(fluent, Constant(True))


def delete(*fluent: str) -> Set:
    return Set(fluent, Constant(False))


def number(operation: str, name: str, by: Expression | float) -> Set:
    return Set((name,), Constant(by) if isinstance(by, float) else by, operation)


def state(facts: dict[Fluent, Value | Unknown] | None = None) -> KnowledgeBase:
    return KnowledgeBase(facts, objects={"room": ROOMS, "object": ROOMS})


# --- simultaneous -----------------------------------------------------------------------------


@pytest.mark.parametrize("before", [True, False, UNKNOWN])
@pytest.mark.parametrize("effects", list(permutations([add("p"), delete("p"), delete("q")])))
def test_a_fact_both_deleted_and_added_is_added(effects: Effects, before: Value | Unknown) -> None:
    assert changes(effects, state({("p",): before, ("q",): before})) == {("p",): True, ("q",): False}


def test_two_numbers_swap() -> None:
    swap = (Set(("x",), ValueOf(("y",))), Set(("y",), ValueOf(("x",))))
    assert changes(swap, state({("x",): 1.0, ("y",): 2.0})) == {("x",): 2.0, ("y",): 1.0}


def test_conditions_are_asked_before_anything_changes() -> None:
    toggle = (When(Holds(("on",)), (delete("on"),)), When(Not(Holds(("on",))), (add("on"),)))
    assert changes(toggle, state({("on",): True})) == {("on",): False}
    assert changes(toggle, state()) == {("on",): True}
    assert changes(toggle, state({("on",): UNKNOWN})) == {}


def test_universal_effects_happen_for_every_object() -> None:
    room = Variable("?room", ("room",))
    clean = ForEach((room,), (When(Holds(("dirty", "?room")), (delete("dirty", "?room"), add("clean", "?room"))),))
    assert changes((clean,), state({("dirty", "hall"): True})) == {("dirty", "hall"): False, ("clean", "hall"): True}
    assert changes((ForEach((room,), (add("seen", "?by", "?room"),)),), state(), {"?by": "r1", "?room": "elsewhere"}) == {
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
    effect = number(operation, "x", ValueOf(("by",)))
    assert changes((effect,), state({("x",): 8.0, ("by",): by})) == {("x",): after}


@pytest.mark.parametrize("before", [None, UNKNOWN, True, False, "hall"])
def test_what_is_no_number_cannot_be_increased(before: Value | Unknown | None) -> None:
    knowledge = state({} if before is None else {("x",): before})
    assert changes((number("increase", "x", 1.0),), knowledge) == {("x",): UNKNOWN}


def test_whole_numbers_are_numbers() -> None:
    assert changes((number("increase", "x", 1.0),), state({("x",): 3})) == {("x",): 4.0}


def test_increases_accumulate() -> None:
    both = (number("increase", "x", 1.0), number("decrease", "x", ValueOf(("x",))), number("increase", "x", 5.0))
    assert changes(both, state({("x",): 3.0})) == {("x",): 6.0}


# --- what effects may do ----------------------------------------------------------------------

TERMS = st.sampled_from((*ROOMS, "?x"))
FACTS = st.one_of(st.just(("p",)), st.tuples(st.just("at"), TERMS))
NUMBERS = st.sampled_from((("n",), ("m",)))
AMOUNTS: st.SearchStrategy[Expression] = st.one_of(
    st.builds(Constant, st.sampled_from((0.0, 1.0, 2.0))),
    st.builds(ValueOf, NUMBERS),
    st.builds(lambda fluent: Arithmetic("+", (ValueOf(fluent), Constant(1.0))), NUMBERS),
)
PLAIN = st.one_of(st.builds(add, st.just("p")), st.builds(Set, FACTS, st.builds(Constant, st.booleans())))
SETS = st.one_of(PLAIN, st.builds(Set, NUMBERS, AMOUNTS, st.sampled_from(OPERATIONS)))
CONDITIONS: st.SearchStrategy[Condition] = st.one_of(st.just(TRUE), st.builds(Holds, FACTS), st.builds(Not, st.builds(Holds, FACTS)))
EFFECTS = st.recursive(
    SETS,
    lambda inner: st.one_of(
        st.builds(When, CONDITIONS, st.lists(inner, max_size=3).map(tuple)),
        st.builds(ForEach, st.just((Variable("?x"),)), st.lists(inner, max_size=3).map(tuple)),
    ),
    max_leaves=4,
)
ANY_EFFECTS = st.lists(EFFECTS, max_size=4).map(lambda effects: ground_effects(tuple(effects), {"?x": "hall"}))
ALL_FACTS: list[Fluent] = [("p",), ("at", "hall"), ("at", "kitchen")]
ALL_NUMBERS: list[Fluent] = [("n",), ("m",)]
TRUTHS: st.SearchStrategy[Value | Unknown] = st.sampled_from((True, False, UNKNOWN))
FIGURES: st.SearchStrategy[Value | Unknown] = st.sampled_from((0.0, 1.0, 2.5, UNKNOWN))
STATES = st.builds(
    lambda facts, numbers: state({**facts, **numbers}),
    st.fixed_dictionaries({}, optional=dict.fromkeys(ALL_FACTS, TRUTHS)),
    st.fixed_dictionaries({}, optional=dict.fromkeys(ALL_NUMBERS, FIGURES)),
)


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
        number("increase", "n", ValueOf(("m",))),
        number("assign", "k", 1.0),
        ForEach((Variable("?x"),), (When(Holds(("at", "?x")), (add("p"),)),)),
    )
    assert read(effects, state()) == {("n",), ("m",), ("at", "hall"), ("at", "kitchen")}


@given(st.lists(EFFECTS, max_size=4).map(tuple), STATES, st.sampled_from(ROOMS))
def test_grounding_first_gives_the_same(effects: Effects, before: KnowledgeBase, room: str) -> None:
    env = {"?x": room}
    assert changes(ground_effects(effects, env), before) == changes(effects, before, env)


@given(ANY_EFFECTS, STATES)
def test_unconditional_effects_do_all_that_might_be_done(effects: Effects, before: KnowledgeBase) -> None:
    assert set(changes(unconditional(effects), before)) == written(effects, before)


@given(st.lists(PLAIN, max_size=4).map(lambda effects: ground_effects(tuple(effects), {"?x": "hall"})), STATES)
def test_plain_facts_do_not_depend_on_the_state(effects: Effects, before: KnowledgeBase) -> None:
    assert facts(effects, before) == changes(effects, before) == facts(effects, state())


@pytest.mark.parametrize(
    "effects",
    [
        (number("assign", "x", 1.0),),
        (add("p"), number("increase", "x", 1.0)),
        (When(TRUE, (add("p"),)),),
        (ForEach((Variable("?x"),), (When(Holds(("p",)), (add("at", "?x"),)),)),),
    ],
    ids=show_effects,
)
def test_numbers_and_conditions_are_no_plain_facts(effects: Effects) -> None:
    assert facts(effects, state({("p",): True, ("x",): 1.0})) is None


def test_plain_facts_of_every_object() -> None:
    assert facts((ForEach((Variable("?x"),), (add("at", "?x"),)),), state()) == {("at", "hall"): True, ("at", "kitchen"): True}
    assert facts((), state()) == {}


# --- undo -------------------------------------------------------------------------------------


def begin(effects: Effects, knowledge: KnowledgeBase) -> tuple[Changes, Changes]:
    """Apply the effects; return what was there before and what they made of it."""
    after = changes(effects, knowledge)
    before = values_before(after, knowledge)
    knowledge.update(after)
    return before, after


def seen(knowledge: KnowledgeBase) -> list[object]:
    """What conditions can tell of the state: an absent fact is false, an absent number unknown."""
    return [evaluate(Holds(fluent), knowledge) for fluent in ALL_FACTS] + [value_of(ValueOf(fluent), knowledge) for fluent in ALL_NUMBERS]


@given(ANY_EFFECTS, STATES)
def test_undo_restores_the_state(effects: Effects, knowledge: KnowledgeBase) -> None:
    at_first = seen(knowledge)
    knowledge.update(undo(*begin(effects, knowledge), knowledge))
    assert seen(knowledge) == at_first


def test_what_was_absent_is_a_false_fact_or_an_unknown_number() -> None:
    after: Changes = {("p",): True, ("q",): True, ("n",): 3.0, ("m",): 3.0, ("k",): UNKNOWN}
    knowledge = state({("q",): UNKNOWN, ("m",): 0.0})
    assert values_before(after, knowledge) == {("p",): False, ("q",): UNKNOWN, ("n",): UNKNOWN, ("m",): 0.0, ("k",): UNKNOWN}


@given(ANY_EFFECTS, STATES, st.dictionaries(st.sampled_from(ALL_FACTS), TRUTHS))
def test_undo_leaves_facts_alone_that_others_have_changed_since(effects: Effects, knowledge: KnowledgeBase, later: Changes) -> None:
    before, after = begin(effects, knowledge)
    theirs = knowledge.update(later)
    knowledge.update(undo(before, after, knowledge))
    assert {fluent: knowledge.value(fluent) for fluent in theirs} == theirs


def test_undo_takes_back_its_own_share_of_a_number() -> None:
    knowledge = state({("load",): 10.0})
    before, after = begin((number("increase", "load", 5.0),), knowledge)
    knowledge.update(changes((number("increase", "load", 2.0),), knowledge))
    assert undo(before, after, knowledge) == {("load",): 12.0}


@pytest.mark.parametrize("now", [UNKNOWN, "nobody", True])
def test_undo_leaves_a_number_alone_that_has_become_something_else(now: Value | Unknown) -> None:
    knowledge = state({("load",): 10.0})
    before, after = begin((number("increase", "load", 5.0),), knowledge)
    knowledge.update({("load",): now})
    assert undo(before, after, knowledge) == {}


# --- text -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("effects", "text"),
    [
        ((), "(and)"),
        ((add("at", "?x"),), "(at ?x)"),
        ((delete("p"), number("increase", "n", 1.5)), "(and (not (p)) (increase (n) 1.5))"),
        ((When(Holds(("p",)), (add("q"),)),), "(when (p) (q))"),
        ((ForEach((Variable("?x", ("room",)),), (add("at", "?x"), delete("p"))),), "(forall (?x - room) (and (at ?x) (not (p))))"),
    ],
)
def test_effects_are_written_as_pddl(effects: Effects, text: str) -> None:
    assert show_effects(effects) == text


def test_names_written_look_into_every_effect() -> None:
    nested = ForEach((Variable("?x"),), (When(Holds(("r",)), (add("q", "?x"),)), number("decrease", "n", 1.0)))
    assert names_written((add("p"), nested)) == {"p", "q", "n"}
