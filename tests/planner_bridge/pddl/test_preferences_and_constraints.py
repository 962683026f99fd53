"""Preferences, trajectory constraints and task networks: kept as they are, and written so that they mean the same."""

from __future__ import annotations

import pytest

from planner_bridge.model.problem import Metric
from planner_bridge.pddl import parse_domain
from pnm.core.logic.conditions import TRUE, All, Any, Condition, ForAll, Holds, Implies
from pnm.core.logic.domain import Preference
from pnm.core.logic.effects import Set
from pnm.core.logic.expressions import Arithmetic, Constant, ValueOf, Variable
from pnm.core.logic.trajectory import Constraint
from tests.support.pddl.text import EXTENDED

domain_with, problem_with, action, durative = EXTENDED.domain_with, EXTENDED.problem_with, EXTENDED.action, EXTENDED.durative
HALL, ROOM, ROBOT = Constant("hall"), ("room",), ("robot",)
R, L = Variable("?r", ROBOT), Variable("?l", ROOM)
IDLE, BUSY = Holds(("idle",)), Holds(("busy",))
DIRTY = Holds(("dirty", "?l"))


# --- preferences ---


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


# --- trajectory constraints ---


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


TASK = "(:task deliver :parameters (?r - robot ?l - room))"
METHOD = "(:method m ; how (\n  :parameters (?r - robot ?l - room)\n  :task (deliver ?r ?l)\n  :ordered-subtasks (and (a ?r ?l)))"
NETWORK = "(:htn :parameters () :subtasks (and (t1 (deliver r2 hall))) :ordering ())"


# --- task networks ---


def test_task_networks_are_kept_as_they_stand() -> None:
    domain = domain_with(f"{TASK} {METHOD} (:action a :parameters (?r - robot ?l - room) :effect (at ?r ?l))")
    assert domain.hierarchy == (TASK, METHOD)
    assert domain.actions["a"].end_effects == (Set(("at", "?r", "?l"), Constant(True)),)
    problem = problem_with(f"{NETWORK} (:init (idle))")
    assert (problem.network, problem.goal) == (NETWORK, TRUE)
