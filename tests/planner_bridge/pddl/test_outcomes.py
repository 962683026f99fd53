"""Effects that may turn out in several ways, as PDDL writes them: `oneof`, `probabilistic`, and rewards, which are ignored."""

from __future__ import annotations

import pytest

from planner_bridge.pddl import parse_domain, parse_problem, write_domain
from pnm.core.logic.conditions import Holds
from pnm.core.logic.effects import Alternative, Effect, ForEach, OneOf, Set, When
from pnm.core.logic.expressions import Constant, Variable
from pnm.errors import InputError
from tests.support.pddl.text import warnings

HEAD = (
    "(define (domain d) (:requirements :adl :durative-actions :non-deterministic :probabilistic-effects)"
    " (:types room) (:predicates (p) (q) (at ?l - room))"
)
P, Q, NOT_P = Set(("p",), Constant(True)), Set(("q",), Constant(True)), Set(("p",), Constant(False))
AT = Set(("at", "?l"), Constant(True))


def likely(*ways: tuple[float, tuple[Effect, ...]]) -> OneOf:
    return OneOf(tuple(Alternative(effects, chance) for chance, effects in ways))


def one_of(*ways: tuple[Effect, ...]) -> OneOf:
    return OneOf(tuple(map(Alternative, ways)))


READ: dict[str, tuple[Effect, ...]] = {
    "(oneof (p) (q))": (one_of((P,), (Q,)),),
    "(oneof () (and) (p) (p))": (one_of((), (), (P,), (P,)),),
    "(and (q) (oneof (and (p) (q)) (not (p))))": (Q, one_of((P, Q), (NOT_P,))),
    "(oneof (oneof (p) (q)) (p))": (one_of((one_of((P,), (Q,)),), (P,)),),
    "(probabilistic 0.25 (p) 3/4 (q))": (likely((0.25, (P,)), (0.75, (Q,))),),
    "(probabilistic 0.9 (p))": (likely((0.9, (P,)), (0.1, ())),),
    "(probabilistic 1/3 (p) 0.333333 (q) 0.333333 (and))": (likely((1 / 3, (P,)), (0.333333, (Q,)), (0.333333, ())),),
    "(probabilistic 0 (p))": (likely((0.0, (P,)), (1.0, ())),),
    "(when (p) (oneof (q) (and)))": (When(Holds(("p",)), (one_of((Q,), ()),)),),
    "(forall (?l - room) (probabilistic 0.5 (at ?l)))": (ForEach((Variable("?l", ("room",)),), (likely((0.5, (AT,)), (0.5, ())),)),),
    "(oneof (when (p) (q)) (forall (?l - room) (at ?l)))": (
        one_of((When(Holds(("p",)), (Q,)),), (ForEach((Variable("?l", ("room",)),), (AT,)),)),
    ),
}
TIMED: dict[str, tuple[Effect, ...]] = {
    "(at end (oneof (p) (q)))": (one_of((P,), (Q,)),),
    "(oneof (at end (p)) (and (at end (p)) (at end (q))) ())": (one_of((P,), (P, Q), ()),),
    "(when (at start (p)) (at end (oneof (p) (q))))": (When(Holds(("p",)), (one_of((P,), (Q,)),), early=True),),
    "(oneof (when (at start (p)) (at end (q))) (at end (p)))": (one_of((When(Holds(("p",)), (Q,), early=True),), (P,)),),
}


@pytest.mark.parametrize(
    ("action", "effects"),
    [
        *((f"(:action a :effect {text})", effects) for text, effects in READ.items()),
        *((f"(:durative-action a :duration () :effect {text})", effects) for text, effects in TIMED.items()),
    ],
)
def test_outcomes_are_read_and_written_without_loss(action: str, effects: tuple[Effect, ...]) -> None:
    domain = parse_domain(f"{HEAD} {action})")
    assert domain.warnings == ()
    assert domain.actions["a"].end_effects == effects
    assert domain.uncertain == {"a"}
    assert parse_domain(write_domain(domain)) == domain


def test_a_predicate_may_have_the_name_of_a_word_for_outcomes() -> None:
    domain = parse_domain("(define (domain d) (:predicates (oneof ?x)) (:constants c) (:action a :effect (oneof c)))")
    assert domain.actions["a"].end_effects == (Set(("oneof", "c"), Constant(True)),)


def test_an_outcome_that_deletes_what_is_added_besides_is_warned_of() -> None:
    domain = parse_domain(f"{HEAD}\n (:action a :effect (and (p) (oneof (and) (not (p)) (q)))))")
    assert warnings(domain) == ["2:2: warning: the outcome 2 of a both deletes and adds (p), so it is true after it"]


def test_an_action_of_its_own_may_have_too_many_outcomes() -> None:
    several = " ".join(f"(oneof (at {name}) (and))" for name in "abcdefg")
    with pytest.raises(InputError, match=r"2:2: an action may turn out in more than 64 ways; expected 64 at most"):
        parse_domain(f"{HEAD} (:constants a b c d e f g - room)\n (:action a :effect (and {several})))")


def test_too_many_outcomes_are_refused_with_the_problem() -> None:
    domain = parse_domain(f"{HEAD} (:action a :effect (forall (?l - room) (oneof (at ?l) (and)))))")
    text = "(define (problem p) (:domain d)\n (:objects {} - room) (:goal (p)))"
    assert parse_problem(text.format("a b c d e f"), domain).warnings == ()
    with pytest.raises(InputError, match=r"2:2: a: an action may turn out in more than 64 ways; expected 64 at most"):
        parse_problem(text.format("a b c d e f g"), domain)


def test_rewards_are_ignored_with_a_warning_unless_declared() -> None:
    action = "(:action a :effect (and (p) (increase (reward) 10)))"
    domain = parse_domain(f"{HEAD} {action})")
    assert domain.actions["a"].end_effects == (P,)
    assert warnings(domain) == ["1:180: warning: rewards are ignored: (increase ...)"]
    declared = parse_domain(f"{HEAD} (:functions (reward)) {action})")
    assert len(declared.actions["a"].end_effects) == 2
