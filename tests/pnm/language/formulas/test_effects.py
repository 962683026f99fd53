"""Effects, moments, durations and typed lists in YAML; and formulas that are wrong."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from pnm.core.logic.computed_values import Layer, Operation
from pnm.core.logic.conditions import All, Compare, Computed, ForAll, Holds, Not
from pnm.core.logic.domain import Declaration, DomainModel, DurationConstraint, ProblemModel
from pnm.core.logic.effects import ForEach, Set, When
from pnm.core.logic.expressions import Arithmetic, Constant, ValueOf, Variable
from pnm.errors import InputError
from pnm.language.formulas.readers import (
    TimedConditions,
    WrittenEffects,
    read_condition,
    read_conditions,
    read_duration,
    read_effects,
    read_expression,
    read_timed_effects,
)
from pnm.language.formulas.scope import ANYTHING, FormulaScope, read_names, read_typed
from pnm.language.formulas.values import read_data, read_operation
from tests.support.files import refused_by_file
from tests.support.yaml.formulas import lit, node, q

TIME, VALUE = q("time", Layer.ALL), q("value", Layer.ALL)
AT = Set(("at", "?r", "b"), Constant(True))
EFFECTS: list[tuple[str, WrittenEffects]] = [
    ('"(at ?r b)"', WrittenEffects((AT,))),
    ('["(at ?r b)", {not: "(at ?r a)"}]', WrittenEffects((AT, Set(("at", "?r", "a"), Constant(False))))),
    ("{and: [{not: {Holds: (a)}}, [{and: {Holds: (b)}}]]}", WrittenEffects((Set(("a",), Constant(False)), Set(("b",), Constant(True))))),
    ("{increase: [(cost), 5]}", WrittenEffects((Set(("cost",), Constant(5.0), "increase"),))),
    ("{scale_up: [(cost), (rate)]}", WrittenEffects((Set(("cost",), ValueOf(("rate",)), "scale-up"),))),
    ('{assign: ["(place ?r)", "?to"]}', WrittenEffects((Set(("place", "?r"), Constant("?to")),))),
    ("{decrease: [(fuel), '?n']}", WrittenEffects((Set(("fuel",), Constant("?n"), "decrease"),))),
    ("{when: {condition: (a), effects: [(b)]}}", WrittenEffects((When(Holds(("a",)), (Set(("b",), Constant(True)),)),))),
    ("{when: {at_start: (a), effects: (b)}}", WrittenEffects((When(Holds(("a",)), (Set(("b",), Constant(True)),), early=True),))),
    (
        '{forall: {variables: "?x - t", effects: {not: "(p ?x)"}}}',
        WrittenEffects((ForEach((Variable("?x", ("t",)),), (Set(("p", "?x"), Constant(False)),)),)),
    ),
    (
        '[Comparison: ["eq", [Query: time, Query: value]], {not: {Comparison: ["ne", [Query: time, Query: value]]}}]',
        WrittenEffects((), All((Computed(Operation("eq", (TIME, VALUE))), Not(Computed(Operation("ne", (TIME, VALUE))))))),
    ),
    ("[(done), {LocalQuery: success}]", WrittenEffects((Set(("done",), Constant(True)),), Computed(q("success")))),
    ('{forall: {variables: "?x", condition: "(clean ?x)"}}', WrittenEffects((), ForAll((Variable("?x"),), Holds(("clean", "?x"))))),
    ("{}", WrittenEffects()),
]


@pytest.mark.parametrize(("text", "expected"), EFFECTS, ids=[text for text, _ in EFFECTS])
def test_effects(text: str, expected: WrittenEffects) -> None:
    assert read_effects(node(text)) == expected


def test_conditions_and_effects_by_moment() -> None:
    assert read_conditions(node("{at_start: (a), over_all: [(b)], at_end: {not: (c)}}")) == TimedConditions(
        Holds(("a",)), Holds(("b",)), Not(Holds(("c",)))
    )
    assert read_conditions(node("(a)")) == TimedConditions(Holds(("a",)))
    assert read_conditions(None) == TimedConditions()
    start, end = read_timed_effects(node("{at_start: {not: (free)}, at_end: [(free), {Query: time}]}"))
    assert start == (Set(("free",), Constant(False)),)
    assert end == WrittenEffects((Set(("free",), Constant(True)),), Computed(TIME))
    assert read_timed_effects(node("(a)"))[0] == ()


def test_durations() -> None:
    assert read_duration(node("5")) == (DurationConstraint("=", Constant(5.0)),)
    assert read_duration(node('{Operation: ["/", ["(distance ?a ?b)", (speed)]]}')) == (
        DurationConstraint("=", Arithmetic("/", (ValueOf(("distance", "?a", "?b")), ValueOf(("speed",))))),
    )
    assert read_duration(node('[{"<=": 5}, {">=": (least)}]')) == (
        DurationConstraint("<=", Constant(5.0)),
        DurationConstraint(">=", ValueOf(("least",))),
    )
    assert read_duration(node('{"=": "?n"}')) == (DurationConstraint("=", Constant("?n")),)
    assert read_duration(node("[]")) == ()


def test_typed_lists() -> None:
    assert read_typed(node('"?a ?b - t ?c"')) == (Variable("?a", ("t",)), Variable("?b", ("t",)), Variable("?c"))
    assert read_typed(node("[a, '?b - t', -]".replace(", -", ", null"))) == (Variable("?a"), Variable("?b", ("t",)))
    assert read_names(node("[r1 r2 - robot, kitchen - (either place room)]")) == {
        "r1": ("robot",),
        "r2": ("robot",),
        "kitchen": ("place", "room"),
    }


ONE, TWO = (Variable("?x"),), (Variable("?x"), Variable("?y"))
KNOWN = DomainModel(
    "d",
    {"robot": (), "place": ()},
    {"r1": ("robot",), "kitchen": ("place",)},
    {"at": Declaration("at", TWO)},
    {"battery": Declaration("battery", ONE)},
)
SCOPE = FormulaScope(ProblemModel("p", KNOWN), {"?robot": ("robot",), "?to": ("place",)})
BAD_INPUT = Path(__file__).with_name("refused")
READERS: dict[str, Callable[..., object]] = {
    "condition": read_condition,
    "data": read_data,
    "duration": read_duration,
    "effects": read_effects,
    "expression": read_expression,
    "operation": read_operation,
    "typed": read_typed,
}
"""Who reads the cases of a file, by its name."""


@pytest.mark.parametrize(
    ("file", "text", "message", "scope"),
    [
        pytest.param(*case.values, scope, id=f"{folder}: {case.id}")
        for folder, scope in (("shapes", ANYTHING), ("names", SCOPE))
        for case in refused_by_file(BAD_INPUT / folder)
    ],
)
def test_what_is_wrong_is_said_with_its_place_and_the_nearest_word(file: str, text: str, message: str, scope: FormulaScope) -> None:
    with pytest.raises(InputError) as caught:
        READERS[file](node(text), scope)
    assert str(caught.value).startswith(message), str(caught.value)


def test_names_are_checked_inside_of_quantifiers_as_well() -> None:
    read_condition(node('{exists: {variables: "?p - place", condition: "(at ?robot ?p)"}}'), SCOPE)
    with pytest.raises(InputError, match=r"there is no parameter '\?q' here"):
        read_condition(node('{exists: {variables: "?p - place", condition: "(at ?robot ?q)"}}'), SCOPE)


def test_texts_beside_variables_need_not_be_objects() -> None:
    assert read_condition(node("{Comparison: [eq, [{Query: mood}, happy]]}"), SCOPE) == Computed(
        Operation("eq", (q("mood", Layer.ALL), lit("happy")))
    )
    assert read_condition(node('{Comparison: [eq, ["?to", anywhere]]}'), SCOPE) == Compare("=", Constant("?to"), Constant("anywhere"))
