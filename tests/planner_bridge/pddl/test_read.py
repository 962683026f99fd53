"""What is read from PDDL: declarations, actions, problems. Conditions and effects are compared as texts, where those differ."""

from __future__ import annotations

import pytest

from planner_bridge.model.problem import Metric, Problem
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.pddl.expressions import MAX_DEPTH
from planner_bridge.pddl.writer import write_domain
from pnm.core.logic.conditions import TRUE
from pnm.core.logic.domain import ActionSchema, Declaration
from pnm.core.logic.effects import TimedChange, is_early
from pnm.core.logic.expressions import Arithmetic, ValueOf, Variable
from pnm.errors import InputError
from tests.support.pddl.text import EXTENDED, SMALL

domain_with, problem_with, action, durative = EXTENDED.domain_with, EXTENDED.problem_with, EXTENDED.action, EXTENDED.durative


# --- declarations --------------------------------------------------------------------------


def test_types_have_parents() -> None:
    domain = parse_domain("(define (domain d) (:types a b - c d - (either c e) a - e a f - object))")
    assert domain.types == {"a": ("c", "e"), "b": ("c",), "c": (), "d": ("c", "e"), "e": (), "f": ()}
    assert list(domain.types) == ["a", "b", "c", "d", "e", "f"]
    assert domain.supertypes("d") == {"object", "c", "e", "d"}


def test_names_are_spelled_as_first_declared() -> None:
    domain = parse_domain(
        "(DEFINE (DOMAIN D) (:Types Robot ROBOT - Thing thing) (:CONSTANTS Jack - ROBOT jack - robot)"
        " (:Predicates (Busy ?R - robot)) (:Functions (F))"
        " (:ACTION Go :Parameters (?Robot - rObOt) :Precondition (AND (busy ?ROBOT) (NOT (BUSY JACK))) :EFFECT (Increase (f) 1)))"
    )
    assert domain.types == {"Robot": ("Thing",), "Thing": ()}
    go = domain.actions["Go"]
    assert go.parameters == (Variable("?Robot", ("Robot",)),)
    assert (str(go.precondition), *map(str, go.end_effects)) == ("(and (Busy ?Robot) (not (Busy Jack)))", "(increase (F) 1)")
    problem = parse_problem("(define (problem P) (:objects JACK Jill - robot) (:init (BUSY jack) (= F 2)) (:GOAL (busy JILL)))", domain)
    assert problem.own_objects == {"Jill": ("Robot",)}
    assert problem.init == {("Busy", "Jack"): True, ("F",): 2.0}
    assert str(problem.goal) == "(Busy Jill)"


@pytest.mark.parametrize("kind", ["object", "thing", "robot", "(either robot room)", "little"])
def test_a_variable_is_accepted_where_its_type_could_match(kind: str) -> None:
    text = f"(:types little - robot) (:action a :parameters (?r - {kind}) :precondition (at ?r hall))"
    assert str(SMALL.domain_with(text).actions["a"].precondition) == "(at ?r hall)"


def test_an_object_of_either_type_is_accepted_for_both() -> None:
    problem = SMALL.problem_with("(:objects both - (either robot room)) (:goal (at both both))")
    assert str(problem.goal) == "(at both both)"
    assert problem.objects_by_type["robot"] == ("r2", "both")


def test_functions_may_have_objects_for_values() -> None:
    requirements, types = "(:requirements :object-fluents :typing)", "(:types robot room closet)"
    text = f"(define (domain d) {requirements} {types} (:functions (f ?x - (either robot room)) - (either robot closet) (g) (h) - object))"
    domain = parse_domain(text)
    assert domain.warnings == ()
    assert parse_domain(write_domain(domain)) == domain
    assert domain.functions["f"] == Declaration("f", (Variable("?x", ("robot", "room")),), ("robot", "closet"))
    assert domain.functions["g"].values == domain.functions["h"].values == ("object",)


# --- conditions and effects ----------------------------------------------------------------


CONDITIONS = [
    ("(and (idle))", "(idle)"),
    ("(and (idle) (and (idle) (idle)))", "(and (idle) (idle) (idle))"),
    ("(imply (idle) ())", "(imply (idle) (and))"),
    ("(and (at ?r hall) (exists (?R - robot) (at ?r hall)))", "(and (at ?r hall) (exists (?R - robot) (at ?R hall)))"),
    ("(= total-cost 3)", "(= (total-cost) 3)"),
    ("(>= (charge ?r) -.5e1)", "(>= (charge ?r) -5)"),
    # functions stand for objects
    ("(= hall (HOME ?r))", "(= hall (home ?r))"),
    ("(not (dirty (home ?r)))", "(not (exists (?home - room) (and (= (home ?r) ?home) (dirty ?home))))"),
    ("(linked (home ?r) (home ?r))", "(exists (?home - room) (and (= (home ?r) ?home) (linked ?home ?home)))"),
    ("(> (+ 1 (area (home ?r))) 3)", "(exists (?home - room) (and (= (home ?r) ?home) (> (+ 1 (area ?home)) 3)))"),
    ("(= (home (owner ?l)) ?l)", "(exists (?owner - robot) (and (= (owner ?l) ?owner) (= (home ?owner) ?l)))"),
    (
        "(dirty (home (owner ?l)))",
        "(exists (?owner - robot ?home - room) (and (= (owner ?l) ?owner) (= (home ?owner) ?home) (dirty ?home)))",
    ),
    (
        "(exists (?home - room) (linked ?home (home ?r)))",
        "(exists (?home - room) (exists (?home2 - room) (and (= (home ?r) ?home2) (linked ?home ?home2))))",
    ),
]


@pytest.mark.parametrize(("text", "condition"), CONDITIONS)
def test_conditions(text: str, condition: str) -> None:
    assert str(action(f":precondition {text}").precondition) == condition


EFFECTS = [
    ("(and (idle) (and (not (idle))))", "(idle) (not (idle))"),
    # functions stand for objects
    ("(not (dirty (home ?r)))", "(forall (?home - room) (when (= (home ?r) ?home) (not (dirty ?home))))"),
    (
        "(assign (home (owner ?l)) (place (owner ?l)))",
        "(forall (?owner - robot) (when (= (owner ?l) ?owner) (assign (home ?owner) (place ?owner))))",
    ),
    ("(increase (area (home ?r)) 2)", "(forall (?home - room) (when (= (home ?r) ?home) (increase (area ?home) 2)))"),
]


@pytest.mark.parametrize(("text", "effects"), EFFECTS)
def test_effects(text: str, effects: str) -> None:
    assert " ".join(map(str, action(f":effect {text}").end_effects)) == effects
    assert " ".join(map(str, durative(f":effect (at end {text})").end_effects)) == effects


@pytest.mark.parametrize("parts", ["", ":parameters () :precondition () :effect ()", ":effect (and) :precondition (and (and))"])
def test_parts_of_an_action_may_be_empty_or_missing(parts: str) -> None:
    assert SMALL.action(parts) == ActionSchema("a")


@pytest.mark.parametrize(
    ("text", "bounds"),
    [
        ("()", ""),
        ("(and)", ""),
        ("(at start (= ?DURATION 3))", "(= ?duration 3)"),
        ("(and (<= ?duration 3) (at start (>= ?duration (charge ?r))))", "(<= ?duration 3) (>= ?duration (charge ?r))"),
    ],
)
def test_durations(text: str, bounds: str) -> None:
    assert " ".join(map(str, SMALL.durative(f":parameters (?r - robot) :duration {text}").duration or ())) == bounds


def test_timed_conditions_go_to_their_moments() -> None:
    schema = durative(
        ":condition (and (at start (and (idle) (idle))) (over all (idle)) (over all (not (idle))) (at end (>= ?duration 1))"
        " (forall (?r - robot) (and (at start (at ?r hall)) (at end (at ?r hall)))))"
    )
    assert str(schema.precondition) == "(and (idle) (idle) (forall (?r - robot) (at ?r hall)))"
    assert str(schema.invariant) == "(and (idle) (not (idle)))"
    assert str(schema.end_condition) == "(and (>= ?duration 1) (forall (?r - robot) (at ?r hall)))"


TIMED = [
    ("(and (at start (not (idle))) (at end (when (idle) (idle))))", "(not (idle))", "(when (idle) (idle))"),
    ("(when (at start (idle)) (at start (and (idle) (busy))))", "(when (idle) (and (idle) (busy)))", ""),
    (
        "(forall (?x - robot) (and (at start (idle)) (at end (increase (charge ?x) (* 2 ?duration)))"
        " (when (at end (idle)) (at end (busy)))))",
        "(forall (?x - robot) (idle))",
        "(forall (?x - robot) (and (increase (charge ?x) (* 2 ?duration)) (when (idle) (busy))))",
    ),
    # what was so at the start decides what happens at the end
    ("(when (at start (idle)) (at end (busy)))", "", "early (when (idle) (busy))"),
    ("(when (at start (idle)) (and (at start (busy)) (at end (idle))))", "(when (idle) (busy))", "early (when (idle) (idle))"),
    (
        "(when (and (at start (idle)) (at end (busy))) (at end (and (idle) (busy))))",
        "",
        "early (when (idle) (when (busy) (and (idle) (busy))))",
    ),
    (
        "(when (at start (idle)) (and (at end (busy)) (when (at end (busy)) (at end (idle)))))",
        "",
        "early (when (idle) (and (busy) (when (busy) (idle))))",
    ),
    ("(when (at end (idle)) (when (at start (busy)) (at end (idle))))", "", "early (when (idle) (when (busy) (idle)))"),
]


@pytest.mark.parametrize(("text", "start", "end"), TIMED)
def test_timed_effects_go_to_their_moments(text: str, start: str, end: str) -> None:
    schema = durative(f":effect {text}")
    assert " ".join(map(str, schema.start_effects)) == start
    assert " ".join(("early " if is_early(one) else "") + str(one) for one in schema.end_effects) == end


# --- rules ---------------------------------------------------------------------------------


def test_rules_are_read_in_their_order_with_the_types_of_the_declaration_where_they_have_none_or_wider_ones() -> None:
    domain = domain_with(
        "(:derived (near ?x ?y) (linked ?x ?y)) (:derived (busy) (not (idle))) (:derived (at ?x - robot ?y) (idle))"
        " (:derived (near ?x - thing ?y - closet) (exists (?z - room) (and (linked ?x ?z) (near ?z ?y))))"
    )
    assert [(rule.name, " ".join(map(str, rule.variables)), str(rule.condition)) for rule in domain.rules] == [
        ("near", "?x - room ?y - room", "(linked ?x ?y)"),
        ("busy", "", "(not (idle))"),
        ("at", "?x - robot ?y - room", "(idle)"),
        ("near", "?x - room ?y - closet", "(exists (?z - room) (and (linked ?x ?z) (near ?z ?y)))"),
    ]


@pytest.mark.parametrize(
    "rules",
    [
        "(:derived (busy) (forall (?l - room) (dirty ?l))) (:derived (dirty ?l) (busy))",
        "(:derived (busy) (not (idle))) (:derived (idle) (exists (?l - room) (dirty ?l)))",
        "(:derived (busy) (not (not (busy))))",
        "(:derived (busy) (imply (idle) (busy)))",
    ],
)
def test_rules_may_rest_on_themselves_and_on_the_absence_of_others(rules: str) -> None:
    assert len(domain_with(rules).rules) == rules.count(":derived")


@pytest.mark.parametrize("init", ["(busy)", "(not (busy))", "(at 5 (busy))"])
def test_a_derived_fact_cannot_be_given(init: str) -> None:
    with pytest.raises(InputError, match="'busy' is a derived predicate; it follows from others and cannot be given"):
        parse_problem(f"{EXTENDED.problem} (:init {init}) (:goal ()))", domain_with("(:derived (busy) (idle))"))


# --- problems ------------------------------------------------------------------------------


def test_a_problem_is_read() -> None:
    problem = SMALL.problem_with(
        "(:init (at r2 kitchen) (at r2 kitchen) (not (idle)) (= (charge r2) 10) (= total-cost 0)"
        " (at 7 (= (charge r2) -3)) (at 5 (idle)) (at 5.0 (not (at r2 kitchen))))"
        " (:requirements :typing) (:length (:serial 3)) (:metric maximize (- total-time (total-cost))) (:objects r2 - robot) (:goal ())"
    )
    assert problem == Problem(
        "p",
        SMALL.domain_with(""),
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


def test_objects_are_initial_and_timed_values() -> None:
    problem = problem_with("(:init (= (home r2) hall) (at 5 (= (place r2) kitchen))) (:goal (= (home r2) KITCHEN))")
    assert problem.init == {("home", "r2"): "hall"}
    assert problem.timed == (TimedChange(5.0, {("place", "r2"): "kitchen"}),)
    assert str(problem.goal) == "(= (home r2) kitchen)"


@pytest.mark.parametrize("before", ["(not ", "(or (p ?x) ", "(imply (p ?x) ", "(exists (?y) ", "(< 1 "])
def test_the_deepest_nesting_is_read_and_written(before: str) -> None:
    levels = MAX_DEPTH - 3
    nested = f"{before}{'(+ 1 ' * (levels - 1)}1{')' * levels}" if before == "(< 1 " else before * levels + "(p ?x)" + ")" * levels
    effect = "(when (p ?x) " * levels + "(p ?x)" + ")" * levels
    for part in (f":precondition {nested}", f":effect {effect}"):
        domain = parse_domain(f"(define (domain d) (:predicates (p ?x)) (:action a :parameters (?x) {part}))")
        assert parse_domain(write_domain(domain)) == domain
