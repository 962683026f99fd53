"""Derived predicates, object fluents and effects across moments: kept as they are, and written so that they mean the same."""

from __future__ import annotations

from pathlib import Path

import kairos
import pytest

from planner_bridge.pddl import parse_domain, parse_problem, write_domain, write_problem
from pnm.core.logic.conditions import All, Compare, Condition, Exists, Holds, Not
from pnm.core.logic.domain import Declaration
from pnm.core.logic.effects import Effect, ForEach, Set, TimedChange, When
from pnm.core.logic.expressions import UNDEFINED, Arithmetic, Constant, ValueOf, Variable
from pnm.core.logic.rules import DerivationRule
from pnm.errors import InputError
from tests.support.pddl.text import EXTENDED
from tests.support.refusals import refused

domain_with, problem_with, action, durative = EXTENDED.domain_with, EXTENDED.problem_with, EXTENDED.action, EXTENDED.durative
BAD_INPUT = Path(__file__).with_name("refused")
HALL, ROOM, ROBOT = Constant("hall"), ("room",), ("robot",)
R, L = Variable("?r", ROBOT), Variable("?l", ROOM)
IDLE, BUSY = Holds(("idle",)), Holds(("busy",))
SET_IDLE, SET_BUSY = Set(("idle",), Constant(True)), Set(("busy",), Constant(True))
DIRTY = Holds(("dirty", "?l"))


# --- refusals ---


@pytest.mark.parametrize(("text", "message"), refused(BAD_INPUT / "extensions.pddl"))
def test_a_bad_domain_is_refused(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_domain(f"{EXTENDED.domain}\n{text})")
    assert str(caught.value) == f"domain.pddl:{message}"


@pytest.mark.parametrize(("text", "message"), refused(BAD_INPUT / "extensions_in_problems.pddl"))
def test_a_bad_problem_is_refused(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_problem(f"{EXTENDED.problem}\n{text})", parse_domain(f"{EXTENDED.domain})"))
    assert str(caught.value) == f"problem.pddl:{message}"


@pytest.mark.parametrize("init", ["(busy)", "(not (busy))", "(at 5 (busy))"])
def test_a_derived_fact_cannot_be_given(init: str) -> None:
    with pytest.raises(InputError, match="'busy' is a derived predicate; it follows from others and cannot be given"):
        parse_problem(f"{EXTENDED.problem} (:init {init}) (:goal ()))", domain_with("(:derived (busy) (idle))"))


# --- derived predicates ---


def test_rules_are_read_in_their_order() -> None:
    domain = domain_with(
        "(:derived (near ?x ?y) (linked ?x ?y)) (:derived (busy) (not (idle)))"
        " (:derived (near ?x ?y - closet) (exists (?z - room) (and (linked ?x ?z) (near ?z ?y))))"
    )
    x, y, z = (Variable(name, ROOM) for name in ("?x", "?y", "?z"))
    narrow = Variable("?x", ("closet",)), Variable("?y", ("closet",))
    assert domain.rules == (
        DerivationRule("near", (x, y), Holds(("linked", "?x", "?y"))),
        DerivationRule("busy", (), Not(IDLE)),
        DerivationRule("near", narrow, Exists((z,), All((Holds(("linked", "?x", "?z")), Holds(("near", "?z", "?y")))))),
    )


def test_a_head_without_types_has_those_of_the_declaration_and_one_with_wider_types_too() -> None:
    domain = domain_with("(:derived (near ?x - thing ?y) (idle)) (:derived (at ?x - robot ?y) (idle))")
    assert [rule.variables for rule in domain.rules] == [
        (Variable("?x", ROOM), Variable("?y", ROOM)),
        (Variable("?x", ROBOT), Variable("?y", ROOM)),
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


# --- object fluents ---


def test_functions_may_have_objects_for_values() -> None:
    domain = domain_with("")
    assert domain.functions["charge"] == Declaration("charge", (R,))
    assert domain.functions["home"] == Declaration("home", (R,), ROOM)
    requirements, types = "(:requirements :object-fluents :typing)", "(:types robot room closet)"
    text = f"(define (domain d) {requirements} {types} (:functions (f ?x - (either robot room)) - (either robot closet) (g) (h) - object))"
    domain = parse_domain(text)
    assert domain.warnings == ()
    assert parse_domain(write_domain(domain)) == domain
    assert domain.functions["f"] == Declaration("f", (Variable("?x", ("robot", "room")),), ("robot", "closet"))
    assert domain.functions["g"].values == domain.functions["h"].values == ("object",)


HOME, PLACE = ValueOf(("home", "?r")), ValueOf(("place", "?r"))


def bound(name: str, of: str, types: tuple[str, ...] = ROOM) -> tuple[Variable, Compare]:
    function, argument = of.split()
    return Variable(name, types), Compare("=", ValueOf((function, argument)), Constant(name))


HOME_IS, OWNER_IS = bound("?home", "home ?r"), bound("?owner", "owner ?l", ROBOT)


@pytest.mark.parametrize(
    ("text", "condition"),
    [
        ("(= (home ?r) ?l)", Compare("=", HOME, Constant("?l"))),
        ("(= hall (HOME ?r))", Compare("=", HALL, HOME)),
        ("(= (home ?r) (place ?r))", Compare("=", HOME, PLACE)),
        ("(= (home ?r) (owner ?l))", Compare("=", HOME, ValueOf(("owner", "?l")))),
        ("(dirty (home ?r))", Exists((HOME_IS[0],), All((HOME_IS[1], Holds(("dirty", "?home")))))),
        ("(not (dirty (home ?r)))", Not(Exists((HOME_IS[0],), All((HOME_IS[1], Holds(("dirty", "?home"))))))),
        ("(linked (home ?r) (home ?r))", Exists((HOME_IS[0],), All((HOME_IS[1], Holds(("linked", "?home", "?home")))))),
        (
            "(> (+ 1 (area (home ?r))) 3)",
            Exists(
                (HOME_IS[0],), All((HOME_IS[1], Compare(">", Arithmetic("+", (Constant(1.0), ValueOf(("area", "?home")))), Constant(3.0))))
            ),
        ),
        ("(= (home (owner ?l)) ?l)", Exists((OWNER_IS[0],), All((OWNER_IS[1], Compare("=", ValueOf(("home", "?owner")), Constant("?l")))))),
        (
            "(dirty (home (owner ?l)))",
            Exists(
                (OWNER_IS[0], Variable("?home", ROOM)),
                All((OWNER_IS[1], Compare("=", ValueOf(("home", "?owner")), Constant("?home")), Holds(("dirty", "?home")))),
            ),
        ),
        (
            "(exists (?home - room) (linked ?home (home ?r)))",
            Exists(
                (Variable("?home", ROOM),),
                Exists((Variable("?home2", ROOM),), All((bound("?home2", "home ?r")[1], Holds(("linked", "?home", "?home2"))))),
            ),
        ),
    ],
)
def test_functions_stand_for_objects_in_conditions(text: str, condition: Condition) -> None:
    assert action(f":precondition {text}").precondition == condition


@pytest.mark.parametrize(
    ("text", "effect"),
    [
        ("(assign (home ?r) ?l)", Set(("home", "?r"), Constant("?l"))),
        ("(assign (home ?r) hall)", Set(("home", "?r"), HALL)),
        ("(assign (home ?r) (place ?r))", Set(("home", "?r"), PLACE)),
        ("(assign (home ?r) undefined)", Set(("home", "?r"), Constant(UNDEFINED))),
        ("(not (dirty (home ?r)))", ForEach((HOME_IS[0],), (When(HOME_IS[1], (Set(("dirty", "?home"), Constant(False)),)),))),
        (
            "(assign (home (owner ?l)) (place (owner ?l)))",
            ForEach((OWNER_IS[0],), (When(OWNER_IS[1], (Set(("home", "?owner"), ValueOf(("place", "?owner"))),)),)),
        ),
        (
            "(increase (area (home ?r)) 2)",
            ForEach((HOME_IS[0],), (When(HOME_IS[1], (Set(("area", "?home"), Constant(2.0), "increase"),)),)),
        ),
    ],
)
def test_functions_stand_for_objects_in_effects(text: str, effect: Effect) -> None:
    assert action(f":effect {text}").end_effects == (effect,)
    assert durative(f":effect (at end {text})").end_effects == (effect,)


def test_objects_are_initial_and_timed_values() -> None:
    problem = problem_with("(:init (= (home r2) hall) (at 5 (= (place r2) kitchen))) (:goal (= (home r2) KITCHEN))")
    assert problem.init == {("home", "r2"): "hall"}
    assert problem.timed == (TimedChange(5.0, {("place", "r2"): "kitchen"}),)
    assert problem.goal == Compare("=", ValueOf(("home", "r2")), Constant("kitchen"))


# --- effects across moments ---


@pytest.mark.parametrize(
    ("text", "start", "end"),
    [
        ("(when (at start (idle)) (at end (busy)))", (), (When(IDLE, (SET_BUSY,), early=True),)),
        (
            "(when (and (at start (idle)) (at end (busy))) (at end (and (idle) (busy))))",
            (),
            (When(IDLE, (When(BUSY, (SET_IDLE, SET_BUSY)),), early=True),),
        ),
        (
            "(when (at start (idle)) (and (at start (busy)) (at end (idle))))",
            (When(IDLE, (SET_BUSY,)),),
            (When(IDLE, (SET_IDLE,), early=True),),
        ),
        (
            "(forall (?l - room) (when (at start (dirty ?l)) (at end (not (dirty ?l)))))",
            (),
            (ForEach((L,), (When(DIRTY, (Set(("dirty", "?l"), Constant(False)),), early=True),)),),
        ),
        (
            "(when (at start (idle)) (and (at end (busy)) (when (at end (busy)) (at end (idle)))))",
            (),
            (When(IDLE, (SET_BUSY, When(BUSY, (SET_IDLE,))), early=True),),
        ),
        (
            "(when (at end (idle)) (when (at start (busy)) (at end (idle))))",
            (),
            (When(IDLE, (When(BUSY, (SET_IDLE,), early=True),)),),
        ),
    ],
)
def test_what_was_so_at_the_start_decides_what_happens_at_the_end(text: str, start: tuple[Effect, ...], end: tuple[Effect, ...]) -> None:
    schema = durative(f":effect {text}")
    assert (schema.start_effects, schema.end_effects) == (start, end)


CLEANING = (
    "(:action go :parameters (?r - robot ?l - room) :precondition (and (linked (place ?r) ?l) {go})"
    " :effect (and (assign (place ?r) ?l) (increase (total-cost) 1)))"
    " (:action sweep :parameters (?r - robot) :precondition (and (dirty (place ?r)) {sweep})"
    " :effect (and (not (dirty (place ?r))) (increase (total-cost) 5)))"
)
ROOMS = (
    "(:objects r2 - robot b c - room) (:init (= (place r2) hall) (= (home r2) b) (= (total-cost) 0) (dirty b) (dirty c)"
    " (linked hall b) (linked b c) (linked c hall)) "
)
SAME = {
    "object fluents": ("", "", "", "(:goal (and (= (place r2) (home r2)) (not (dirty c)))) (:metric minimize (total-cost))"),
    "derived": (
        "(:derived (near ?a ?b) (or (linked ?a ?b) (exists (?c - room) (and (linked ?a ?c) (near ?c ?b)))))"
        " (:derived (busy) (exists (?l - room) (dirty ?l)))",
        "",
        "(near (place ?r) hall)",
        "(:goal (not (busy))) (:metric minimize (total-cost))",
    ),
    "goal preferences": (
        "",
        "",
        "",
        "(:goal (and (= (place r2) hall) (forall (?l - room) (preference clean (not (dirty ?l))))))"
        " (:metric minimize (+ (total-cost) (* 6 (is-violated clean))))",
    ),
    "precondition preferences": (
        "",
        "(preference tidy (not (dirty ?l)))",
        "",
        "(:goal (not (dirty c))) (:metric minimize (+ (total-cost) (* 2 (is-violated tidy))))",
    ),
    "constraints": (
        "(:constraints (and (forall (?r - robot ?l - room) (at-most-once (= (place ?r) ?l)))))",
        "",
        "",
        "(:goal (not (dirty c))) (:constraints (and (sometime-before (not (dirty c)) (not (dirty b)))"
        " (preference back (sometime-after (not (dirty c)) (= (place r2) hall)))))"
        " (:metric minimize (+ (total-cost) (* 100 (is-violated back))))",
    ),
}


def outcome(domain: str, problem: str) -> tuple[object, object]:
    parsed = kairos.parse_problem(problem, kairos.parse_domain(domain))
    result = kairos.Planner().solve(parsed, timeout=10, anytime=False, threads=1)
    return result.status, result.plan.cost if result.plan else None


# --- the same meaning ---


@pytest.mark.parametrize("name", SAME)
def test_what_is_written_means_the_same_to_the_planner(name: str) -> None:
    more, go, sweep, rest = SAME[name]
    texts = (
        f"{EXTENDED.domain} {more} {CLEANING.format(go=go, sweep=sweep)})",
        f"(define (problem p) (:domain d) {ROOMS} {rest})",
    )
    domain = parse_domain(texts[0])
    problem = parse_problem(texts[1], domain)
    assert problem.warnings == ()
    written = write_domain(domain), write_problem(problem)
    assert parse_problem(written[1], parse_domain(written[0])) == problem
    before = outcome(*texts)
    assert before[0] == kairos.Status.SOLVED
    assert outcome(*written) == before


def test_an_effect_decided_at_the_start_means_the_same_to_the_planner() -> None:
    more = (
        "(:durative-action wait :parameters () :duration (= ?duration 2) :condition (at start (not (busy)))"
        " :effect (and (at start (busy)) (at end (not (busy))) (when (at start (idle)) (at end (dirty hall)))"
        " (when (and (at start (idle)) (at end (busy))) (at end (not (idle))))))"
    )
    texts = f"{EXTENDED.domain} {more})", "(define (problem p) (:domain d) (:init (idle)) (:goal (and (dirty hall) (not (idle)))))"
    problem = parse_problem(texts[1], parse_domain(texts[0]))
    written = write_domain(problem.domain), write_problem(problem)
    assert parse_problem(written[1], parse_domain(written[0])) == problem
    before = outcome(*texts)
    assert before[0] == kairos.Status.SOLVED
    assert outcome(*written) == before
