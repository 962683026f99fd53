"""Conditions about numbers and objects, and their texts."""

from __future__ import annotations

import pytest
from hypothesis import example, given, strategies as st

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.computed_values import Literal, Parameter, Uncomputable, operate
from pnm.core.logic.conditions import (
    TRUE,
    All,
    Any,
    Compare,
    Computed,
    Condition,
    Exists,
    ForAll,
    Holds,
    Implies,
    Not,
    evaluate,
    explanation,
    fluents,
    ground,
    observed,
)
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

U = UNKNOWN
T, F = True, False


# --- facts and numbers ---


NUMBERED = KnowledgeBase({("n",): 3.0, ("zero",): 0.0, ("u",): UNKNOWN, ("where",): "a", ("nowhere",): UNDEFINED})
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
        (Compare("=", Constant(True), Constant(1.0)), F),
        (Compare("<", Constant(True), Constant(2.0)), U),
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


@pytest.mark.parametrize(
    ("one", "other", "expected"),
    [(None, UNDEFINED, True), (UNDEFINED, UNDEFINED, True), (UNDEFINED, False, False), (UNDEFINED, UNKNOWN, False)],
)
def test_no_object_is_the_same_as_an_absent_one(one: Value | Unknown | None, other: Value | Unknown | None, expected: bool) -> None:
    assert same_value(one, other) is same_value(other, one) is expected


# --- text ---


@pytest.mark.parametrize(
    ("condition", "text"),
    [
        (TRUE, "(and)"),
        (Any(), "(or)"),
        (Not(Holds(("p",))), "(not (p))"),
        (Implies(Holds(("p",)), TRUE), "(imply (p) (and))"),
        (
            ForAll((Variable("?x", ("room",)), Variable("?y", ("room", "hall"))), Holds(("r", "?x", "?y"))),
            "(forall (?x - room ?y - (either room hall)) (r ?x ?y))",
        ),
        (Exists((Variable("?x"),), Holds(("q", "?x"))), "(exists (?x - object) (q ?x))"),
        (Compare("<", Arithmetic("-", (Constant(0.1),)), ValueOf(DURATION)), "(< (- 0.1) ?duration)"),
        (Compare("=", Constant(1e-9), Arithmetic("+", (Constant(-2.0), Constant(1e20)))), "(= 1e-09 (+ -2 100000000000000000000))"),
    ],
)
def test_conditions_are_written_as_pddl(condition: Condition, text: str) -> None:
    assert str(condition) == text


def test_what_was_expected_and_what_is_so() -> None:
    state = KnowledgeBase({("p",): True, ("q", "a"): UNKNOWN, ("n",): 3.0, ("f",): False})
    state.forget([("q", "a")], "nobody looks")
    wanted = All((Holds(("p",)), All((Holds(("q", "a")), Not(Holds(("f",))))), Compare(">", N, Constant(5.0)), Holds(("absent",))))
    assert explanation(wanted, state)[0] == "(q a) (> (n) 5) (absent)"
    assert observed(wanted, state) == "(absent) is false, (f) is false, (n) is 3.0, (p) is true, (q a) is unknown (nobody looks)"
    assert observed(TRUE, state) == "no fluent involved"


# --- values of any kind ---

SIMPLE = st.sampled_from([0, 1, 2, 0.0, 1.5, -1, True, False, None, "", "a", "1", " 1.0", "1.5", "no", "Yes", "true", float("nan")])
DEEP = st.recursive(SIMPLE, lambda inner: st.lists(inner, max_size=2) | st.dictionaries(st.sampled_from("xy"), inner, max_size=2))
WORDS = {"no": False, "Yes": True, "true": True}


def are_equal(left: object, right: object) -> bool:
    """What is equal: in JSON, where 1 and 1.0 are one number; a text beside a number or a truth value is what it says."""
    if isinstance(right, str) and not isinstance(left, str):
        left, right = right, left
    match left, right:
        case str(), bool():
            return WORDS.get(left) is right
        case str(), int() | float():
            return left.strip()[-1:].isdecimal() and float(left) == right
        case list(), list():
            return len(left) == len(right) and all(map(are_equal, left, right))
        case dict(), dict():
            return left.keys() == right.keys() and all(are_equal(left[name], right[name]) for name in left)
        case _:
            return isinstance(left, bool) is isinstance(right, bool) and left == right


def result(name: str, *operands: object) -> object:
    """What an operator gives; None if it has no result."""
    try:
        return operate(name, [*operands])
    except Uncomputable:
        return None


@example("1", 1)
@given(DEEP, DEEP)
def test_one_rule_says_what_is_equal_for_all_operators_and_at_any_depth(left: object, right: object) -> None:
    equal = are_equal(left, right)
    assert result("eq", left, right) is result("eq", right, left) is equal
    assert result("ne", left, right) is not equal
    assert result("eq", [left], [right]) is result("eq", {"k": left}, {"k": right}) is result("contains", [left], right) is equal
    assert result("countOf", [left, None, left], right) == 2 * equal + (right is None)
    assert result("indexOf", [left], right) == (0 if equal else None)


@given(DEEP, DEEP)
def test_one_rule_says_what_is_less_for_all_operators_and_at_any_depth(left: object, right: object) -> None:
    equal, less, more = are_equal(left, right), result("lt", left, right), result("lt", right, left)
    assert (less is None) is (more is None)
    assert [result(name, left, right) for name in ("gt", "le", "ge")] == (
        [more, less or equal, more or equal] if less is not None else [None] * 3
    )
    assert [less, more, equal].count(True) <= 1
    if less is not None:
        kept = [operate(name, [left, right]) for name in ("min", "max")]
        assert [id(each) for each in kept] == [id(right if more else left), id(right if less else left)]
    else:
        assert result("min", left, right) is result("max", left, right) is None
    if not equal:
        assert result("lt", [left], [right]) is less


@pytest.mark.parametrize("name", ["lt", "le", "gt", "ge", "min", "max"])
def test_a_truth_value_is_neither_less_nor_more_than_a_number(name: str) -> None:
    for operands in ([True, 2], [0, False], [1.0, True]):
        with pytest.raises(Uncomputable, match="a truth value is neither less nor more than another value"):
            operate(name, list(operands))
