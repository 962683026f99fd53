"""Three-valued conditions: Kleene's tables, the laws of logic, and what knowing more can change."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pnm.core.logic.computed_values import Literal, Parameter
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
    conjuncts,
    fluents,
    ground,
    names,
)
from pnm.core.logic.evaluation import evaluate
from pnm.core.logic.explain import failing, observed
from pnm.core.logic.expressions import (
    DURATION,
    UNDEFINED,
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
    ground_expression,
    same_value,
    value_of,
)

Facts = dict[Fluent, Value | Unknown]

OBJECTS = ("a", "b")


@dataclass
class Picture:
    """A state given by its facts; absent fluents are not recorded."""

    facts: Facts = field(default_factory=dict)

    def value(self, fluent: Fluent, /) -> Value | Unknown | None:
        return self.facts.get(fluent)

    def objects(self, types: tuple[str, ...], /) -> tuple[str, ...]:
        return OBJECTS if types == ("object",) else ()

    def because(self, fluent: Fluent, /) -> str:
        return "because it is 3" if self.facts.get(fluent) == 3.0 else ""


# --- random conditions and states -------------------------------------------------------------

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
    lambda facts, numbers: Picture({**facts, **numbers}),
    st.fixed_dictionaries({}, optional=dict.fromkeys(ALL_FACTS, TRUTHS)),
    st.fixed_dictionaries({}, optional=dict.fromkeys(ALL_NUMBERS, AMOUNTS)),
)


# --- Kleene's tables --------------------------------------------------------------------------

U = UNKNOWN
T, F = True, False
STATE = Picture({("t",): True, ("f",): False, ("u",): UNKNOWN})
NAMED: dict[Truth, Condition] = {T: Holds(("t",)), F: Holds(("f",)), U: Holds(("u",))}


@pytest.mark.parametrize(("one", "expected"), [(T, F), (F, T), (U, U)])
def test_not(one: Truth, expected: Truth) -> None:
    assert evaluate(Not(NAMED[one]), STATE) is expected


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
def test_and_or_imply(one: Truth, other: Truth, both: Truth, either: Truth, implied: Truth) -> None:
    left, right = NAMED[one], NAMED[other]
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


# --- laws -------------------------------------------------------------------------------------


@given(CONDITIONS, CONDITIONS, PICTURES, ENVIRONMENTS)
def test_the_laws_of_logic_hold(one: Condition, other: Condition, state: Picture, env: Environment) -> None:
    truth = partial(evaluate, state=state, env=env)
    assert truth(Not(All((one, other)))) is truth(Any((Not(one), Not(other))))
    assert truth(Not(Any((one, other)))) is truth(All((Not(one), Not(other))))
    assert truth(Not(Not(one))) is truth(one)
    assert truth(Implies(one, other)) is truth(Any((Not(one), other)))
    assert truth(All((one, other))) is truth(All((other, one)))
    assert truth(All((one, All((other, one))))) is truth(All((one, other)))


@given(VARIABLES, CONDITIONS, PICTURES, ENVIRONMENTS)
def test_quantifiers_are_written_out(variables: tuple[Variable, ...], body: Condition, state: Picture, env: Environment) -> None:
    instances = tuple(ground(body, inner) for inner in choices(variables, state, env))
    assert len(instances) == len(OBJECTS) ** len(variables)
    assert evaluate(ForAll(variables, body), state, env) is evaluate(All(instances), state)
    assert evaluate(Exists(variables, body), state, env) is evaluate(Any(instances), state)


def drawn(data: st.DataObject, fluent: Fluent) -> Value | Unknown:
    return data.draw(AMOUNTS if fluent in ALL_NUMBERS else TRUTHS)


@given(CONDITIONS, PICTURES, ENVIRONMENTS, st.data())
def test_what_is_known_stays_so_when_more_is_known(condition: Condition, state: Picture, env: Environment, data: st.DataObject) -> None:
    unsure = [fluent for fluent in ALL_FACTS if state.value(fluent) is UNKNOWN]
    unsure += [fluent for fluent in ALL_NUMBERS if state.value(fluent) in (UNKNOWN, None)]
    more = Picture({**state.facts, **{fluent: drawn(data, fluent) for fluent in unsure}})
    before = evaluate(condition, state, env)
    assert before is UNKNOWN or evaluate(condition, more, env) is before


@given(CONDITIONS, PICTURES, ENVIRONMENTS, st.data())
def test_no_other_fluent_matters(condition: Condition, state: Picture, env: Environment, data: st.DataObject) -> None:
    involved = fluents(condition, state, env)
    other = {fluent: drawn(data, fluent) for fluent in (*ALL_FACTS, *ALL_NUMBERS) if fluent not in involved}
    assert evaluate(condition, Picture({**state.facts, **other}), env) is evaluate(condition, state, env)
    assert {fluent[0] for fluent in involved} <= names(condition)


@given(CONDITIONS, PICTURES, ENVIRONMENTS)
def test_grounding_first_gives_the_same(condition: Condition, state: Picture, env: Environment) -> None:
    grounded = ground(condition, env)
    assert evaluate(grounded, state) is evaluate(condition, state, env)
    assert fluents(grounded, state) == fluents(condition, state, env)
    assert ground(grounded, dict.fromkeys(env, "elsewhere")) == grounded


@given(CONDITIONS, PICTURES, ENVIRONMENTS)
def test_failing_parts_are_why_a_condition_does_not_hold(condition: Condition, state: Picture, env: Environment) -> None:
    grounded = ground(condition, env)
    assert (failing(grounded, state) == ()) is (evaluate(grounded, state) is True)
    assert set(failing(grounded, state)) <= set(conjuncts(grounded))


# --- facts and numbers ------------------------------------------------------------------------


def test_a_fact_nobody_recorded_is_false_and_a_number_is_unknown() -> None:
    assert evaluate(Holds(("p",)), Picture()) is False
    assert evaluate(Compare("=", ValueOf(("n",)), ValueOf(("n",))), Picture()) is UNKNOWN


NUMBERED = Picture({("n",): 3.0, ("zero",): 0.0, ("u",): UNKNOWN, ("where",): "a", ("nowhere",): UNDEFINED})
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
    [
        ("=", F, T, T, T, F),
        ("<", T, F, F, F, F),
        ("<=", T, T, T, T, F),
        (">", F, F, F, F, T),
        (">=", F, T, T, T, T),
    ],
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
    state = Picture({("q", "a"): True, ("r", "b", "b"): True})
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


# --- text -------------------------------------------------------------------------------------


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
    state = Picture({("p",): True, ("q", "a"): UNKNOWN, ("n",): 3.0, ("f",): False})
    wanted = All((Holds(("p",)), All((Holds(("q", "a")), Not(Holds(("f",))))), Compare(">", N, Constant(5.0)), Holds(("absent",))))
    assert " ".join(map(str, failing(wanted, state))) == "(q a) (> (n) 5) (absent)"
    assert observed(wanted, state) == "(absent) is false, (f) is false, (n) is 3.0 because it is 3, (p) is true, (q a) is unknown"
    assert observed(TRUE, state) == "no fluent involved"
