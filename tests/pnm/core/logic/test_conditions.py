"""Three-valued conditions: Kleene's tables, quantifiers, what knowing more can change; and facts and numbers as texts."""

from __future__ import annotations

from collections.abc import Mapping

import pytest
from hypothesis import given, strategies as st

from pnm.core.knowledge_base import KnowledgeBase, parse_fluent, parse_statement, statement_text
from pnm.core.logic.compiled import compiled
from pnm.core.logic.conditions import TRUE, All, Any, Condition, Exists, ForAll, Holds, Implies, Not, evaluate, fluents, ground, names
from pnm.core.logic.expressions import UNKNOWN, Environment, Fluent, Truth, Unknown, Value, Variable, choices
from pnm.errors import InputError
from tests.support.logic.rules import ALL_FACTS, ALL_NUMBERS, BASE, FACTS, OBJECTS, known, stratified_conditions
from tests.support.runs.timing import functions_called

X = Variable("?x")
VARIABLES = st.lists(st.sampled_from(("?x", "?y")), min_size=1, max_size=2, unique=True).map(lambda chosen: tuple(map(Variable, chosen)))
CONDITIONS = stratified_conditions(("?x", "?y"), BASE, BASE, 3)
NAMES = OBJECTS["object"]
ENVIRONMENTS = st.fixed_dictionaries({"?x": st.sampled_from(NAMES), "?y": st.sampled_from(NAMES)})
STATES = FACTS.map(known)
U = UNKNOWN
T, F = True, False
STATE = known({("t",): True, ("f",): False, ("u",): UNKNOWN})
NAMED: dict[Truth, Condition] = {T: Holds(("t",)), F: Holds(("f",)), U: Holds(("u",))}


# --- Kleene's tables ---


@pytest.mark.parametrize("one", NAMED)
@pytest.mark.parametrize("other", NAMED)
def test_not_and_or_imply(one: Truth, other: Truth) -> None:
    """False is less than unknown, and that less than true: `and` is the least of both, `or` the greatest."""
    order = [F, U, T]
    left, right, opposite = NAMED[one], NAMED[other], order[2 - order.index(one)]
    assert evaluate(Not(left), STATE) is opposite
    assert evaluate(All((left, right)), STATE) is min(one, other, key=order.index)
    assert evaluate(Any((left, right)), STATE) is max(one, other, key=order.index)
    assert evaluate(Implies(left, right), STATE) is max(opposite, other, key=order.index)


def test_of_no_conditions_all_hold_and_none_does() -> None:
    assert evaluate(TRUE, STATE) is True
    assert evaluate(Any(), STATE) is False
    nobody = (Variable("?x", ("nobody",)),)
    assert evaluate(ForAll(nobody, Any()), STATE) is True
    assert evaluate(Exists(nobody, TRUE), STATE) is False


def test_unknown_is_no_truth_value_to_branch_on() -> None:
    with pytest.raises(TypeError, match="compare with `is`"):
        bool(UNKNOWN)


# --- laws ---


@given(VARIABLES, CONDITIONS, STATES, ENVIRONMENTS)
def test_quantifiers_are_written_out(variables: tuple[Variable, ...], body: Condition, state: KnowledgeBase, env: Environment) -> None:
    instances = tuple(ground(body, inner) for inner in choices(variables, state, env))
    assert len(instances) == len(NAMES) ** len(variables)
    assert evaluate(ForAll(variables, body), state, env) is evaluate(All(instances), state)
    assert evaluate(Exists(variables, body), state, env) is evaluate(Any(instances), state)


def drawn(data: st.DataObject, fluent: Fluent) -> Value | Unknown:
    return data.draw(st.sampled_from((0.0, 1.0, 2.0, UNKNOWN) if fluent in ALL_NUMBERS else (True, False, UNKNOWN)))


@given(CONDITIONS, STATES, ENVIRONMENTS, st.data())
def test_what_is_known_stays_so(condition: Condition, state: KnowledgeBase, env: Environment, data: st.DataObject) -> None:
    unsure = [fluent for fluent in ALL_FACTS if state.value(fluent) is UNKNOWN]
    unsure += [fluent for fluent in ALL_NUMBERS if state.value(fluent) in (UNKNOWN, None)]
    more = known({**state.facts(), **{fluent: drawn(data, fluent) for fluent in unsure}})
    before = evaluate(condition, state, env)
    assert before is UNKNOWN or evaluate(condition, more, env) is before


@given(CONDITIONS, STATES, ENVIRONMENTS, st.data())
def test_no_other_fluent_matters(condition: Condition, state: KnowledgeBase, env: Environment, data: st.DataObject) -> None:
    involved = fluents(condition, state, env)
    other = {fluent: drawn(data, fluent) for fluent in (*ALL_FACTS, *ALL_NUMBERS) if fluent not in involved}
    assert evaluate(condition, known({**state.facts(), **other}), env) is evaluate(condition, state, env)
    assert {fluent[0] for fluent in involved} <= names(condition)


@given(CONDITIONS, STATES, ENVIRONMENTS)
def test_grounding_first_gives_the_same(condition: Condition, state: KnowledgeBase, env: Environment) -> None:
    grounded = ground(condition, env)
    assert evaluate(grounded, state) is evaluate(condition, state, env)
    assert fluents(grounded, state) == fluents(condition, state, env)
    assert ground(grounded, dict.fromkeys(env, "elsewhere")) == grounded


# --- compiled ---


@given(CONDITIONS, ENVIRONMENTS, STATES)
def test_a_compiled_condition_has_the_same_truth(condition: Condition, env: Environment, state: KnowledgeBase) -> None:
    grounded = ground(condition, env)
    assert compiled(grounded).truth(state) is evaluate(grounded, state)


CHANGE = st.dictionaries(
    st.sampled_from([*ALL_FACTS, ("q", "stranger"), ("n", "a")]), st.sampled_from((True, False, UNKNOWN, 0.0)), max_size=2
)


@given(st.sampled_from((ForAll, Exists)), VARIABLES, CONDITIONS, ENVIRONMENTS, STATES, st.lists(CHANGE, max_size=6))
def test_a_compiled_condition_over_all_has_the_same_truth_after_every_change(
    kind: type[ForAll] | type[Exists],
    variables: tuple[Variable, ...],
    body: Condition,
    env: Environment,
    state: KnowledgeBase,
    changes: list[Mapping[Fluent, Value | Unknown]],
) -> None:
    condition = ground(kind(variables, body), env)
    truth = compiled(condition).truth
    for change in ({}, *changes, {}):
        state.update(change)
        assert truth(state) is evaluate(condition, state)
    state.begin_anew({("q", "b"): True}, {"object": ("b",)}, state.rules)
    assert truth(state) is evaluate(condition, state)


def test_of_all_objects_those_are_looked_at_that_a_change_is_about() -> None:
    def called_by_change(count: int) -> int:
        objects = tuple(f"o{number}" for number in range(count))
        state = KnowledgeBase({("q", one): True for one in objects}, objects={"object": objects})
        truth = compiled(All((ForAll((X,), Holds(("q", "?x"))), Not(Exists((X,), Not(Holds(("q", "?x")))))))).truth
        assert truth(state) is True
        with functions_called() as called:
            for one in (objects[-1], objects[0]):
                state.update({("q", one): False})
                assert truth(state) is False
                state.update({("q", one): True})
                assert truth(state) is True
        return called()

    assert called_by_change(400) < 2 * called_by_change(10)


# --- statements: what is written is read, and the rest is refused ---


@pytest.mark.parametrize(
    ("text", "statement"),
    [
        ("  ( at\tr1\n kitchen ) ", (("at", "r1", "kitchen"), True)),
        ("( not ( ready ) )", (("ready",), False)),
        ("(= (offset) -1.5e1)", (("offset",), -15.0)),
        ("(= (battery r1) 0)", (("battery", "r1"), 0.0)),
        ("(= (battery r1) .5)", (("battery", "r1"), 0.5)),
        ("(= (place-of r1) nan)", (("place-of", "r1"), "nan")),
        ("(= (place-of r1) infinity)", (("place-of", "r1"), "infinity")),
    ],
)
def test_statements(text: str, statement: tuple[Fluent, Value]) -> None:
    assert parse_statement(text) == statement
    assert type(parse_statement(text)[1]) is type(statement[1])


@pytest.mark.parametrize(
    ("text", "refused"),
    [
        ("", ""),
        ("at r1", "at r1"),
        ("()", "()"),
        ("(at r1", "(at r1"),
        ("(at r1))", "(at r1))"),
        ("(at (r1))", "(at (r1))"),
        ("(p) (q)", "(p) (q)"),
        ("(not (not (p)))", "(not (p))"),
        ("(not (p) (q))", "(p) (q)"),
        ("(= (at (r1)) 1)", "(at (r1))"),
        ("(= (n) 1 2)", "(= (n) 1 2)"),
        ("(and (p) (q))", "(and (p) (q))"),
    ],
)
def test_what_is_no_statement_is_refused(text: str, refused: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_statement(text)
    assert str(caught.value) == f"not a fact: {refused!r}; expected something like (at r1 kitchen)"


FLUENTS: st.SearchStrategy[Fluent] = st.lists(st.text("ab-1_?", min_size=1, max_size=4), min_size=1, max_size=4).map(tuple)


@given(FLUENTS, st.one_of(st.booleans(), st.floats(-1e6, 1e6).map(lambda value: round(value, 3) + 0.0), st.just("hall")))
def test_a_statement_that_is_written_is_read(fluent: Fluent, value: Value) -> None:
    assert repr(parse_statement(statement_text(fluent, value))) == repr((fluent, value)), "of the same type as well"
    assert parse_fluent(statement_text(fluent, True)) == fluent


@given(st.text("()=not 1ab", max_size=30))
def test_any_text_is_a_statement_or_refused(text: str) -> None:
    try:
        fluent, _ = parse_statement(text)
    except InputError:
        return
    assert fluent
    assert all(fluent)
