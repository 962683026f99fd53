"""PDDL that is not as it should be but can be understood: read with warnings that have positions."""

from __future__ import annotations

import pytest

from planner_bridge.model.problem import Borrowed
from planner_bridge.pddl import parse_domain, parse_problem, write_domain, write_problem
from pnm.core.logic.conditions import TRUE, All, Any, Holds, Not
from pnm.core.logic.domain import Declaration, DurationConstraint
from pnm.core.logic.expressions import Constant, Variable
from pnm.errors import InputError, Position
from tests.support.pddl.text import DECLARING, warnings

domain_with, problem_with = DECLARING.domain_with, DECLARING.problem_with

SECOND = "read as part of the first in line 1"
DOMAINS = [
    (
        "(:requirements :foo typing)",
        [
            f"2:1: warning: a second :requirements section, {SECOND}",
            "2:16: warning: unknown requirement ':foo'",
            "2:21: warning: 'typing' is read as ':typing'",
        ],
    ),
    (
        "(:types a - b a - c object d - object)",
        [f"2:1: warning: a second :types section, {SECOND}", "2:15: warning: the type 'a' is declared twice; it is of all the kinds given"],
    ),
    (
        "(:types - a)",
        [f"2:1: warning: a second :types section, {SECOND}", "2:9: warning: there is no name before the type 'a'; it is ignored"],
    ),
    (
        "(:constants HALL - room)",
        [f"2:1: warning: a second :constants section, {SECOND}", "2:13: warning: the object 'HALL' is declared twice"],
    ),
    (
        "(:predicates (idle) (p ?x ?x))",
        [
            f"2:1: warning: a second :predicates section, {SECOND}",
            "2:14: warning: the predicate 'idle' is declared twice, the first time in line 1; it takes the types of both",
            "2:27: warning: the variable '?x' is there twice",
        ],
    ),
    (
        "(:action a :effect (idle))\n(:action b) (:action A-2)\n(:action A)",
        ["4:1: warning: the action 'A' is declared twice, the first time in line 2; this one is called 'A-3'"],
    ),
    ("(:action a :parameters (? r - robot) :effect (at-room ?r hall))", ["2:25: warning: '? r' is read as '?r'"]),
    ("(:action a :vars (?r - robot) :effect (at-room ?r hall))", ["2:18: warning: the variables of :vars are read as further parameters"]),
    (
        "(:action a :effect (at_room r hall))",
        [
            "2:21: warning: the predicate 'at_room' is read as 'at-room'",
            "2:29: warning: the object 'r' is not among the :constants; every problem has to declare it",
        ],
    ),
    ("(:action a :effect (increase (total_cost) 1))", ["2:31: warning: the function 'total_cost' is read as 'total-cost'"]),
    (
        "(:action a :precondition (and (xyz hall) (not (xyz hall))))",
        [
            "2:32: warning: the predicate 'xyz' is not declared; it is read as false",
            "2:48: warning: the predicate 'xyz' is not declared; it is read as false",
        ],
    ),
    (
        "(:derived (p ?x - room) (idle))",
        [
            "2:1: warning: :derived-predicates is needed here but not among the :requirements",
            "2:11: warning: the predicate 'p' is derived here but not among the :predicates",
        ],
    ),
    (
        "(:constraints (always (idle)) (sometime (idle)))",
        [
            "2:15: warning: :constraints is needed here but not among the :requirements",
            "2:31: warning: several constraints without 'and' around them; all of them count",
        ],
    ),
    ("))\n ; the end\n )", ["2:2: warning: this ')' closes nothing"]),
]


# --- domains ---


@pytest.mark.parametrize(("text", "expected"), DOMAINS, ids=[text for text, _ in DOMAINS])
def test_domains_are_read_with_warnings(text: str, expected: list[str]) -> None:
    domain = domain_with(text)
    assert warnings(domain) == expected
    assert parse_domain(write_domain(domain)) == domain


def test_what_is_tolerated_is_read_as_it_was_meant() -> None:
    domain = domain_with(
        "(:types a - b a - c) (:constants hall - a both - robot both - room) (:predicates (IDLE) (p ?x - robot) (P ?y - room))"
        " (:action x :parameters (?r - robot) :vars (?l - room) :precondition (and (at_room ?r ?l) (not (xyz ?l))))"
        " (:derived (q ?x - room) (idle))"
    )
    assert domain.types == {"robot": ("thing",), "room": ("thing",), "thing": (), "a": ("b", "c"), "b": (), "c": ()}
    assert domain.constants == {"hall": ("room", "a"), "both": ("robot", "room")}
    assert domain.predicates["p"] == Declaration("p", (Variable("?x", ("robot", "room")),))
    assert domain.predicates["q"] == Declaration("q", (Variable("?x", ("room",)),))
    action = domain.actions["x"]
    assert action.parameters == (Variable("?r", ("robot",)), Variable("?l", ("room",)))
    assert action.precondition == All((Holds(("at-room", "?r", "?l")), Not(Any(()))))


def test_a_type_in_one_section_says_nothing_of_names_in_another() -> None:
    domain = parse_domain("(define (domain d) (:types t) (:constants a) (:constants b - t) (:functions (f)) (:functions (g) - t))")
    assert domain.constants == {"a": ("object",), "b": ("t",)}
    assert (domain.functions["f"].values, domain.functions["g"].values) == ((), ("t",))


DURATIVE = "(:durative-action a :duration {} :condition {})"
TIMED = [
    ("(<= 3 ?duration)", "()", DurationConstraint(">=", Constant(3.0)), "2:31: warning: ?duration is expected first"),
    ("()", "(not (at start (idle)))", Not(Holds(("idle",))), "2:45: warning: (not ...) is expected inside (at start ...)"),
    (
        "()",
        "(or (at start (idle)) (at start (at-room r hall)))",
        Any((Holds(("idle",)), Holds(("at-room", "r", "hall")))),
        "2:45: warning: (or ...) is expected inside (at start ...)",
    ),
]


@pytest.mark.parametrize(("duration", "condition", "meant", "warning"), TIMED, ids=[warning for *_, warning in TIMED])
def test_timed_parts_may_be_the_other_way_round(duration: str, condition: str, meant: object, warning: str) -> None:
    domain = domain_with(DURATIVE.format(duration, condition))
    assert warning in warnings(domain)
    schema = domain.actions["a"]
    assert (schema.duration[0] if schema.duration else schema.precondition) == meant


COSTLY = "(define (domain d) (:requirements :action-costs) (:predicates (p))\n(:action a :effect (and (p) (increase (total-cost) 2))))"
METRIC = "(define (problem p) (:domain d) (:init (= (total-cost) 0)) (:goal (p)) (:metric minimize (total-cost)))"


# --- the total cost, and objects of the problem ---


def test_the_total_cost_need_not_be_declared() -> None:
    domain = parse_domain(COSTLY)
    assert warnings(domain) == ["2:40: warning: the function 'total-cost' is not declared; it is read as (total-cost) - number"]
    assert domain.functions == {"total-cost": Declaration("total-cost")}
    problem = parse_problem(METRIC, domain)
    assert problem.warnings == domain.warnings


def test_a_problem_may_count_a_cost_that_no_action_has() -> None:
    domain = parse_domain("(define (domain d) (:requirements :action-costs) (:predicates (p)))")
    problem = parse_problem(METRIC, domain)
    assert warnings(problem) == ["1:44: warning: the function 'total-cost' is not declared; it is read as (total-cost) - number"]
    assert problem.domain.functions == {"total-cost": Declaration("total-cost")}
    assert problem.init == {("total-cost",): 0.0}


BORROWING = "(:action a :parameters (?r - robot) :precondition (at-room ?r Dock) :effect (not (at-room ?r dock)))"


def test_actions_may_name_objects_that_problems_declare() -> None:
    domain = domain_with(BORROWING)
    position = Position("domain.pddl", 2, 63)
    assert domain.borrowed == {"Dock": Borrowed(("room",), position)}
    assert domain.borrowed["Dock"].position == position
    problem = parse_problem("(define (problem p) (:domain d) (:objects DOCK - room) (:init) (:goal (not (idle))))", domain)
    assert problem.own_objects == {"Dock": ("room",)}
    again = parse_domain(write_domain(domain))
    assert again == domain
    assert parse_problem(write_problem(problem), again) == problem


@pytest.mark.parametrize(
    ("objects", "message"),
    [
        ("r2 - robot", "1:1: the object 'Dock' is not declared; the domain names it at domain.pddl:2:63"),
        ("dock - robot", "1:1: 'Dock' is of type robot; the domain expects room"),
    ],
)
def test_and_then_problems_have_to(objects: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_problem(f"(define (problem p) (:domain d) (:objects {objects}) (:goal (idle)))", domain_with(BORROWING))
    assert str(caught.value) == f"problem.pddl:{message}"


PROBLEMS = [
    (
        "(:objects HALL - room r2 - room)",
        [
            f"2:1: warning: a second :objects section, {SECOND}",
            "2:11: warning: the object 'HALL' is declared twice",
            "2:23: warning: the object 'r2' is declared twice: as room here, as robot before; it is of both types",
        ],
    ),
    (
        "(:init (idle) (IDLE) (= (charge r2) 1) (= (charge r2) 1.0))",
        ["2:15: warning: (idle) is there twice", "2:40: warning: (charge r2) is there twice"],
    ),
    (
        "(:init (xyz r2) (not (xyz)) (at 5 (xyz)) (= (fuel) 3))",
        [
            "2:8: warning: the predicate 'xyz' is not declared; the fact is ignored",
            "2:22: warning: the predicate 'xyz' is not declared; the fact is ignored",
            "2:29: warning: :timed-initial-literals is needed here but not among the :requirements",
            "2:35: warning: the predicate 'xyz' is not declared; the fact is ignored",
            "2:42: warning: the function (fuel) is not declared; its value is ignored",
        ],
    ),
    ("(:init (idle r2))", ["2:8: warning: (idle) takes 0 arguments, found 1; the fact is ignored"]),
    ("(:init (= (charge r2) 1) (= (charge r2) 2))", ["2:26: warning: (charge r2) has another value before; this one is used"]),
    ("(:init (assign (charge r2) 5))", ["2:8: warning: 'assign' is read as '='"]),
    ("(:length (:serial 3))", ["2:1: warning: ':length' is ignored"]),
    ("(:goal-reward 100)", ["2:1: warning: ':goal-reward' is ignored: every plan reaches the goal"]),
    ("(:metric maximize (reward))", ["2:1: warning: rewards are ignored: (:metric ...)"]),
    ("(:goal (not (idle)))", ["2:1: warning: a second :goal section, read as part of the first in line 2"]),
]


# --- problems ---


@pytest.mark.parametrize(("text", "expected"), PROBLEMS, ids=[text for text, _ in PROBLEMS])
def test_problems_are_read_with_warnings(text: str, expected: list[str]) -> None:
    problem = parse_problem(f"{DECLARING.problem}\n{text} (:goal (not (idle))))", domain_with(""))
    if "a second :goal" in expected[0]:
        expected = [warning.replace("2:1", f"2:{len(text) + 2}") for warning in expected]
    assert warnings(problem) == expected
    assert parse_problem(write_problem(problem), problem.domain) == problem


def test_the_name_of_the_domain_may_differ_or_be_missing() -> None:
    other = parse_problem("(define (problem p)\n(:domain e) (:goal (idle)))", domain_with(""))
    assert warnings(other) == ["2:10: warning: the problem is for a domain 'e'; this one is 'd'"]
    nameless = parse_problem("(define (problem p) (:goal (idle)))", domain_with(""))
    assert warnings(nameless) == ["1:1: warning: the problem does not name its domain; expected (:domain d)"]


def test_what_is_tolerated_in_problems_is_read_as_it_was_meant() -> None:
    problem = problem_with("(:objects r2 - room hall - robot kitchen) (:init (= (charge r2) 1) (= (charge r2) 2))")
    assert warnings(problem)[0] == "1:1: warning: there is no :goal; any state will do"
    assert (problem.goal, problem.init) == (TRUE, {("charge", "r2"): 2.0})
    assert problem.own_objects == {"r2": ("robot", "room"), "kitchen": ("room",), "hall": ("room", "robot")}
    assert problem.objects["hall"] == ("room", "robot")


def test_a_problem_tells_what_was_wrong_with_its_domain_first() -> None:
    problem = parse_problem(f"{DECLARING.problem} (:length) (:goal (idle)))", domain_with("(:requirements :foo)"))
    assert [one.position.file for one in problem.warnings] == ["domain.pddl", "domain.pddl", "problem.pddl"]
    assert problem.requirements == ()


SPEEDS = """(define (domain d) (:requirements :typing :durative-actions :fluents) (:types robot place)
(:predicates (at ?r - robot ?p - place)) (:functions (speed ?r - robot) (distance ?a ?b - place) (load ?r - robot) (toll))
(:durative-action move :parameters (?r - robot ?a ?b - place) :duration (= ?duration (/ (distance ?a ?b) (speed ?r)))
 :condition (and (at start (at ?r ?a)) (at start (> (load ?r) (toll)))) :effect (and (at start (not (at ?r ?a))) (at end (at ?r ?b))))
(:action weigh :parameters (?r - robot) :effect (assign (load ?r) 3)))"""


@pytest.mark.parametrize(
    ("init", "missing"),
    [
        ("(= (speed r1) 1) (= (speed r2) 1) (= (toll) 2)", []),
        ("(= (speed r2) 1) (= (toll) 2)", ["(speed r1)"]),
        ("(= (speed r2) 0)", ["(speed r1)", "(toll)"]),
        ("(= (speed r1) 1) (= (speed r2) 1) (at 3 (= (toll) 1))", []),
    ],
)
def test_a_number_that_actions_need_and_nothing_gives_is_said(init: str, missing: list[str]) -> None:
    text = f"(define (problem p) (:domain d) (:objects r1 r2 - robot a b - place)\n (:init (at r1 a) {init}) (:goal (at r1 b)))"
    found = parse_problem(text, parse_domain(SPEEDS, "d"), "p").warnings
    wanted = [f"p:2:2: warning: {fluent} has no value at first; actions that need it cannot be applied" for fluent in missing]
    assert [str(warning) for warning in found if "requirements" not in str(warning)] == wanted
