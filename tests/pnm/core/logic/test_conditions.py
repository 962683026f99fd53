"""Three-valued conditions: Kleene's tables, quantifiers, and what knowing more can change."""

from __future__ import annotations

from itertools import product

import pytest
from hypothesis import given, strategies as st

from pnm.core.logic.conditions import (
    TRUE,
    All,
    Any,
    Compare,
    Condition,
    Exists,
    ForAll,
    Holds,
    Implies,
    Not,
    compiled,
    evaluate,
    fluents,
    ground,
    names,
)
from pnm.core.logic.expressions import (
    UNKNOWN,
    Arithmetic,
    Constant,
    Environment,
    Expression,
    Fluent,
    Truth,
    Unknown,
    Value,
    ValueOf,
    Variable,
    choices,
)
from tests.support.logic.conditions import OBJECTS, GivenState

TERMS = st.sampled_from(("a", "b", "?x", "?y"))
FACTS = st.one_of(st.just(("p",)), st.tuples(st.just("q"), TERMS), st.tuples(st.just("r"), TERMS, TERMS))
NUMBERS = st.one_of(st.just(("n",)), st.tuples(st.just("m"), TERMS))
EXPRESSIONS: st.SearchStrategy[Expression] = st.recursive(
    st.one_of(st.builds(Constant, st.sampled_from((0.0, 1.0, 2.0))), st.builds(ValueOf, NUMBERS)),
    lambda inner: st.builds(Arithmetic, st.sampled_from("+-*/"), st.lists(inner, min_size=1, max_size=2).map(tuple)),
    max_leaves=3,
)
VARIABLES = st.lists(st.sampled_from(("?x", "?y")), min_size=1, max_size=2, unique=True).map(lambda chosen: tuple(map(Variable, chosen)))
LEAVES = st.one_of(
    st.builds(Holds, FACTS),
    st.builds(Compare, st.sampled_from(("=", "<", "<=", ">", ">=")), EXPRESSIONS, EXPRESSIONS),
    st.builds(Compare, st.just("="), st.builds(Constant, TERMS), st.builds(Constant, TERMS)),
)


def _compound(inner: st.SearchStrategy[Condition]) -> st.SearchStrategy[Condition]:
    several = st.lists(inner, max_size=3).map(tuple)
    return st.one_of(
        st.builds(Not, inner),
        st.builds(All, several),
        st.builds(Any, several),
        st.builds(Implies, inner, inner),
        st.builds(ForAll, VARIABLES, inner),
        st.builds(Exists, VARIABLES, inner),
    )


CONDITIONS: st.SearchStrategy[Condition] = st.recursive(LEAVES, _compound, max_leaves=6)
ENVIRONMENTS = st.fixed_dictionaries({"?x": st.sampled_from(OBJECTS), "?y": st.sampled_from(OBJECTS)})
ALL_FACTS = [("p",), *(("q", one) for one in OBJECTS), *(("r", one, other) for one, other in product(OBJECTS, OBJECTS))]
ALL_NUMBERS = [("n",), *(("m", one) for one in OBJECTS)]
TRUTHS: st.SearchStrategy[Value | Unknown] = st.sampled_from((True, False, UNKNOWN))
AMOUNTS: st.SearchStrategy[Value | Unknown] = st.sampled_from((0.0, 1.0, 2.0, UNKNOWN))
PICTURES = st.builds(
    lambda facts, numbers: GivenState({**facts, **numbers}),
    st.fixed_dictionaries({}, optional=dict.fromkeys(ALL_FACTS, TRUTHS)),
    st.fixed_dictionaries({}, optional=dict.fromkeys(ALL_NUMBERS, AMOUNTS)),
)
U = UNKNOWN
T, F = True, False
STATE = GivenState({("t",): True, ("f",): False, ("u",): UNKNOWN})
NAMED: dict[Truth, Condition] = {T: Holds(("t",)), F: Holds(("f",)), U: Holds(("u",))}


# --- Kleene's tables ---


@pytest.mark.parametrize(
    ("one", "other", "both", "either", "implied"),
    [
        (T, T, T, T, T),
        (T, F, F, T, F),
        (T, U, U, T, U),
        (F, T, F, T, T),
        (F, F, F, F, T),
        (F, U, F, U, T),
        (U, T, U, T, T),
        (U, F, F, U, U),
        (U, U, U, U, U),
    ],
)
def test_not_and_or_imply(one: Truth, other: Truth, both: Truth, either: Truth, implied: Truth) -> None:
    left, right = NAMED[one], NAMED[other]
    assert evaluate(Not(left), STATE) is (U if one is U else not one)
    assert evaluate(All((left, right)), STATE) is both
    assert evaluate(Any((left, right)), STATE) is either
    assert evaluate(Implies(left, right), STATE) is implied


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


@given(VARIABLES, CONDITIONS, PICTURES, ENVIRONMENTS)
def test_quantifiers_are_written_out(variables: tuple[Variable, ...], body: Condition, state: GivenState, env: Environment) -> None:
    instances = tuple(ground(body, inner) for inner in choices(variables, state, env))
    assert len(instances) == len(OBJECTS) ** len(variables)
    assert evaluate(ForAll(variables, body), state, env) is evaluate(All(instances), state)
    assert evaluate(Exists(variables, body), state, env) is evaluate(Any(instances), state)


def drawn(data: st.DataObject, fluent: Fluent) -> Value | Unknown:
    return data.draw(AMOUNTS if fluent in ALL_NUMBERS else TRUTHS)


@given(CONDITIONS, PICTURES, ENVIRONMENTS, st.data())
def test_what_is_known_stays_so_when_more_is_known(condition: Condition, state: GivenState, env: Environment, data: st.DataObject) -> None:
    unsure = [fluent for fluent in ALL_FACTS if state.value(fluent) is UNKNOWN]
    unsure += [fluent for fluent in ALL_NUMBERS if state.value(fluent) in (UNKNOWN, None)]
    more = GivenState({**state.facts, **{fluent: drawn(data, fluent) for fluent in unsure}})
    before = evaluate(condition, state, env)
    assert before is UNKNOWN or evaluate(condition, more, env) is before


@given(CONDITIONS, PICTURES, ENVIRONMENTS, st.data())
def test_no_other_fluent_matters(condition: Condition, state: GivenState, env: Environment, data: st.DataObject) -> None:
    involved = fluents(condition, state, env)
    other = {fluent: drawn(data, fluent) for fluent in (*ALL_FACTS, *ALL_NUMBERS) if fluent not in involved}
    assert evaluate(condition, GivenState({**state.facts, **other}), env) is evaluate(condition, state, env)
    assert {fluent[0] for fluent in involved} <= names(condition)


@given(CONDITIONS, PICTURES, ENVIRONMENTS)
def test_grounding_first_gives_the_same(condition: Condition, state: GivenState, env: Environment) -> None:
    grounded = ground(condition, env)
    assert evaluate(grounded, state) is evaluate(condition, state, env)
    assert fluents(grounded, state) == fluents(condition, state, env)
    assert ground(grounded, dict.fromkeys(env, "elsewhere")) == grounded


# --- compiled ---


@given(CONDITIONS, ENVIRONMENTS, PICTURES)
def test_a_compiled_condition_has_the_same_truth(condition: Condition, env: Environment, state: GivenState) -> None:
    grounded = ground(condition, env)
    assert compiled(grounded).truth(state) is evaluate(grounded, state)
