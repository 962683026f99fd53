"""Conditions, values, operations, effects and typed lists: every shape there is; and formulas that are wrong."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from pnm.core.logic.computed_values import Compound, Data, KnowledgeOperation, Layer, Operation, Parameter, Query, Update
from pnm.core.logic.conditions import TRUE, All, Any, Compare, Computed, Condition, Exists, ForAll, Holds, Implies, Not
from pnm.core.logic.domain import Declaration, DomainModel, ProblemModel
from pnm.core.logic.effects import Alternative, ForEach, OneOf, Set, When
from pnm.core.logic.expressions import DURATION, Arithmetic, Constant, ValueOf, Variable
from pnm.errors import InputError
from pnm.language.formulas.readers import FALSE, WrittenEffects, read_condition, read_duration, read_effects, read_expression
from pnm.language.formulas.scope import ANYTHING, FormulaScope, read_names, read_typed
from pnm.language.formulas.words import read_data, read_operation
from tests.support.files import refused_by_file
from tests.support.yaml.formulas import lit, node, q

TIME, VALUE = q("time", Layer.ALL), q("value", Layer.ALL)
BATTERY = ValueOf(("battery", "?r"))
CONDITIONS: list[tuple[str, Condition]] = [
    # as the original has them
    ("{Exists: [Query: time]}", Computed(Operation("exists", (TIME,)))),
    ("{and: {Exists: [LocalQuery: result]}}", Computed(Operation("exists", (q("result"),)))),
    ('{Comparison: ["eq", [Query: time, Query: value]]}', Computed(Operation("eq", (TIME, VALUE)))),
    ("{not: [{Query: time}]}", Not(Computed(TIME))),
    ('[Comparison: ["eq", [LocalQuery: running, true]]]', Computed(Operation("eq", (q("running"), lit(True))))),
    ("{Operation: [truth, {Query: time}]}", Computed(Operation("truth", (TIME,)))),
    ('{Comparison: ["contains", [{LocalQuery: all}, {LocalQuery: x}]]}', Computed(Operation("contains", (q("all"), q("x"))))),
    ("{RemoteQuery: [running, {kind: all}]}", Computed(Query(lit("running"), Layer.GLOBAL, lit({"kind": "all"})))),
    ('{Comparison: [eq, [{LocalQuery: {LocalQuery: "_k"}}, true]]}', Computed(Operation("eq", (Query(q("_k"), Layer.LOCAL), lit(True))))),
    (
        '{LocalQuery: {Operation: [concat, ["p__", {LocalQuery: x}]]}}',
        Computed(Query(Operation("concat", (lit("p__"), q("x"))), Layer.LOCAL)),
    ),
    ("{BooleanAssertion: [{Query: time}, false]}", Computed(Operation("eq", (TIME, lit(False))))),
    ("{LogicalAnd: [{Query: time}, {Query: value}]}", All((Computed(TIME), Computed(VALUE)))),
    ("{LogicalOr: [{Query: time}]}", Any((Computed(TIME),))),
    ("{LogicalNot: {Query: time}}", Not(Computed(TIME))),
    ("{and: []}", TRUE),
    ("{}", TRUE),
    # what the original breaks at
    (
        "{Comparison: [gt, [{Operation: [add, [{Query: time}, 1]]}, 400]]}",
        Computed(Operation("gt", (Operation("add", (TIME, lit(1))), lit(400)))),
    ),
    ("true", TRUE),
    ("false", FALSE),
    # words begin with a small or a capital letter, operators are names or symbols
    ("{query: time}", Computed(TIME)),
    ("{And: [{Query: time}, {Not: {Query: value}}]}", All((Computed(TIME), Not(Computed(VALUE))))),
    ('{Operation: ["<", [{Query: time}, 3]]}', Computed(Operation("lt", (TIME, lit(3))))),
    # facts
    ('"(at ?r kitchen)"', Holds(("at", "?r", "kitchen"))),
    ('{Holds: "(at ?r kitchen)"}', Holds(("at", "?r", "kitchen"))),
    ('{not: "( at  ?r kitchen )"}', Not(Holds(("at", "?r", "kitchen")))),
    ("[(a), (b), {and: [(c)]}]", All((Holds(("a",)), Holds(("b",)), Holds(("c",))))),
    ("{imply: [(a), {or: [(b), {Query: time}]}]}", Implies(Holds(("a",)), Any((Holds(("b",)), Computed(TIME))))),
    (
        '{forall: {variables: "?x ?y - block ?z - (either a b)", condition: "(on ?x ?y)"}}',
        ForAll((Variable("?x", ("block",)), Variable("?y", ("block",)), Variable("?z", ("a", "b"))), Holds(("on", "?x", "?y"))),
    ),
    ('{exists: {variables: [x - block, "?y"], condition: (a)}}', Exists((Variable("?x", ("block",)), Variable("?y")), Holds(("a",)))),
    # numbers and objects
    ('{Comparison: ["<", ["(battery ?r)", 20]]}', Compare("<", BATTERY, Constant(20.0))),
    ('{Comparison: [ge, [{Value: "(battery ?r)"}, "(least)"]]}', Compare(">=", BATTERY, ValueOf(("least",)))),
    (
        '{Comparison: [">", ["(battery ?r)", {Operation: ["*", [2, (rate), 3]]}]]}',
        Compare(">", BATTERY, Arithmetic("*", (Constant(2.0), ValueOf(("rate",)), Constant(3.0)))),
    ),
    ('{Comparison: ["<=", [{Operation: ["-", [(rate)]]}, 1e3]]}', Compare("<=", Arithmetic("-", (ValueOf(("rate",)),)), Constant(1000.0))),
    ('{Comparison: ["=", ["?a", "?b"]]}', Compare("=", Constant("?a"), Constant("?b"))),
    ('{Comparison: [ne, ["(place ?r)", kitchen]]}', Not(Compare("=", ValueOf(("place", "?r")), Constant("kitchen")))),
    ('{Comparison: [">=", ["?duration", 2]]}', Compare(">=", ValueOf(DURATION), Constant(2.0))),
    # parameters are not counted with by PDDL
    ('{Comparison: ["<", ["(battery ?r)", "?least"]]}', Computed(Operation("lt", (BATTERY, Parameter("?least"))))),
    ('{Comparison: [eq, ["?n", 3]]}', Computed(Operation("eq", (Parameter("?n"), lit(3))))),
    (
        '{Comparison: [eq, [(f), {Operation: [add, ["?n", 1]]}]]}',
        Computed(Operation("eq", (ValueOf(("f",)), Operation("add", (Parameter("?n"), lit(1)))))),
    ),
    ("{Comparison: [eq, [(open), true]]}", Computed(Operation("eq", (Operation("truth", (ValueOf(("open",)),)), lit(True))))),
    ('"?urgent"', Computed(Parameter("?urgent"))),
    ('{Comparison: [eq, [{Query: time}, "(battery ?r)"]]}', Computed(Operation("eq", (TIME, BATTERY)))),
    ('{Comparison: [eq, [{Query: time}, {Literal: "(battery ?r)"}]]}', Computed(Operation("eq", (TIME, lit("(battery ?r)"))))),
]


@pytest.mark.parametrize(("text", "expected"), CONDITIONS, ids=[text for text, _ in CONDITIONS])
def test_conditions(text: str, expected: Condition) -> None:
    assert read_condition(node(text)) == expected


VALUES: list[tuple[str, Data]] = [
    ("3", lit(3)),
    ("yes", lit("yes")),
    ("null", lit(None)),
    ('"?x"', Parameter("?x")),
    ('"? or what"', lit("? or what")),
    ('"(battery ?r)"', BATTERY),
    ('"(really) now"', lit("(really) now")),
    ("{Literal: {Query: time}}", lit({"Query": "time"})),
    ("[1, two, [3]]", lit([1, "two", [3]])),
    ("{b: 1, a: [2]}", lit({"a": [2], "b": 1})),
    ("[1, {Query: time}]", Compound((lit(1), TIME))),
    ("{status: end, value: {LocalQuery: score}}", Compound((lit("end"), q("score")), ("status", "value"))),
    ('{Operation: ["-", [{Query: value}]]}', Operation("neg", (VALUE,))),
    ('{Operation: ["+", [1, {Query: value}, 3]]}', Operation("add", (Operation("add", (lit(1), VALUE)), lit(3)))),
    (
        "{or: [{Comparison: [eq, [{Query: value}, 1]]}, {not: {Query: time}}]}",
        Operation("or", (Operation("eq", (VALUE, lit(1))), Operation("not", (TIME,)))),
    ),
    ("{imply: [{Query: value}, {Query: time}]}", Operation("or", (Operation("not", (VALUE,)), TIME))),
    ("{value: 5}", lit({"value": 5})),
    ("{localQuery: time}", q("time")),
    ("{PersonQuery: [name, {text: your name}]}", Query(lit("name"), Layer.PERSON, lit({"text": "your name"}))),
]


@pytest.mark.parametrize(("text", "expected"), VALUES, ids=[text for text, _ in VALUES])
def test_values(text: str, expected: Data) -> None:
    assert read_data(node(text)) == expected


OPERATIONS: list[tuple[str, KnowledgeOperation]] = [
    ('{LocalUpdate: [value, {LocalQuery: result}, ""]}', Update(lit("value"), q("result"), Layer.LOCAL, lit(""))),
    ("{Update: [value, null]}", Update(lit("value"), lit(None), Layer.ALL)),
    (
        '{RemoteUpdate: [CONTROLLER, "", {status: end, return_value: {LocalQuery: score}}]}',
        Update(lit("CONTROLLER"), lit(""), Layer.GLOBAL, Compound((lit("end"), q("score")), ("status", "return_value"))),
    ),
    ("{PersonUpdate: [said, hello]}", Update(lit("said"), lit("hello"), Layer.PERSON)),
    ("{LocalUpdate: [{LocalQuery: key}, 1]}", Update(q("key"), lit(1))),
    ("{Operation: [setitem, [{LocalQuery: d}, k, 1]]}", Operation("setitem", (q("d"), lit("k"), lit(1)))),
    ("{Operation: [truth, {LocalQuery: d}]}", Operation("truth", (q("d"),))),
]


@pytest.mark.parametrize(("text", "expected"), OPERATIONS, ids=[text for text, _ in OPERATIONS])
def test_operations_on_knowledge(text: str, expected: KnowledgeOperation) -> None:
    assert read_operation(node(text)) == expected


# --- effects and typed lists ---


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
    (
        "{one_of: [{name: ok, chance: 0.75, effects: [(a), {not: (b)}]}, {chance: 0.25}]}",
        WrittenEffects(
            (OneOf((Alternative((Set(("a",), Constant(True)), Set(("b",), Constant(False))), 0.75, "ok"), Alternative((), 0.25))),)
        ),
    ),
    ("{one_of: {effects: (a)}}", WrittenEffects((OneOf((Alternative((Set(("a",), Constant(True)),)),)),))),
    ("{}", WrittenEffects()),
]


@pytest.mark.parametrize(("text", "expected"), EFFECTS, ids=[text for text, _ in EFFECTS])
def test_effects(text: str, expected: WrittenEffects) -> None:
    assert read_effects(node(text)) == expected


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
