"""What PDDL has beyond facts and numbers: refused where it makes no sense, kept as it is, and written so that it means the same."""

from __future__ import annotations

from pathlib import Path

import kairos
import pytest

from planner_bridge.model.problem import Domain, Metric, Problem
from planner_bridge.pddl import parse_domain, parse_problem, write_domain, write_problem
from pnm.core.logic.conditions import TRUE, All, Any, Compare, Condition, Exists, ForAll, Holds, Implies, Not
from pnm.core.logic.domain import ActionSchema, Declaration, Preference
from pnm.core.logic.effects import Effect, ForEach, Set, TimedChange, When
from pnm.core.logic.expressions import UNDEFINED, Arithmetic, Constant, ValueOf, Variable
from pnm.core.logic.rules import Rule
from pnm.core.logic.trajectory import Constraint
from pnm.errors import InputError
from tests.support.refusals import refused

BAD_INPUT = Path(__file__).with_name("refused")

DECLARED = (
    "(define (domain d)"
    " (:requirements :adl :fluents :durative-actions :duration-inequalities :derived-predicates :preferences :constraints"
    " :timed-initial-literals :hierarchy)"
    " (:types robot room - thing closet - room) (:constants hall - room)"
    " (:predicates (at ?r - robot ?l - room) (dirty ?l - room) (linked ?a ?b - room) (near ?a ?b - room) (idle) (busy))"
    " (:functions (charge ?r - robot) (area ?l - room) (total-cost) - number"
    " (home ?r - robot) (place ?r - robot) - room (owner ?l - room) - robot)"
)
"""One line, so that what a test adds stands in line 2."""
PROBLEM = "(define (problem p) (:domain d) (:objects r2 - robot kitchen - room)"
HALL, ROOM, ROBOT = Constant("hall"), ("room",), ("robot",)
R, L = Variable("?r", ROBOT), Variable("?l", ROOM)
IDLE, BUSY = Holds(("idle",)), Holds(("busy",))
SET_IDLE, SET_BUSY = Set(("idle",), Constant(True)), Set(("busy",), Constant(True))
DIRTY = Holds(("dirty", "?l"))


def domain_with(text: str) -> Domain:
    domain = parse_domain(f"{DECLARED}\n{text})")
    assert domain.warnings == ()
    assert parse_domain(write_domain(domain)) == domain
    return domain


def problem_with(text: str, domain: str = "") -> Problem:
    problem = parse_problem(f"{PROBLEM}\n{text})", domain_with(domain))
    assert problem.warnings == ()
    assert parse_problem(write_problem(problem), problem.domain) == problem
    return problem


def action(parts: str) -> ActionSchema:
    return domain_with(f"(:action a :parameters (?r - robot ?l - room) {parts})").actions["a"]


def durative(parts: str) -> ActionSchema:
    return domain_with(f"(:durative-action a :parameters (?r - robot ?l - room) :duration () {parts})").actions["a"]


# --- refusals ------------------------------------------------------------------------------


@pytest.mark.parametrize(("text", "message"), refused(BAD_INPUT / "extensions.pddl"))
def test_a_bad_domain_is_refused(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_domain(f"{DECLARED}\n{text})")
    assert str(caught.value) == f"domain.pddl:{message}"


@pytest.mark.parametrize(("text", "message"), refused(BAD_INPUT / "extensions_in_problems.pddl"))
def test_a_bad_problem_is_refused(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_problem(f"{PROBLEM}\n{text})", parse_domain(f"{DECLARED})"))
    assert str(caught.value) == f"problem.pddl:{message}"


@pytest.mark.parametrize("init", ["(busy)", "(not (busy))", "(at 5 (busy))"])
def test_a_derived_fact_cannot_be_given(init: str) -> None:
    with pytest.raises(InputError, match="'busy' is a derived predicate; it follows from others and cannot be given"):
        parse_problem(f"{PROBLEM} (:init {init}) (:goal ()))", domain_with("(:derived (busy) (idle))"))


# --- derived predicates --------------------------------------------------------------------


def test_rules_are_read_in_their_order() -> None:
    domain = domain_with(
        "(:derived (near ?x ?y) (linked ?x ?y)) (:derived (busy) (not (idle)))"
        " (:derived (near ?x ?y - closet) (exists (?z - room) (and (linked ?x ?z) (near ?z ?y))))"
    )
    x, y, z = (Variable(name, ROOM) for name in ("?x", "?y", "?z"))
    narrow = Variable("?x", ("closet",)), Variable("?y", ("closet",))
    assert domain.rules == (
        Rule("near", (x, y), Holds(("linked", "?x", "?y"))),
        Rule("busy", (), Not(IDLE)),
        Rule("near", narrow, Exists((z,), All((Holds(("linked", "?x", "?z")), Holds(("near", "?z", "?y")))))),
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


# --- object fluents ------------------------------------------------------------------------


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


# --- preferences ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "hard", "soft"),
    [
        ("(preference p (idle))", TRUE, (Preference("p", IDLE),)),
        ("(preference (idle))", TRUE, (Preference("", IDLE),)),
        ("(and (busy) (and (preference p (idle)) (preference P (busy))))", BUSY, (Preference("p", IDLE), Preference("p", BUSY))),
        ("(forall (?l - room) (preference p (dirty ?l)))", TRUE, (Preference("p", DIRTY, (L,)),)),
        (
            "(and (idle) (forall (?l - room) (and (dirty ?l) (forall (?r - robot) (preference p (at ?r ?l))))))",
            All((IDLE, ForAll((L,), DIRTY))),
            (Preference("p", Holds(("at", "?r", "?l")), (L, R)),),
        ),
        (
            "(forall (?l - room) (forall (?l - closet) (preference p (dirty ?l))))",
            TRUE,
            (Preference("p", DIRTY, (L, Variable("?l", ("closet",)))),),
        ),
        ("(forall (?l - room) (and))", ForAll((L,), TRUE), ()),
        ("(and (or (idle) (busy)) (preference p (imply (idle) (busy))))", Any((IDLE, BUSY)), (Preference("p", Implies(IDLE, BUSY)),)),
    ],
)
def test_preferences_are_told_apart_from_what_must_hold(text: str, hard: Condition, soft: tuple[Preference, ...]) -> None:
    problem = problem_with(f"(:goal {text})")
    assert (problem.goal, problem.preferences) == (hard, soft)
    schema = action(f":precondition {text}")
    assert (schema.precondition, schema.preferences) == (hard, soft)


def test_preferences_of_durative_actions_have_a_moment() -> None:
    schema = durative(
        ":condition (and (at start (idle)) (preference p (at start (busy))) (at end (preference q (idle)))"
        " (over all (and (busy) (preference r (idle)))) (forall (?x - room) (and (at end (dirty ?x)) (preference (over all (dirty ?x))))))"
    )
    x = Variable("?x", ROOM)
    assert (schema.precondition, schema.invariant, schema.end_condition) == (IDLE, BUSY, ForAll((x,), Holds(("dirty", "?x"))))
    assert schema.preferences == (
        Preference("p", BUSY, moment="at start"),
        Preference("q", IDLE, moment="at end"),
        Preference("r", IDLE, moment="over all"),
        Preference("", Holds(("dirty", "?x")), (x,), "over all"),
    )


def test_a_metric_counts_preferences_wherever_they_are() -> None:
    problem = problem_with(
        "(:goal (preference Wish (idle))) (:constraints (preference c (always (idle))))"
        " (:metric minimize (+ (is-violated wish) (is-violated C) (is-violated care) (is-violated law) (total-time)))",
        "(:action a :precondition (preference care (idle))) (:constraints (preference law (sometime (busy))))",
    )
    counted = tuple(ValueOf(("is-violated", name)) for name in ("Wish", "c", "care", "law"))
    assert problem.metric == Metric("minimize", Arithmetic("+", (*counted, ValueOf(("total-time",)))))


def test_a_predicate_may_be_called_preference() -> None:
    domain = parse_domain("(define (domain d) (:predicates (preference ?x)) (:action a :parameters (?x) :precondition (preference ?x)))")
    assert domain.actions["a"].precondition == Holds(("preference", "?x"))


# --- trajectory constraints ----------------------------------------------------------------

ONE_OF_EACH = (
    "(always (idle)) (sometime (busy)) (within 5 (idle)) (at-most-once (busy)) (sometime-after (idle) (busy))"
    " (sometime-before (busy) (idle)) (always-within 2.5 (idle) (busy)) (hold-during 3 5 (idle)) (hold-after 4 (busy)) (AT end (idle))"
)
EACH = (
    Constraint("always", (IDLE,)),
    Constraint("sometime", (BUSY,)),
    Constraint("within", (IDLE,), (5.0,)),
    Constraint("at-most-once", (BUSY,)),
    Constraint("sometime-after", (IDLE, BUSY)),
    Constraint("sometime-before", (BUSY, IDLE)),
    Constraint("always-within", (IDLE, BUSY), (2.5,)),
    Constraint("hold-during", (IDLE,), (3.0, 5.0)),
    Constraint("hold-after", (BUSY,), (4.0,)),
    Constraint("at end", (IDLE,)),
)


def test_constraints_of_every_kind() -> None:
    assert domain_with(f"(:constraints (and {ONE_OF_EACH}))").constraints == EACH
    problem = problem_with(f"(:goal ()) (:constraints (and {ONE_OF_EACH}))")
    assert (problem.constraints, problem.preferences) == (EACH, ())


@pytest.mark.parametrize("text", ["", "(:constraints)", "(:constraints ())", "(:constraints (and))"])
def test_there_may_be_no_constraints(text: str) -> None:
    assert problem_with(f"(:goal ()) {text}").constraints == ()


def test_constraints_hold_for_every_choice_and_may_be_wishes() -> None:
    domain = domain_with(
        "(:constraints (and (forall (?l - room) (and (always (dirty ?l)) (forall (?r - robot) (sometime (at ?r ?l)))))"
        " (forall (?l - room) (preference p (forall (?r - robot) (sometime (at ?r ?l)))))"
        " (preference q (and (always (idle)) (sometime (busy)))) (preference (within 3 (forall (?l - room) (dirty ?l))))))"
    )
    at = (Holds(("at", "?r", "?l")),)
    assert domain.constraints == (Constraint("always", (DIRTY,), variables=(L,)), Constraint("sometime", at, variables=(L, R)))
    assert domain.preferences == (
        Preference("p", (Constraint("sometime", at, variables=(R,)),), (L,)),
        Preference("q", (Constraint("always", (IDLE,)), Constraint("sometime", (BUSY,)))),
        Preference("", (Constraint("within", (ForAll((L,), DIRTY),), (3.0,)),)),
    )


def test_wishes_of_a_problem_are_goals_first() -> None:
    problem = problem_with("(:constraints (preference c (always (idle)))) (:goal (preference g (idle)))")
    assert [one.name for one in problem.preferences] == ["g", "c"]


# --- effects across moments ----------------------------------------------------------------


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


# --- task networks -------------------------------------------------------------------------

TASK = "(:task deliver :parameters (?r - robot ?l - room))"
METHOD = "(:method m ; how (\n  :parameters (?r - robot ?l - room)\n  :task (deliver ?r ?l)\n  :ordered-subtasks (and (a ?r ?l)))"
NETWORK = "(:htn :parameters () :subtasks (and (t1 (deliver r2 hall))) :ordering ())"


def test_task_networks_are_kept_as_they_stand() -> None:
    domain = domain_with(f"{TASK} {METHOD} (:action a :parameters (?r - robot ?l - room) :effect (at ?r ?l))")
    assert domain.hierarchy == (TASK, METHOD)
    assert domain.actions["a"].end_effects == (Set(("at", "?r", "?l"), Constant(True)),)
    problem = problem_with(f"{NETWORK} (:init (idle))")
    assert (problem.network, problem.goal) == (NETWORK, TRUE)


# --- the same meaning ----------------------------------------------------------------------

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


@pytest.mark.parametrize("name", SAME)
def test_what_is_written_means_the_same_to_the_planner(name: str) -> None:
    more, go, sweep, rest = SAME[name]
    texts = (
        f"{DECLARED} {more} {CLEANING.format(go=go, sweep=sweep)})",
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
    texts = f"{DECLARED} {more})", "(define (problem p) (:domain d) (:init (idle)) (:goal (and (dirty hall) (not (idle)))))"
    problem = parse_problem(texts[1], parse_domain(texts[0]))
    written = write_domain(problem.domain), write_problem(problem)
    assert parse_problem(written[1], parse_domain(written[0])) == problem
    before = outcome(*texts)
    assert before[0] == kairos.Status.SOLVED
    assert outcome(*written) == before
