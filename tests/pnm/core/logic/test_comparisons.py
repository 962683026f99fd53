"""Conditions about numbers and objects, and their texts."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pnm.core.logic.computed_values import Literal, Parameter
from pnm.core.logic.conditions import TRUE, All, Any, Compare, Computed, Condition, Exists, ForAll, Holds, Implies, Not, fluents, ground
from pnm.core.logic.evaluation import evaluate, explanation, observed
from pnm.core.logic.expressions import (
    DURATION,
    UNDEFINED,
    UNKNOWN,
    Arithmetic,
    Constant,
    Expression,
    Truth,
    Unknown,
    Value,
    ValueOf,
    Variable,
    ground_expression,
    same_value,
    value_of,
)
from pnm.core.logic.operators import Uncomputable, operate
from tests.support.logic.conditions import GivenState

U = UNKNOWN
T, F = True, False


# --- facts and numbers ---


def test_a_fact_nobody_recorded_is_false_and_a_number_is_unknown() -> None:
    assert evaluate(Holds(("p",)), GivenState()) is False
    assert evaluate(Compare("=", ValueOf(("n",)), ValueOf(("n",))), GivenState()) is UNKNOWN


NUMBERED = GivenState({("n",): 3.0, ("zero",): 0.0, ("u",): UNKNOWN, ("where",): "a", ("nowhere",): UNDEFINED})
N, ZERO, UNSURE, WHERE, NOWHERE, ABSENT = (ValueOf((name,)) for name in ("n", "zero", "u", "where", "nowhere", "absent"))


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        (Arithmetic("+", (N, Constant(1.0), Constant(2.0))), 6.0),
        (Arithmetic("-", (N, Constant(1.0), Constant(2.0))), 0.0),
        (Arithmetic("-", (N,)), -3.0),
        (Arithmetic("*", (N, N)), 9.0),
        (Arithmetic("/", (N, Constant(2.0))), 1.5),
        (Arithmetic("/", (N, ZERO)), UNKNOWN),
        (Arithmetic("/", (ZERO, N)), 0.0),
        (Arithmetic("*", (ZERO, UNSURE)), UNKNOWN),
        (Arithmetic("+", (N, WHERE)), UNKNOWN),
        (Arithmetic("+", (N, ValueOf(("absent",)))), UNKNOWN),
        (ValueOf(("absent",)), UNKNOWN),
        (WHERE, "a"),
    ],
    ids=str,
)
def test_arithmetic(expression: Expression, expected: Value | Unknown) -> None:
    assert value_of(expression, NUMBERED) == expected


@pytest.mark.parametrize(
    ("operation", "below", "just_below", "equal", "just_above", "above"),
    [("=", F, T, T, T, F), ("<", T, F, F, F, F), ("<=", T, T, T, T, F), (">", F, F, F, F, T), (">=", F, T, T, T, T)],
)
def test_numbers_are_equal_within_the_tolerance(
    operation: str, below: Truth, just_below: Truth, equal: Truth, just_above: Truth, above: Truth
) -> None:
    left = (2.9, 3 - 1e-7, 3.0, 3 + 1e-7, 3.1)
    assert [evaluate(Compare(operation, Constant(one), N), NUMBERED) for one in left] == [below, just_below, equal, just_above, above]


@pytest.mark.parametrize(
    ("condition", "expected"),
    [
        (Compare("=", Constant("a"), Constant("a")), T),
        (Compare("=", Constant("a"), Constant("b")), F),
        (Compare("=", Constant("?x"), Constant("b")), T),
        (Compare("=", WHERE, Constant("a")), T),
        (Compare("=", WHERE, Constant(1.0)), F),
        (Compare("=", UNSURE, Constant("a")), U),
        (Compare("=", UNSURE, NOWHERE), U),
        (Compare("=", ABSENT, Constant("a")), F),
        (Compare("=", WHERE, ABSENT), F),
        (Compare("=", NOWHERE, WHERE), F),
        (Compare("=", NOWHERE, NOWHERE), F),
        (Compare("=", NOWHERE, ABSENT), F),
        (Compare("=", ABSENT, Constant(1.0)), U),
        (Compare("=", ABSENT, ABSENT), U),
        (Compare("<", Constant("a"), Constant("b")), U),
    ],
    ids=str,
)
def test_objects_are_equal_when_their_names_are(condition: Condition, expected: Truth) -> None:
    assert evaluate(condition, NUMBERED, {"?x": "b"}) is expected


def test_the_duration_comes_from_the_environment() -> None:
    enough = Compare(">=", N, Arithmetic("*", (Constant(2.0), ValueOf(DURATION))))
    assert evaluate(enough, NUMBERED) is UNKNOWN
    for seconds, expected in ((1.5, True), (1.6, False)):
        env = {DURATION[0]: seconds}
        assert evaluate(enough, NUMBERED, env) is evaluate(ground(enough, env), NUMBERED) is expected
        assert fluents(enough, NUMBERED, env) == {("n",)}
    assert ground_expression(ValueOf(DURATION), {}) == ValueOf(DURATION)


@pytest.mark.parametrize(
    ("value", "text"), [("hall", "hall"), (3, "3"), (3.0, "3"), (2.5, "2.5"), (True, "true"), (None, "null"), ([1, "a"], '[1, "a"]')]
)
def test_values_are_written_as_text_in_fluents_and_nowhere_else(value: object, text: str) -> None:
    env = {"?x": value}
    assert ground(Holds(("q", "?x", "?y")), env) == Holds(("q", text, "?y"))
    compared = ground(Compare("=", N, Constant("?x")), env)
    assert evaluate(compared, NUMBERED) is evaluate(Compare("=", N, Constant("?x")), NUMBERED, env) is (value == 3)
    assert ground(Computed(Parameter("?x")), env) == Computed(Literal.of(value))


def test_a_quantified_variable_hides_the_one_outside() -> None:
    condition = All((Holds(("q", "?x")), Exists((Variable("?x"),), Holds(("r", "?x", "?y")))))
    state = GivenState({("q", "a"): True, ("r", "b", "b"): True})
    assert evaluate(condition, state, {"?x": "a", "?y": "b"}) is True
    assert str(ground(condition, {"?x": "a", "?y": "b"})) == "(and (q a) (exists (?x - object) (r ?x b)))"


@pytest.mark.parametrize(
    ("one", "other", "expected"),
    [
        (None, False, True),
        (None, None, True),
        (UNKNOWN, UNKNOWN, True),
        (1.0, 1, True),
        ("a", "a", True),
        (None, 0.0, False),
        (False, 0.0, False),
        (True, 1.0, False),
        (None, UNDEFINED, True),
        (UNDEFINED, UNDEFINED, True),
        (UNDEFINED, False, False),
        (UNDEFINED, UNKNOWN, False),
        (UNKNOWN, None, False),
        (UNKNOWN, False, False),
    ],
)
def test_the_same_value(one: Value | Unknown | None, other: Value | Unknown | None, expected: bool) -> None:
    assert same_value(one, other) is same_value(other, one) is expected


# --- text ---


@pytest.mark.parametrize(
    ("condition", "text"),
    [
        (TRUE, "(and)"),
        (Any(), "(or)"),
        (Holds(("at", "r1", "?to")), "(at r1 ?to)"),
        (Not(Holds(("p",))), "(not (p))"),
        (All((Holds(("p",)), Any((Holds(("q", "a")),)))), "(and (p) (or (q a)))"),
        (Implies(Holds(("p",)), TRUE), "(imply (p) (and))"),
        (
            ForAll((Variable("?x", ("room",)), Variable("?y", ("room", "hall"))), Holds(("r", "?x", "?y"))),
            "(forall (?x - room ?y - (either room hall)) (r ?x ?y))",
        ),
        (Exists((Variable("?x"),), Holds(("q", "?x"))), "(exists (?x - object) (q ?x))"),
        (Compare(">=", ValueOf(("battery", "r1")), Constant(20.0)), "(>= (battery r1) 20)"),
        (Compare("=", Constant("?x"), Constant("a")), "(= ?x a)"),
        (Compare("<", Arithmetic("-", (Constant(0.1),)), ValueOf(DURATION)), "(< (- 0.1) ?duration)"),
        (Compare("=", Constant(1e-9), Arithmetic("+", (Constant(-2.0), Constant(1e20)))), "(= 1e-09 (+ -2 100000000000000000000))"),
    ],
)
def test_conditions_are_written_as_pddl(condition: Condition, text: str) -> None:
    assert str(condition) == text


def test_what_was_expected_and_what_is_so() -> None:
    state = GivenState({("p",): True, ("q", "a"): UNKNOWN, ("n",): 3.0, ("f",): False})
    wanted = All((Holds(("p",)), All((Holds(("q", "a")), Not(Holds(("f",))))), Compare(">", N, Constant(5.0)), Holds(("absent",))))
    assert explanation(wanted, state)[0] == "(q a) (> (n) 5) (absent)"
    assert observed(wanted, state) == "(absent) is false, (f) is false, (n) is 3.0 because it is 3, (p) is true, (q a) is unknown"
    assert observed(TRUE, state) == "no fluent involved"


# --- one and true ---

SIMPLE = st.sampled_from([0, 1, 2, 0.0, 1.0, True, False, None, "", "a"])
DEEP = st.recursive(SIMPLE, lambda inner: st.lists(inner, max_size=2) | st.dictionaries(st.sampled_from("xy"), inner, max_size=2))


def as_json(value: object) -> object:
    """The value with what tells numbers and truth values apart; 1 and 1.0 are one number."""
    match value:
        case list():
            return [as_json(item) for item in value]
        case dict():
            return {name: as_json(item) for name, item in value.items()}
        case bool():
            return "truth value", value
        case _:
            return value


@given(DEEP, DEEP)
def test_equal_is_what_is_equal_in_json(left: object, right: object) -> None:
    if isinstance(left, str) is not isinstance(right, str):
        return  # a text is read as what it is compared with
    equal = as_json(left) == as_json(right)
    assert operate("eq", [left, right]) is operate("eq", [right, left]) is equal
    assert operate("ne", [left, right]) is not equal
    assert operate("contains", [[left], right]) is equal
    assert operate("countOf", [[left, right, left], right]) == (3 if equal else 1)
    assert operate("indexOf", [[left, right], right]) == (0 if equal else 1)


@pytest.mark.parametrize("name", ["lt", "le", "gt", "ge"])
def test_a_truth_value_is_neither_less_nor_more_than_a_number(name: str) -> None:
    for operands in ([True, 2], [0, False], [1.0, True]):
        with pytest.raises(Uncomputable, match="a truth value is neither less nor more than anything else"):
            operate(name, list(operands))


@given(st.sampled_from([0.0, 1.0, True, False, "a"]), st.sampled_from([0.0, 1.0, True, False, "a"]), st.sampled_from(["=", "<", ">="]))
def test_a_fluent_that_is_true_is_not_one(left: Value, right: Value, operation: str) -> None:
    truth = evaluate(Compare(operation, Constant(left), Constant(right)), GivenState())
    if isinstance(left, bool) is not isinstance(right, bool):
        assert truth is (False if operation == "=" else UNKNOWN)
    assert (Constant(left) == Constant(right)) is (type(left) is type(right) and left == right)
