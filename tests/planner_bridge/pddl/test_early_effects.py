"""Effects that are decided at the start mean the same to the planner when they are written."""

from __future__ import annotations

import kairos
import pytest

from planner_bridge.pddl import parse_domain, parse_problem, write_domain, write_problem
from pnm.core.logic.conditions import Holds
from pnm.core.logic.effects import Effect, ForEach, Set, When
from pnm.core.logic.expressions import Constant, Variable
from tests.support.pddl.text import EXTENDED

domain_with, problem_with, action, durative = EXTENDED.domain_with, EXTENDED.problem_with, EXTENDED.action, EXTENDED.durative
HALL, ROOM, ROBOT = Constant("hall"), ("room",), ("robot",)
R, L = Variable("?r", ROBOT), Variable("?l", ROOM)
IDLE, BUSY = Holds(("idle",)), Holds(("busy",))
SET_IDLE, SET_BUSY = Set(("idle",), Constant(True)), Set(("busy",), Constant(True))
DIRTY = Holds(("dirty", "?l"))


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
        ("(when (at end (idle)) (when (at start (busy)) (at end (idle))))", (), (When(IDLE, (When(BUSY, (SET_IDLE,), early=True),)),)),
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
    result = kairos.Planner().solve(parsed, timeout=60, anytime=False, threads=1)
    return result.status, result.plan.cost if result.plan else None


# --- the same meaning ---


@pytest.mark.parametrize("name", SAME)
def test_what_is_written_means_the_same_to_the_planner(name: str) -> None:
    more, go, sweep, rest = SAME[name]
    texts = (f"{EXTENDED.domain} {more} {CLEANING.format(go=go, sweep=sweep)})", f"(define (problem p) (:domain d) {ROOMS} {rest})")
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
