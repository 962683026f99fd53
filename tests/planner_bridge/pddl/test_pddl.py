"""PDDL: every refusal with its position, then what is read, then the law of writing and reading back."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import kairos
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from planner_bridge.model.problem import Domain, Metric, Problem
from planner_bridge.pddl import parse_domain, parse_problem, read_domain, read_problem
from planner_bridge.pddl.read.symbols import CONSTRAINTS
from planner_bridge.pddl.syntax.expressions import MAX_DEPTH
from planner_bridge.pddl.syntax.words import TIME_SPECIFIERS, number_text
from planner_bridge.pddl.write.writer import write_domain, write_problem
from pnm.core.logic.conditions import TRUE, All, Any, Compare, Condition, Exists, ForAll, Holds, Implies, Not, conjuncts
from pnm.core.logic.domain import ActionSchema, Declaration, DurationConstraint, Preference
from pnm.core.logic.effects import OPERATIONS, Effect, ForEach, Set, TimedChange, When
from pnm.core.logic.expressions import DURATION, UNDEFINED, Arithmetic, Constant, Expression, Fluent, ValueOf, Variable
from pnm.core.logic.rules import Rule
from pnm.core.logic.trajectory import Constraint
from pnm.errors import InputError
from tests.support.files import SHARED
from tests.support.refusals import refused

BAD_INPUT = Path(__file__).with_name("refused")

PAIRS = SHARED / "pddl"

DECLARED = (
    "(define (domain d) (:types robot room - thing) (:constants hall - room)"
    " (:predicates (at ?r - robot ?l - room) (idle)) (:functions (charge ?r - robot) (total-cost))"
)
"""One line, so that what a test adds stands in line 2."""
PROBLEM = "(define (problem p) (:domain d) (:objects r2 - robot kitchen - room)"


def domain_with(text: str) -> Domain:
    return parse_domain(f"{DECLARED}\n{text})")


def problem_with(text: str) -> Problem:
    return parse_problem(f"{PROBLEM}\n{text})", domain_with(""))


def action(parts: str) -> ActionSchema:
    return domain_with(f"(:action a {parts})").actions["a"]


def durative(parts: str) -> ActionSchema:
    return domain_with(f"(:durative-action a {parts})").actions["a"]


# --- refusals: the definition --------------------------------------------------------------

WHOLE = [
    *refused(BAD_INPUT / "whole.pddl"),
    ("", "1:1: the file is empty; expected (define (domain NAME) ...)"),
    ("(" * 20_000, f"1:{MAX_DEPTH + 1}: nested deeper than {MAX_DEPTH} lists"),
]


@pytest.mark.parametrize(("text", "message"), WHOLE)
def test_a_text_that_is_no_domain_is_refused(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_domain(text)
    assert str(caught.value) == f"domain.pddl:{message}"


BAD_DOMAINS = refused(*(BAD_INPUT / name for name in ("not_supported.pddl", "declarations.pddl", "actions.pddl")))


@pytest.mark.parametrize(("text", "message"), BAD_DOMAINS)
def test_a_bad_domain_is_refused(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        domain_with(text)
    assert str(caught.value) == f"domain.pddl:{message}"


@pytest.mark.parametrize(("text", "message"), refused(BAD_INPUT / "problems.pddl"))
def test_a_bad_problem_is_refused(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        problem_with(text)
    assert str(caught.value) == f"problem.pddl:{message}"


def test_a_domain_is_no_problem() -> None:
    with pytest.raises(InputError, match=r"1:9: expected \(problem NAME\), found \(domain \.\.\.\); this file is not a problem"):
        parse_problem("(define (domain d))", domain_with(""))


def test_files_that_cannot_be_read_are_refused_at_their_beginning(tmp_path: Path) -> None:
    (tmp_path / "empty").write_text("")
    (tmp_path / "zeros").write_bytes(b"(define\0)")
    (tmp_path / "bytes").write_bytes(b"(define (domain d) (:types \xff))")
    (tmp_path / "sixteen").write_bytes(b"\xff\xfe(")
    (tmp_path / "zeros16").write_bytes("(define\0)".encode("utf-16"))
    for name, message in {
        "missing": "1:1: cannot be read: No such file or directory",
        "": "1:1: cannot be read: it is not a regular file",
        "empty": "1:1: the file is empty; expected (define (domain NAME) ...)",
        "zeros": "1:1: not a text file: it contains zero bytes",
        "bytes": "1:28: '\u00ff' cannot name a type; expected letters, digits and _ - . @",
        "sixteen": "1:1: not a text file: it begins as UTF-16 does and is none",
        "zeros16": "1:1: not a text file: it contains zero characters",
    }.items():
        with pytest.raises(InputError) as caught:
            read_domain(tmp_path / name)
        assert str(caught.value) == f"{tmp_path / name}:{message}"


# --- what is read: declarations ------------------------------------------------------------


def test_an_empty_domain_is_read() -> None:
    assert parse_domain("(define (domain d))") == Domain("d")
    assert parse_domain("(define (domain d) (:types) (:constants) (:predicates) (:functions))") == Domain("d")


def test_types_have_parents() -> None:
    domain = parse_domain("(define (domain d) (:types a b - c d - (either c e) a - e a f - object))")
    assert domain.types == {"a": ("c", "e"), "b": ("c",), "c": (), "d": ("c", "e"), "e": (), "f": ()}
    assert list(domain.types) == ["a", "b", "c", "d", "e", "f"]
    assert domain.supertypes("d") == {"object", "c", "e", "d"}


def test_sections_stand_in_any_order() -> None:
    text = "(:action a :parameters (?x - t) :effect (p ?x c)) (:functions (f ?x - t))"
    text += " (:predicates (p ?x ?y - t)) (:constants c - t) (:types t)"
    domain = parse_domain(f"(define (domain d) {text})")
    assert domain.actions["a"].end_effects == (Set(("p", "?x", "c"), Constant(True)),)


@pytest.mark.parametrize("suffix", ["", " - number", " -number", " - Number"])
def test_functions_are_numbers(suffix: str) -> None:
    domain = parse_domain(f"(define (domain d) (:functions (f ?x){suffix} (g)))")
    assert domain.functions == {"f": Declaration("f", (Variable("?x"),)), "g": Declaration("g")}


def test_names_may_clash_begin_with_digits_and_repeat_parameters() -> None:
    domain = parse_domain(
        "(define (domain a) (:types a 2d) (:constants a - a 3x - 2d) (:predicates (a ?a ?a - a) (4p ?5 - 2d))"
        " (:action a :parameters (?a - a) :precondition (and (a ?a a) (4p 3x))))"
    )
    assert domain.actions["a"].precondition == All((Holds(("a", "?a", "a")), Holds(("4p", "3x"))))
    assert [variable.name for variable in domain.predicates["a"].parameters] == ["?a", "?a"]


def test_typed_lists_need_no_spaces() -> None:
    assert domain_with("(:action a :parameters (?a -robot?b - room?c))").actions["a"].parameters == (
        Variable("?a", ("robot",)),
        Variable("?b", ("room",)),
        Variable("?c"),
    )


def test_requirements_are_kept_known_or_not() -> None:
    assert parse_domain("(define (domain d) (:requirements :STRIPS :foo bar :strips))").requirements == (":strips", ":foo", ":bar")


def test_names_are_spelled_as_first_declared() -> None:
    domain = parse_domain(
        "(DEFINE (DOMAIN D) (:Types Robot ROBOT - Thing thing) (:CONSTANTS Jack - ROBOT jack - robot)"
        " (:Predicates (Busy ?R - robot)) (:Functions (F))"
        " (:ACTION Go :Parameters (?Robot - rObOt) :Precondition (AND (busy ?ROBOT) (NOT (BUSY JACK))) :EFFECT (Increase (f) 1)))"
    )
    assert domain.types == {"Robot": ("Thing",), "Thing": ()}
    go = domain.actions["Go"]
    assert go.parameters == (Variable("?Robot", ("Robot",)),)
    assert go.precondition == All((Holds(("Busy", "?Robot")), Not(Holds(("Busy", "Jack")))))
    assert go.end_effects == (Set(("F",), Constant(1.0), "increase"),)
    problem = parse_problem("(define (problem P) (:objects JACK Jill - robot) (:init (BUSY jack) (= F 2)) (:GOAL (busy JILL)))", domain)
    assert problem.own_objects == {"Jill": ("Robot",)}
    assert problem.init == {("Busy", "Jack"): True, ("F",): 2.0}
    assert problem.goal == Holds(("Busy", "Jill"))


def test_an_inner_variable_hides_an_outer_one_of_another_spelling() -> None:
    schema = action("(:parameters (?X - robot) :precondition (and (at ?x hall) (exists (?x - robot) (at ?X hall))))"[1:-1])
    assert schema.precondition == All((Holds(("at", "?X", "hall")), Exists((Variable("?x", ("robot",)),), Holds(("at", "?x", "hall")))))


@pytest.mark.parametrize("kind", ["object", "thing", "robot", "(either robot room)", "little"])
def test_a_variable_is_accepted_where_its_type_could_match(kind: str) -> None:
    text = f"(:types little - robot) (:action a :parameters (?r - {kind}) :precondition (at ?r hall))"
    assert domain_with(text).actions["a"].precondition == Holds(("at", "?r", "hall"))


def test_an_object_of_either_type_is_accepted_for_both() -> None:
    problem = problem_with("(:objects both - (either robot room)) (:goal (at both both))")
    assert problem.goal == Holds(("at", "both", "both"))
    assert problem.objects_by_type["robot"] == ("r2", "both")


# --- what is read: actions -----------------------------------------------------------------


@pytest.mark.parametrize("parts", ["", ":parameters () :precondition () :effect ()", ":effect (and) :precondition (and (and))"])
def test_parts_of_an_action_may_be_empty_or_missing(parts: str) -> None:
    assert action(parts) == ActionSchema("a")


IDLE = Holds(("idle",))
CHARGE = ValueOf(("charge", "?r"))


@pytest.mark.parametrize(
    ("text", "condition"),
    [
        ("(idle)", IDLE),
        ("(and (idle))", IDLE),
        ("(and (idle) (and (idle) (idle)))", All((IDLE, IDLE, IDLE))),
        ("(or (idle) (not (idle)))", Any((IDLE, Not(IDLE)))),
        ("(or)", Any(())),
        ("(imply (idle) ())", Implies(IDLE, TRUE)),
        ("(forall (?l - room) (at ?r ?l))", ForAll((Variable("?l", ("room",)),), Holds(("at", "?r", "?l")))),
        ("(exists (?l - room) (at ?r ?l))", Exists((Variable("?l", ("room",)),), Holds(("at", "?r", "?l")))),
        ("(= ?r hall)", Compare("=", Constant("?r"), Constant("hall"))),
        ("(= (charge ?r) 3)", Compare("=", CHARGE, Constant(3.0))),
        ("(= total-cost total-cost)", Compare("=", ValueOf(("total-cost",)), ValueOf(("total-cost",)))),
        ("(>= (charge ?r) -.5e1)", Compare(">=", CHARGE, Constant(-5.0))),
        (
            "(< (+ 1 2 (charge ?r)) (- (* 2 3 4) (/ 1 (- 2))))",
            Compare(
                "<",
                Arithmetic("+", (Constant(1.0), Constant(2.0), CHARGE)),
                Arithmetic(
                    "-",
                    (
                        Arithmetic("*", (Constant(2.0), Constant(3.0), Constant(4.0))),
                        Arithmetic("/", (Constant(1.0), Arithmetic("-", (Constant(2.0),)))),
                    ),
                ),
            ),
        ),
    ],
)
def test_conditions(text: str, condition: Condition) -> None:
    assert action(f":parameters (?r - robot) :precondition {text}").precondition == condition


SET_IDLE = Set(("idle",), Constant(True))
NOT_IDLE = Set(("idle",), Constant(False))


@pytest.mark.parametrize(
    ("text", "effects"),
    [
        ("(idle)", (SET_IDLE,)),
        ("(and (idle) (and (not (idle))))", (SET_IDLE, NOT_IDLE)),
        ("(when (idle) (and (not (idle)) (idle)))", (When(IDLE, (NOT_IDLE, SET_IDLE)),)),
        ("(forall (?l - room) (not (at ?r ?l)))", (ForEach((Variable("?l", ("room",)),), (Set(("at", "?r", "?l"), Constant(False)),)),)),
        *((f"({name} (charge ?r) 2)", (Set(("charge", "?r"), Constant(2.0), name),)) for name in OPERATIONS),
    ],
)
def test_effects(text: str, effects: tuple[Effect, ...]) -> None:
    assert action(f":parameters (?r - robot) :effect {text}").end_effects == effects


@pytest.mark.parametrize(
    ("text", "constraints"),
    [
        ("()", ()),
        ("(and)", ()),
        ("(= ?duration 3)", (DurationConstraint("=", Constant(3.0)),)),
        ("(at start (= ?DURATION 3))", (DurationConstraint("=", Constant(3.0)),)),
        (
            "(and (<= ?duration 3) (at start (>= ?duration (charge ?r))))",
            (DurationConstraint("<=", Constant(3.0)), DurationConstraint(">=", CHARGE)),
        ),
    ],
)
def test_durations(text: str, constraints: tuple[DurationConstraint, ...]) -> None:
    assert durative(f":parameters (?r - robot) :duration {text}").duration == constraints


def test_timed_conditions_go_to_their_moments() -> None:
    at_hall = Holds(("at", "?r", "hall"))
    robots = (Variable("?r", ("robot",)),)
    schema = durative(
        ":duration () :condition (and (at start (and (idle) (idle))) (over all (idle)) (over all (not (idle))) (at end (>= ?duration 1))"
        " (forall (?r - robot) (and (at start (at ?r hall)) (at end (at ?r hall)))))"
    )
    assert schema.precondition == All((IDLE, IDLE, ForAll(robots, at_hall)))
    assert schema.invariant == All((IDLE, Not(IDLE)))
    assert schema.end_condition == All((Compare(">=", ValueOf(DURATION), Constant(1.0)), ForAll(robots, at_hall)))


def test_timed_effects_go_to_their_moments() -> None:
    robots = (Variable("?r", ("robot",)),)
    charged = Set(("charge", "?r"), Arithmetic("*", (Constant(2.0), ValueOf(DURATION))), "increase")
    schema = durative(
        ":duration () :effect (and (at start (not (idle))) (at end (idle)) (at end (when (idle) (idle)))"
        " (when (at start (idle)) (at start (and (idle) (not (idle)))))"
        " (forall (?r - robot) (and (at start (idle)) (at end (increase (charge ?r) (* 2 ?duration)))"
        " (when (at end (idle)) (at end (idle))))))"
    )
    assert schema.start_effects == (NOT_IDLE, When(IDLE, (SET_IDLE, NOT_IDLE)), ForEach(robots, (SET_IDLE,)))
    assert schema.end_effects == (SET_IDLE, When(IDLE, (SET_IDLE,)), ForEach(robots, (charged, When(IDLE, (SET_IDLE,)))))


# --- what is read: problems ----------------------------------------------------------------


def test_a_problem_is_read() -> None:
    problem = problem_with(
        "(:init (at r2 kitchen) (at r2 kitchen) (not (idle)) (= (charge r2) 10) (= total-cost 0)"
        " (at 7 (= (charge r2) -3)) (at 5 (idle)) (at 5.0 (not (at r2 kitchen))))"
        " (:requirements :typing) (:length (:serial 3)) (:metric maximize (- total-time (total-cost))) (:objects r2 - robot) (:goal ())"
    )
    assert problem == Problem(
        "p",
        domain_with(""),
        {"r2": ("robot",), "kitchen": ("room",)},
        {("at", "r2", "kitchen"): True, ("charge", "r2"): 10.0, ("total-cost",): 0.0},
        (
            TimedChange(5.0, {("idle",): True, ("at", "r2", "kitchen"): False}),
            TimedChange(7.0, {("charge", "r2"): -3.0}),
        ),
        TRUE,
        Metric("maximize", Arithmetic("-", (ValueOf(("total-time",)), ValueOf(("total-cost",))))),
        requirements=(":typing",),
    )


def test_at_is_an_ordinary_predicate_too() -> None:
    domain = parse_domain("(define (domain d) (:predicates (at ?x ?y)))")
    problem = parse_problem("(define (problem p) (:objects 1st b) (:init (at 1st b) (at 1 (at b b))) (:goal (at b 1st)))", domain)
    assert problem.init == {("at", "1st", "b"): True}
    assert problem.timed == (TimedChange(1.0, {("at", "b", "b"): True}),)


@pytest.mark.parametrize(
    ("before", "inner", "after"),
    [
        ("(not ", "(p ?x)", ")"),
        ("(or (p ?x) ", "(p ?x)", ")"),
        ("(imply (p ?x) ", "(p ?x)", ")"),
        ("(exists (?y) ", "(p ?x)", ")"),
        ("(< 1 ", "", ")"),
    ],
)
def test_the_deepest_nesting_is_read_and_written(before: str, inner: str, after: str) -> None:
    levels = MAX_DEPTH - 3
    nested = f"(< 1 {'(+ 1 ' * (levels - 1)}1{')' * (levels - 1)})" if not inner else before * levels + inner + after * levels
    domain = parse_domain(f"(define (domain d) (:predicates (p ?x)) (:action a :parameters (?x) :precondition {nested}))")
    assert parse_domain(write_domain(domain)) == domain
    effect = "(when (p ?x) " * levels + "(p ?x)" + ")" * levels
    domain = parse_domain(f"(define (domain d) (:predicates (p ?x)) (:action a :parameters (?x) :effect {effect}))")
    assert parse_domain(write_domain(domain)) == domain


# --- the law: what is written is read as an equal model ------------------------------------

TYPES = {"thing": (), "robot": ("thing",), "room": ("thing",), "dock": ("room", "place"), "place": ()}
KINDS = st.sampled_from([("object",), ("thing",), ("robot",), ("dock",), ("robot", "place")])
NUMBERS = st.one_of(st.integers(-1000, 1000).map(float), st.floats(allow_nan=False, allow_infinity=False))
FUNCTIONS: list[Fluent] = [("charge", "?r"), ("charge", "R1"), ("total-cost",)]
FACTS: list[Fluent] = [("at", "?r", "hall"), ("at", "R1", "hall"), ("idle",)]
OWN = (Variable("?r", ("robot",)), Variable("?Other", ("object",)))


def expressions(duration: bool) -> st.SearchStrategy[Expression]:
    values = st.sampled_from([*FUNCTIONS, *([DURATION] if duration else [])]).map(ValueOf)
    return st.recursive(
        st.one_of(NUMBERS.map(Constant), values),
        lambda inner: st.one_of(
            st.builds(Arithmetic, st.sampled_from("+*"), st.lists(inner, min_size=2, max_size=3).map(tuple)),
            st.builds(Arithmetic, st.just("/"), st.tuples(inner, inner)),
            st.builds(Arithmetic, st.just("-"), st.lists(inner, min_size=1, max_size=2).map(tuple)),
        ),
        max_leaves=4,
    )


def joined(parts: list[Condition]) -> Condition:
    flat = conjuncts(All(tuple(parts)))
    return flat[0] if len(flat) == 1 else All(flat)


VARIABLES = st.lists(st.builds(Variable, st.sampled_from(["?x", "?y", "?z"]), KINDS), max_size=2, unique_by=lambda one: one.name).map(tuple)


def conditions(duration: bool = False) -> st.SearchStrategy[Condition]:
    numbers = st.builds(Compare, st.sampled_from(["=", "<", "<=", ">", ">="]), expressions(duration), expressions(duration))
    terms = st.sampled_from([*map(Constant, ["?r", "?Other", "R1", "hall"]), ValueOf(("home", "?r")), ValueOf(("home", "R1"))])
    return st.recursive(
        st.one_of(st.sampled_from(FACTS).map(Holds), numbers, st.builds(Compare, st.just("="), terms, terms)),
        lambda inner: st.one_of(
            st.lists(inner, max_size=3).map(joined),
            st.builds(Any, st.lists(inner, max_size=3).map(tuple)),
            inner.map(Not),
            st.builds(Implies, inner, inner),
            st.builds(ForAll, VARIABLES, inner),
            st.builds(Exists, VARIABLES, inner),
        ),
        max_leaves=6,
    )


def effects(duration: bool = False) -> st.SearchStrategy[tuple[Effect, ...]]:
    truth = st.builds(Set, st.sampled_from(FACTS), st.booleans().map(Constant))
    numbers = st.builds(Set, st.sampled_from(FUNCTIONS), expressions(duration), st.sampled_from(OPERATIONS))
    places = st.sampled_from([Constant("?Other"), Constant("hall"), ValueOf(("home", "R1")), Constant(UNDEFINED)])
    one = st.recursive(
        st.one_of(truth, numbers, st.builds(Set, st.just(("home", "?r")), places)),
        lambda inner: st.one_of(
            st.builds(When, conditions(duration), st.lists(inner, max_size=2).map(tuple)),
            st.builds(ForEach, VARIABLES, st.lists(inner, max_size=2).map(tuple)),
        ),
        max_leaves=4,
    )
    return st.lists(one, max_size=3).map(tuple)


def early_effects() -> st.SearchStrategy[tuple[Effect, ...]]:
    """Effects at the end on conditions at the start, which are not trivial: a trivial one is written away."""
    real = conditions(duration=True).filter(lambda condition: condition != TRUE)
    inner = effects(duration=True).filter(lambda found: not any(isinstance(one, When) and one.condition == TRUE for one in found))
    early = st.builds(When, real, inner, early=st.just(True))
    around = st.one_of(early, st.builds(ForEach, VARIABLES, st.tuples(early)), st.builds(When, real, st.tuples(early)))
    return st.tuples(effects(duration=True), st.lists(around, max_size=2)).map(lambda both: (*both[0], *both[1]))


def constraints() -> st.SearchStrategy[Constraint]:
    def one(operator: str) -> st.SearchStrategy[Constraint]:
        times, several = CONSTRAINTS.get(operator, (0, 1))
        seconds = st.tuples(*[st.floats(0, 1e9)] * times)
        return st.builds(Constraint, st.just(operator), st.tuples(*[conditions()] * several), seconds, VARIABLES)

    return st.sampled_from([*CONSTRAINTS, "at end"]).flatmap(one)


def over(constraint: Constraint) -> Constraint:
    """The constraint in a place without an action around it."""
    return replace(constraint, variables=(*OWN, *constraint.variables))


PREFERENCES = st.builds(Preference, st.sampled_from(["p", "Q-2", ""]), conditions(), VARIABLES)
WISHES = st.builds(Preference, st.sampled_from(["p", "c", ""]), st.lists(constraints(), max_size=2).map(tuple), st.just(OWN))
RULES = st.builds(Rule, st.sampled_from(["calm", "near"]), st.just(OWN), conditions())

INSTANTANEOUS = st.builds(
    ActionSchema,
    st.just("now"),
    st.just(OWN),
    precondition=conditions(),
    end_effects=effects(),
    preferences=st.lists(PREFERENCES, max_size=2).map(tuple),
)
DURATIVE = st.builds(
    ActionSchema,
    st.just("later"),
    st.just(OWN),
    precondition=conditions(duration=True),
    invariant=conditions(duration=True),
    end_condition=conditions(duration=True),
    start_effects=effects(duration=True),
    end_effects=early_effects(),
    preferences=st.lists(
        st.builds(Preference, st.sampled_from(["p", ""]), conditions(duration=True), VARIABLES, st.sampled_from(TIME_SPECIFIERS)),
        max_size=2,
    ).map(tuple),
    duration=st.lists(st.builds(DurationConstraint, st.sampled_from(["=", "<=", ">="]), expressions(duration=False)), max_size=2).map(
        tuple
    ),
)


def domain_of(actions: list[ActionSchema]) -> Domain:
    return Domain(
        "d",
        TYPES,
        {"R1": ("robot",), "hall": ("dock",), "odd": ("robot", "place")},
        {
            "at": Declaration("at", (Variable("?r", ("robot",)), Variable("?l", ("room", "robot")))),
            "same": Declaration("same", (Variable("?x"), Variable("?x"), Variable("?y", ("dock",)))),
            "idle": Declaration("idle"),
            "calm": Declaration("calm", OWN),
            "near": Declaration("near", OWN),
        },
        {
            "charge": Declaration("charge", (Variable("?r", ("robot",)),)),
            "home": Declaration("home", (Variable("?r", ("robot",)),), ("room", "place")),
            "total-cost": Declaration("total-cost"),
        },
        {one.name: one for one in actions},
        requirements=(":typing", ":adl"),
    )


@settings(max_examples=25, suppress_health_check=[HealthCheck.too_slow], deadline=None)
@given(st.tuples(INSTANTANEOUS, DURATIVE), st.lists(RULES, max_size=2), st.lists(constraints(), max_size=2), st.lists(WISHES, max_size=2))
def test_a_written_domain_reads_as_an_equal_one(
    actions: tuple[ActionSchema, ActionSchema], rules: list[Rule], kept: list[Constraint], wished: list[Preference]
) -> None:
    domain = replace(
        domain_of(list(actions)),
        rules=tuple(rules),
        constraints=tuple(map(over, kept)),
        preferences=tuple(wished),
        hierarchy=("(:task t)",),
    )
    text = write_domain(domain)
    again = parse_domain(text)
    assert again == domain
    assert [list(part) for part in (again.types, again.actions)] == [list(part) for part in (domain.types, domain.actions)]
    kairos.parse_domain(write_domain(replace(domain, hierarchy=())))


GROUND_FACTS = st.sampled_from([("at", "R1", "hall"), ("at", "r2", "hall"), ("idle",)])
GROUND_FUNCTIONS = st.sampled_from([("charge", "R1"), ("charge", "r2"), ("total-cost",)])


def values(truth: st.SearchStrategy[bool]) -> st.SearchStrategy[dict[Fluent, bool | float | str]]:
    homes = st.dictionaries(st.sampled_from([("home", "R1"), ("home", "r2")]), st.sampled_from(["hall", "y"]))
    parts = st.tuples(st.dictionaries(GROUND_FACTS, truth), st.dictionaries(GROUND_FUNCTIONS, NUMBERS), homes)
    return parts.map(lambda found: {**found[0], **found[1], **found[2]})


TIMED = st.dictionaries(st.floats(0, 1e9), values(st.booleans()).filter(bool), max_size=3).map(
    lambda found: tuple(TimedChange(time, found[time]) for time in sorted(found))
)


@settings(max_examples=25, suppress_health_check=[HealthCheck.too_slow], deadline=None)
@given(
    values(st.just(True)),
    TIMED,
    NUMBERS,
    st.lists(PREFERENCES, max_size=2),
    st.lists(constraints(), max_size=2),
    st.lists(WISHES, max_size=2),
)
def test_a_written_problem_reads_as_an_equal_one(
    init: dict[Fluent, bool | float | str],
    timed: tuple[TimedChange, ...],
    number: float,
    goals: list[Preference],
    kept: list[Constraint],
    wished: list[Preference],
) -> None:
    goal = All((Holds(("idle",)), Compare(">", ValueOf(("charge", "r2")), Constant(number))))
    soft = (*(replace(one, variables=(*OWN, *one.variables)) for one in goals), *wished, Preference("p", IDLE))
    metric = Metric("minimize", Arithmetic("*", (ValueOf(("is-violated", "p")), ValueOf(("total-time",)))))
    problem = Problem(
        "p",
        domain_of([]),
        {"r2": ("robot",), "x": ("object",), "y": ("robot", "place")},
        init,
        timed,
        goal,
        metric,
        tuple(map(over, kept)),
        tuple(sorted(soft, key=lambda one: isinstance(one.wanted, tuple))),
        requirements=(":typing",),
    )
    text = write_problem(problem)
    assert parse_problem(text, problem.domain) == problem
    kairos.parse_problem(text, kairos.parse_domain(write_domain(problem.domain)))
    network = replace(problem, network="(:htn :subtasks (and))\n(:tasks)")
    assert parse_problem(write_problem(network), problem.domain) == network


@given(NUMBERS)
def test_numbers_are_written_exactly_and_without_an_exponent(number: float) -> None:
    text = number_text(number)
    assert float(text) == number
    assert set(text) <= set("-.0123456789")


def test_the_layout_is_for_people() -> None:
    text = write_domain(domain_with("(:durative-action go :parameters (?r - robot ?a ?b - room) :duration (= ?duration 2.50)"
        " :condition (and (at start (at ?r ?a)) (over all (idle)) (at start (> (charge ?r) 0.1)) (at end (idle)))"
        " :effect (and (at start (not (at ?r ?a))) (at end (at ?r ?b))))"))  # fmt: skip
    assert text == (
        "(define (domain d)\n"
        "  (:types\n"
        "    robot room - thing\n"
        "    thing - object)\n"
        "  (:constants\n"
        "    hall - room)\n"
        "  (:predicates\n"
        "    (at ?r - robot ?l - room)\n"
        "    (idle))\n"
        "  (:functions\n"
        "    (charge ?r - robot)\n"
        "    (total-cost))\n"
        "  (:durative-action go\n"
        "    :parameters (?r - robot ?a ?b - room)\n"
        "    :duration (= ?duration 2.5)\n"
        "    :condition (and\n"
        "      (at start (at ?r ?a))\n"
        "      (at start (> (charge ?r) 0.1))\n"
        "      (over all (idle))\n"
        "      (at end (idle)))\n"
        "    :effect (and (at start (not (at ?r ?a))) (at end (at ?r ?b)))))\n"
    )


WORDS = [
    *(
        "(",
        ")",
        "?",
        "?x",
        "-",
        ":",
        ":effect",
        "and",
        "at",
        "start",
        "end",
        "not",
        "=",
        "3",
        "?duration",
        "when",
        "forall",
        "either",
        "é",
        ";",
    ),
    *(
        "preference",
        "always",
        "within",
        ":derived",
        ":constraints",
        "home",
        "undefined",
        "is-violated",
        "assign",
        "over",
        "all",
        ":vars",
        ":htn",
    ),
]


@settings(deadline=None)
@given(st.data())
def test_a_damaged_text_is_read_or_refused_with_a_position(data: st.DataObject) -> None:
    domain = replace(domain_of([SAMPLE, EARLY]), rules=(Rule("calm", OWN, Not(IDLE)),), constraints=(LAW,), hierarchy=("(:task t)",))
    init: dict[Fluent, bool | float | str] = {("idle",): True, ("charge", "R1"): 3.0, ("home", "R1"): "hall"}
    wishes = Preference("p", IDLE, (Variable("?x"),)), Preference("q", (LAW,))
    texts = (
        write_domain(domain),
        write_problem(Problem("p", domain, init=init, timed=SOON, goal=IDLE, preferences=wishes, constraints=(LAW,))),
    )
    which = data.draw(st.integers(0, 1))
    words = texts[which].replace("(", " ( ").replace(")", " ) ").split()
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(words) - 1))
        words[at : at + data.draw(st.integers(0, 2))] = data.draw(st.lists(st.sampled_from([*WORDS, *words[:40]]), max_size=2))
    error = _error(" ".join(words), domain if which else None)
    assert error is None or error.position is not None


def _error(text: str, domain: Domain | None) -> InputError | None:
    try:
        parse_problem(text, domain) if domain else parse_domain(text)
    except InputError as error:
        return error
    return None


SOON = (TimedChange(5.0, {("idle",): False, ("charge", "R1"): 1.0}),)
LAW = Constraint("within", (ForAll((Variable("?x"),), IDLE),), (5.0,), (Variable("?r", ("robot",)),))
SAMPLE = ActionSchema(
    "later",
    OWN,
    precondition=All((IDLE, Compare("=", CHARGE, ValueOf(DURATION)))),
    end_condition=ForAll((Variable("?x"),), Not(IDLE)),
    start_effects=(ForEach((Variable("?x"),), (When(IDLE, (NOT_IDLE,)), SET_IDLE)),),
    end_effects=(
        Set(("charge", "?r"), Arithmetic("+", (Constant(1.0), CHARGE)), "increase"),
        When(IDLE, (Set(("home", "?r"), Constant(UNDEFINED)),), early=True),
    ),
    preferences=(Preference("care", IDLE, moment="at end"),),
    duration=(DurationConstraint("<=", Constant(5.0)),),
)
EARLY = ActionSchema("now", OWN, precondition=Any((IDLE, Implies(IDLE, IDLE))), end_effects=(When(IDLE, (SET_IDLE,)),))


# --- files of others -----------------------------------------------------------------------

REFUSED = {
    "blocks_observe": "domain.pddl:11:4: sensing actions (:observe) are not supported yet;"
    " a contingent planner, of which unified-planning brings none, would be needed",
    "rosplan_test_invalid": "problem.pddl:1:2: expected 'define', found 'defie'",
    "simple_3": "problem.pddl:1:1: this '(' is never closed; expected ')' before the end of the file",
}
"""Pairs that are not read, and why; none of `ipc` is among them."""


def pairs() -> list[Path]:
    manifests = sorted(PAIRS.glob("*/manifest.json"))
    return [manifest.parent / pair["name"] for manifest in manifests for pair in json.loads(manifest.read_text())]


@pytest.mark.parametrize("folder", [folder for folder in pairs() if folder.name in REFUSED], ids=lambda folder: folder.name)
def test_pairs_that_are_refused(folder: Path) -> None:
    with pytest.raises(InputError) as caught:
        read_problem(folder / "problem.pddl", read_domain(folder / "domain.pddl"))
    assert str(caught.value) == f"{folder}/{REFUSED[folder.name]}"


@pytest.mark.parametrize("folder", [folder for folder in pairs() if folder.name not in REFUSED], ids=lambda folder: folder.name)
def test_pairs_are_read_and_written(folder: Path) -> None:
    domain = read_domain(folder / "domain.pddl")
    problem = read_problem(folder / "problem.pddl", domain)
    written = write_domain(domain), write_problem(problem)
    kairos.parse_problem(written[1], kairos.parse_domain(written[0]))
    again = parse_domain(written[0])
    assert again == domain
    assert parse_problem(written[1], again) == problem


def test_large_files_are_read() -> None:
    facts = "\n".join(f"(at r{index} room{index % 50})" for index in range(20_000))
    robots = " ".join(f"r{index}" for index in range(20_000))
    rooms = " ".join(f"room{index}" for index in range(50))
    text = f"{PROBLEM} (:objects {robots} - robot {rooms} - room) (:init {facts}) (:goal ()))"
    domain = domain_with("")
    problem = parse_problem(text, domain)
    assert len(problem.init) == 20_000
