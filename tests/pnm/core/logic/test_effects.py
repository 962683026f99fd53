"""Effects: all at once, deletes before adds, and what it takes to undo them."""

from __future__ import annotations

import random
from collections.abc import Iterator
from itertools import permutations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import TRUE, Condition, Holds, Not
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
from pnm.core.logic.evaluation import evaluate
from pnm.core.logic.expressions import (
    UNDEFINED,
    UNKNOWN,
    Arithmetic,
    Constant,
    Environment,
    Expression,
    Fluent,
    Unknown,
    Value,
    ValueOf,
    Variable,
    bind,
    choices,
    ground_expression,
    value_of,
)

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


# --- simultaneous, whatever the order and however nested ----------------------------------------

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


@given(st.lists(NESTED, max_size=5), st.lists(st.sampled_from(ROOMS)), st.randoms(use_true_random=False))
def test_deletes_come_before_adds_and_increases_add_up_in_any_order(effects: list[Effect], lit: list[str], chooser: random.Random) -> None:
    before = state({**{("at", room): True for room in lit}, ("n",): 10.0, ("m",): 20.0})
    happening = [one for effect in effects for one in literals(effect, before, {"?x": "hall"})]
    expected: Changes = {fluent: False for fluent, what, _ in happening if what == "delete"}
    expected.update({fluent: True for fluent, what, _ in happening if what == "add"})
    for fluent in {fluent for fluent, what, _ in happening if what == "increase"}:
        by = sum(float(value) for one, what, value in happening if what == "increase" and one == fluent)
        expected[fluent] = float(before.value(fluent) or 0.0) + by  # type: ignore[arg-type]
    for _ in range(3):
        assert changes(tuple(effects), before, {"?x": "hall"}) == expected
        chooser.shuffle(effects)


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
def test_what_happens_is_among_what_may_be_written(effects: Effects, before: KnowledgeBase) -> None:
    unconditional = [(fluent, effect) for fluent, effect, _ in possible_assignments(effects, before)]
    assert {fluent for fluent, _ in unconditional} == written(effects, before)
    assert all((fluent, effect) in unconditional for fluent, effect, _ in assignments(effects, before))
    if not any(isinstance(part, When) for part in every_effect(effects)):
        assert unconditional == [(fluent, effect) for fluent, effect, _ in assignments(effects, before)]


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
    ids=effects_text,
)
def test_numbers_and_conditions_are_no_plain_facts(effects: Effects) -> None:
    assert facts(effects, state({("p",): True, ("x",): 1.0})) is None


def test_plain_facts_of_every_object() -> None:
    assert facts((ForEach((Variable("?x"),), (add("at", "?x"),)),), state()) == {("at", "hall"): True, ("at", "kitchen"): True}
    assert facts((), state()) == {}


# --- decided at the start -----------------------------------------------------------------------


def early(effects: Effects, chooser: random.Random) -> Effects:
    """The effects, some of whose conditions are decided early."""
    result: list[Effect] = []
    for effect in effects:
        match effect:
            case Set():
                result.append(effect)
            case When(condition, inner):
                result.append(When(condition, early(inner, chooser), chooser.random() < 0.5))
            case ForEach(variables, inner):
                result.append(ForEach(variables, early(inner, chooser)))
    return tuple(result)


def happening(effects: Effects, start: KnowledgeBase, end: KnowledgeBase, env: Environment) -> list[tuple[Fluent, Expression, str]]:
    """The oracle: every `Set` that happens, each condition asked in the state it is about."""
    found: list[tuple[Fluent, Expression, str]] = []
    for effect in effects:
        match effect:
            case Set(fluent, value, operation):
                found.append((bind(fluent, env), ground_expression(value, env), operation))
            case When(condition, inner, is_early):
                if evaluate(condition, start if is_early else end, env) is True:
                    found += happening(inner, start, end, env)
            case ForEach(variables, inner):
                for chosen in choices(variables, end, env):
                    found += happening(inner, start, end, chosen)
    return found


@given(ANY_EFFECTS, STATES, STATES, st.randoms(use_true_random=False))
def test_early_conditions_are_asked_at_the_start_and_others_at_the_end(
    effects: Effects, start: KnowledgeBase, end: KnowledgeBase, chooser: random.Random
) -> None:
    mixed = early(effects, chooser)
    expected = changes(tuple(Set(*one) for one in happening(mixed, start, end, {})), end)
    assert changes(decided(mixed, start), end) == expected
    assert written(decided(mixed, start), end) <= written(mixed, end)
    assert decided(decided(mixed, start), end) == decided(mixed, start)


@given(ANY_EFFECTS, STATES, STATES, st.randoms(use_true_random=False), st.data())
def test_only_what_is_read_early_decides_at_the_start_and_only_what_is_read_at_the_end(
    effects: Effects, start: KnowledgeBase, end: KnowledgeBase, chooser: random.Random, data: st.DataObject
) -> None:
    mixed = early(effects, chooser)
    after = changes(decided(mixed, start), end)
    for moment, matters in ((start, read_early(mixed, start)), (end, read(mixed, end))):
        others = {*ALL_FACTS, *ALL_NUMBERS} - matters
        moment.update({fluent: data.draw(FIGURES if fluent in ALL_NUMBERS else TRUTHS) for fluent in sorted(others)})
    assert changes(decided(mixed, start), end) == after


def test_effects_without_early_conditions_are_left_as_they_are() -> None:
    effects = (add("p"), When(Holds(("p",)), (add("q"),)), ForEach((Variable("?x"),), (When(Holds(("at", "?x")), (delete("p"),)),)))
    assert decided(effects, state()) is effects
    assert ground_effects((When(Holds(("at", "?x")), (add("q"),), True),), {"?x": "hall"}) == (
        When(Holds(("at", "hall")), (add("q"),), True),
    )


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


# --- objects ------------------------------------------------------------------------------------

LOCATION: Fluent = ("location", "r1")


def test_a_fluent_gets_an_object_by_name_by_variable_or_from_another_fluent() -> None:
    knowledge = state({("target",): "kitchen"})
    assert changes((Set(LOCATION, Constant("hall")),), knowledge) == {LOCATION: "hall"}
    assert changes((Set(LOCATION, Constant("?to")),), knowledge, {"?to": "hall"}) == {LOCATION: "hall"}
    assert changes((Set(LOCATION, ValueOf(("target",))),), knowledge) == {LOCATION: "kitchen"}
    everywhere = ForEach((Variable("?x", ("room",)),), (Set(("next", "?x"), Constant("?x")),))
    assert changes((everywhere,), knowledge) == {("next", "hall"): "hall", ("next", "kitchen"): "kitchen"}


def test_a_fluent_may_lose_its_object() -> None:
    knowledge = state({LOCATION: "hall"})
    assert changes((Set(LOCATION, Constant(UNDEFINED)),), knowledge) == {LOCATION: UNDEFINED}
    assert changes((Set(LOCATION, ValueOf(("nobody-knows",))),), state({("nobody-knows",): UNKNOWN})) == {LOCATION: UNKNOWN}


def test_objects_are_put_back() -> None:
    knowledge = state({LOCATION: "hall"})
    effects = (Set(LOCATION, Constant("kitchen")), Set(("location", "r2"), Constant("hall")))
    before, after = begin(effects, knowledge)
    assert before == {LOCATION: "hall", ("location", "r2"): UNDEFINED}
    assert undo(before, after, knowledge) == before
    knowledge.update({LOCATION: "cellar"})
    assert undo(before, after, knowledge) == {("location", "r2"): UNDEFINED}


def test_a_constant_object_is_as_plain_as_a_fact() -> None:
    plain = (add("p"), Set(LOCATION, Constant("hall")), Set(("held",), Constant(UNDEFINED)))
    assert facts(plain, state()) == {("p",): True, LOCATION: "hall", ("held",): UNDEFINED}
    assert facts((Set(LOCATION, ValueOf(("target",))),), state({("target",): "hall"})) is None


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
    assert effects_text(effects) == text


def test_names_written_look_into_every_effect() -> None:
    nested = ForEach((Variable("?x"),), (When(Holds(("r",)), (add("q", "?x"),)), number("decrease", "n", 1.0)))
    assert names_written((add("p"), nested)) == {"p", "q", "n"}
