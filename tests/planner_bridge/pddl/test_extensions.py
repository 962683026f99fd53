"""Derived predicates and object fluents: kept as they are, and written so that they mean the same."""

from __future__ import annotations

from pathlib import Path

import pytest

from planner_bridge.pddl import parse_domain, parse_problem, write_domain
from pnm.core.logic.conditions import All, Compare, Condition, Exists, Holds, Not
from pnm.core.logic.domain import Declaration
from pnm.core.logic.effects import Effect, ForEach, Set, TimedChange, When
from pnm.core.logic.expressions import UNDEFINED, Arithmetic, Constant, ValueOf, Variable
from pnm.core.logic.rules import DerivationRule
from pnm.errors import InputError
from tests.support.files import refused
from tests.support.pddl.text import EXTENDED

domain_with, problem_with, action, durative = EXTENDED.domain_with, EXTENDED.problem_with, EXTENDED.action, EXTENDED.durative
BAD_INPUT = Path(__file__).with_name("refused")
HALL, ROOM, ROBOT = Constant("hall"), ("room",), ("robot",)
R, L = Variable("?r", ROBOT), Variable("?l", ROOM)
IDLE, BUSY = Holds(("idle",)), Holds(("busy",))


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
    assert domain.rules.rules == (
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
