"""What is read from PDDL: declarations, actions, problems."""

from __future__ import annotations

import pytest

from planner_bridge.model.problem import Domain, Metric, Problem
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.pddl.expressions import MAX_DEPTH
from planner_bridge.pddl.writer import write_domain
from pnm.core.logic.conditions import TRUE, All, Any, Compare, Condition, Exists, ForAll, Holds, Implies, Not
from pnm.core.logic.domain import ActionSchema, Declaration, DurationConstraint
from pnm.core.logic.effects import OPERATIONS, Effect, ForEach, Set, TimedChange, When
from pnm.core.logic.expressions import DURATION, Arithmetic, Constant, ValueOf, Variable
from tests.support.pddl.text import CHARGE, IDLE, NOT_IDLE, SET_IDLE, SMALL

domain_with, problem_with, action, durative = SMALL.domain_with, SMALL.problem_with, SMALL.action, SMALL.durative


# --- what is read: declarations ---


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


# --- what is read: actions ---


@pytest.mark.parametrize("parts", ["", ":parameters () :precondition () :effect ()", ":effect (and) :precondition (and (and))"])
def test_parts_of_an_action_may_be_empty_or_missing(parts: str) -> None:
    assert action(parts) == ActionSchema("a")


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


# --- what is read: problems ---


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
        (TimedChange(5.0, {("idle",): True, ("at", "r2", "kitchen"): False}), TimedChange(7.0, {("charge", "r2"): -3.0})),
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
