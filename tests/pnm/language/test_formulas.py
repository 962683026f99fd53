"""Conditions, effects, values and operations on knowledge: every shape there is, and what is wrong with others."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from pnm.core.logic.computed_values import Compound, Data, KnowledgeOperation, Layer, Literal, Operation, Parameter, Query, Update
from pnm.core.logic.conditions import TRUE, All, Any, Compare, Computed, Condition, Exists, ForAll, Holds, Implies, Not
from pnm.core.logic.domain import Declaration, DomainModel, DurationConstraint, ProblemModel
from pnm.core.logic.effects import ForEach, Set, When
from pnm.core.logic.expressions import DURATION, Arithmetic, Constant, ValueOf, Variable
from pnm.errors import InputError
from pnm.files.yaml_nodes import Node, parse_yaml
from pnm.language.formulas.conditions import FALSE, read_condition, read_expression
from pnm.language.formulas.effects import TimedConditions, WrittenEffects, read_conditions, read_duration, read_effects, read_timed_effects
from pnm.language.formulas.scope import FormulaScope, read_names, read_typed
from pnm.language.formulas.values import read_data, read_operation
from tests.support.refusals import refused_by_file


def node(text: str) -> Node:
    found = parse_yaml(f"x: {text}", "F")[0].node("x")
    assert found is not None
    return found


def q(name: str, layer: Layer = Layer.LOCAL) -> Query:
    return Query(Literal.of(name), layer)


def lit(value: object) -> Literal:
    return Literal.of(value)


TIME, VALUE = q("time", Layer.ALL), q("value", Layer.ALL)
BATTERY = ValueOf(("battery", "?r"))

CONDITIONS: list[tuple[str, Condition]] = [
    # as the original has them
    ("{Exists: [Query: time]}", Computed(Operation("exists", (TIME,)))),
    ("{Exists: {Query: time}}", Computed(Operation("exists", (TIME,)))),
    ("{and: {Exists: [LocalQuery: result]}}", Computed(Operation("exists", (q("result"),)))),
    ("{and: [{Exists: [LocalQuery: value]}]}", Computed(Operation("exists", (q("value"),)))),
    ('{Comparison: ["eq", [Query: time, Query: value]]}', Computed(Operation("eq", (TIME, VALUE)))),
    ('{not: {Comparison: ["ne", [Query: time, Query: value]]}}', Not(Computed(Operation("ne", (TIME, VALUE))))),
    ("{not: [{Query: time}]}", Not(Computed(TIME))),
    ('{Comparison: ["ne", [LocalQuery: value, 10]]}', Computed(Operation("ne", (q("value"), lit(10))))),
    ('[Comparison: ["eq", [LocalQuery: running, true]]]', Computed(Operation("eq", (q("running"), lit(True))))),
    ("{Operation: [truth, {Query: time}]}", Computed(Operation("truth", (TIME,)))),
    ("{Operation: [contains, [{LocalQuery: all}, 3]]}", Computed(Operation("contains", (q("all"), lit(3))))),
    ('{Comparison: ["contains", [{LocalQuery: all}, {LocalQuery: x}]]}', Computed(Operation("contains", (q("all"), q("x"))))),
    ("{LocalQuery: running}", Computed(q("running"))),
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
    ("{or: []}", FALSE),
    ("{}", TRUE),
    # what the original breaks at
    ("{and: [{Query: time}, {Query: value}, {LocalQuery: x}]}", All((Computed(TIME), Computed(VALUE), Computed(q("x"))))),
    (
        "{Comparison: [gt, [{Operation: [add, [{Query: time}, 1]]}, 400]]}",
        Computed(Operation("gt", (Operation("add", (TIME, lit(1))), lit(400)))),
    ),
    ("true", TRUE),
    ("false", FALSE),
    # words begin with a small or a capital letter, operators are names or symbols
    ("{query: time}", Computed(TIME)),
    ("{And: [{Query: time}, {Not: {Query: value}}]}", All((Computed(TIME), Not(Computed(VALUE))))),
    ('{comparison: ["<", [{Query: time}, 3]]}', Computed(Operation("lt", (TIME, lit(3))))),
    ('{Operation: ["<", [{Query: time}, 3]]}', Computed(Operation("lt", (TIME, lit(3))))),
    # facts
    ('"(at ?r kitchen)"', Holds(("at", "?r", "kitchen"))),
    ("(handempty)", Holds(("handempty",))),
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
    ("2.5", lit(2.5)),
    ("yes", lit(True)),
    ("null", lit(None)),
    ("hello there", lit("hello there")),
    ('"?x"', Parameter("?x")),
    ('"? or what"', lit("? or what")),
    ('"(battery ?r)"', BATTERY),
    ('"(really) now"', lit("(really) now")),
    ('{Literal: "?x"}', lit("?x")),
    ("{Literal: {Query: time}}", lit({"Query": "time"})),
    ("[1, two, [3]]", lit([1, "two", [3]])),
    ("{b: 1, a: [2]}", lit({"a": [2], "b": 1})),
    ("[1, {Query: time}]", Compound((lit(1), TIME))),
    ("{status: end, value: {LocalQuery: score}}", Compound((lit("end"), q("score")), ("status", "value"))),
    ("{Operation: [sub, [{Query: value}, 1]]}", Operation("sub", (VALUE, lit(1)))),
    ('{Operation: ["-", [{Query: value}]]}', Operation("neg", (VALUE,))),
    ('{Operation: ["+", [1, {Query: value}, 3]]}', Operation("add", (Operation("add", (lit(1), VALUE)), lit(3)))),
    ("{Operation: [add, [{Operation: [add, [{Query: value}, 1]]}, 1]]}", Operation("add", (Operation("add", (VALUE, lit(1))), lit(1)))),
    (
        "{or: [{Comparison: [eq, [{Query: value}, 1]]}, {not: {Query: time}}]}",
        Operation("or", (Operation("eq", (VALUE, lit(1))), Operation("not", (TIME,)))),
    ),
    ("{imply: [{Query: value}, {Query: time}]}", Operation("or", (Operation("not", (VALUE,)), TIME))),
    ("{value: 5}", lit({"value": 5})),
    ("{query: time}", lit({"query": "time"})),
    ("{localQuery: time}", q("time")),
    ("{Exists: {Query: value}}", Operation("exists", (VALUE,))),
    ("{PersonQuery: [name, {text: your name}]}", Query(lit("name"), Layer.PERSON, lit({"text": "your name"}))),
]


@pytest.mark.parametrize(("text", "expected"), VALUES, ids=[text for text, _ in VALUES])
def test_values(text: str, expected: Data) -> None:
    assert read_data(node(text)) == expected


OPERATIONS: list[tuple[str, KnowledgeOperation]] = [
    ('{LocalUpdate: [value, {LocalQuery: result}, ""]}', Update(lit("value"), q("result"), Layer.LOCAL, lit(""))),
    ("{LocalUpdate: [value, 3]}", Update(lit("value"), lit(3))),
    ("{Update: [value, null]}", Update(lit("value"), lit(None), Layer.ALL)),
    (
        '{RemoteUpdate: [CONTROLLER, "", {status: end, return_value: {LocalQuery: score}}]}',
        Update(lit("CONTROLLER"), lit(""), Layer.GLOBAL, Compound((lit("end"), q("score")), ("status", "return_value"))),
    ),
    ("{PersonUpdate: [said, hello]}", Update(lit("said"), lit("hello"), Layer.PERSON)),
    ("{LocalUpdate: [{LocalQuery: key}, 1]}", Update(q("key"), lit(1))),
    ('{RemoteQuery: ["CONTROLLER", ""]}', Query(lit("CONTROLLER"), Layer.GLOBAL, lit(""))),
    ("{Operation: [setitem, [{LocalQuery: d}, k, 1]]}", Operation("setitem", (q("d"), lit("k"), lit(1)))),
    ("{Operation: [delitem, [{LocalQuery: d}, k]]}", Operation("delitem", (q("d"), lit("k")))),
    ("{Operation: [truth, {LocalQuery: d}]}", Operation("truth", (q("d"),))),
]


@pytest.mark.parametrize(("text", "expected"), OPERATIONS, ids=[text for text, _ in OPERATIONS])
def test_operations_on_knowledge(text: str, expected: KnowledgeOperation) -> None:
    assert read_operation(node(text)) == expected


def test_a_question_that_is_found_by_asking_others() -> None:
    """The shape of the longest query that the original ships: find a class, list its members, ask which one is meant."""
    text = "{RemoteQuery: [{RemoteQuery: [{RemoteQuery: [{LocalQuery: place}, {type: class}]}, {use_name: true}]}, {status: which}]}"
    found = Query(q("place"), Layer.GLOBAL, lit({"type": "class"}))
    listed = Query(found, Layer.GLOBAL, lit({"use_name": True}))
    assert read_data(node(text)) == Query(listed, Layer.GLOBAL, lit({"status": "which"}))


AT = Set(("at", "?r", "b"), Constant(True))
EFFECTS: list[tuple[str, WrittenEffects]] = [
    ('"(at ?r b)"', WrittenEffects((AT,))),
    ('{Holds: "(at ?r b)"}', WrittenEffects((AT,))),
    ('["(at ?r b)", {not: "(at ?r a)"}]', WrittenEffects((AT, Set(("at", "?r", "a"), Constant(False))))),
    ("{and: [{not: {Holds: (a)}}, [{and: {Holds: (b)}}]]}", WrittenEffects((Set(("a",), Constant(False)), Set(("b",), Constant(True))))),
    ("{increase: [(cost), 5]}", WrittenEffects((Set(("cost",), Constant(5.0), "increase"),))),
    ("{scale_up: [(cost), (rate)]}", WrittenEffects((Set(("cost",), ValueOf(("rate",)), "scale-up"),))),
    ("{scale-down: [(cost), 2]}", WrittenEffects((Set(("cost",), Constant(2.0), "scale-down"),))),
    ('{assign: ["(place ?r)", "?to"]}', WrittenEffects((Set(("place", "?r"), Constant("?to")),))),
    ("{assign: [(place), kitchen]}", WrittenEffects((Set(("place",), Constant("kitchen")),))),
    ("{decrease: [(fuel), '?n']}", WrittenEffects((Set(("fuel",), Constant("?n"), "decrease"),))),
    ("{when: {condition: (a), effects: [(b)]}}", WrittenEffects((When(Holds(("a",)), (Set(("b",), Constant(True)),)),))),
    ("{when: {at_start: (a), effects: (b)}}", WrittenEffects((When(Holds(("a",)), (Set(("b",), Constant(True)),), early=True),))),
    (
        '{forall: {variables: "?x - t", effects: {not: "(p ?x)"}}}',
        WrittenEffects((ForEach((Variable("?x", ("t",)),), (Set(("p", "?x"), Constant(False)),)),)),
    ),
    ("{and: {Exists: [LocalQuery: result]}}", WrittenEffects((), Computed(Operation("exists", (q("result"),))))),
    (
        '[Comparison: ["eq", [Query: time, Query: value]], {not: {Comparison: ["ne", [Query: time, Query: value]]}}]',
        WrittenEffects((), All((Computed(Operation("eq", (TIME, VALUE))), Not(Computed(Operation("ne", (TIME, VALUE))))))),
    ),
    ("[(done), {LocalQuery: success}]", WrittenEffects((Set(("done",), Constant(True)),), Computed(q("success")))),
    (
        '{forall: {variables: "?x", condition: "(clean ?x)"}}',
        WrittenEffects((), ForAll((Variable("?x"),), Holds(("clean", "?x")))),
    ),
    ("{}", WrittenEffects()),
    ("[]", WrittenEffects()),
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


@pytest.mark.parametrize(("file", "text", "message"), refused_by_file(BAD_INPUT / "formulas"))
def test_what_is_wrong_is_said_with_its_place_and_the_nearest_word(file: str, text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        READERS[file](node(text))
    assert str(caught.value).startswith(message), str(caught.value)


@pytest.mark.parametrize(("file", "text", "message"), refused_by_file(BAD_INPUT / "names"))
def test_names_that_are_not_there(file: str, text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        READERS[file](node(text), SCOPE)
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
