"""What is beyond facts and numbers means the same to the planner when it is written."""

from __future__ import annotations

import kairos
import pytest

from planner_bridge.pddl import parse_domain, parse_problem, write_domain, write_problem
from tests.support.pddl.text import EXTENDED

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


WAITING = (
    "(:durative-action wait :parameters () :duration (= ?duration 2) :condition (at start (not (busy)))"
    " :effect (and (at start (busy)) (at end (not (busy))) (when (at start (idle)) (at end (dirty hall)))"
    " (when (and (at start (idle)) (at end (busy))) (at end (not (idle))))))"
)
TEXTS = {
    name: (f"{EXTENDED.domain} {more} {CLEANING.format(go=go, sweep=sweep)})", f"(define (problem p) (:domain d) {ROOMS} {rest})")
    for name, (more, go, sweep, rest) in SAME.items()
}
TEXTS["decided at the start"] = (
    f"{EXTENDED.domain} {WAITING})",
    "(define (problem p) (:domain d) (:init (idle)) (:goal (and (dirty hall) (not (idle)))))",
)


def outcome(domain: str, problem: str) -> tuple[object, object]:
    parsed = kairos.parse_problem(problem, kairos.parse_domain(domain))
    result = kairos.Planner().solve(parsed, timeout=60, anytime=False, threads=1)
    return result.status, result.plan.cost if result.plan else None


@pytest.mark.parametrize("texts", TEXTS.values(), ids=TEXTS)
def test_what_is_written_means_the_same_to_the_planner(texts: tuple[str, str]) -> None:
    problem = parse_problem(texts[1], parse_domain(texts[0]))
    assert problem.warnings == ()
    written = write_domain(problem.domain), write_problem(problem)
    assert parse_problem(written[1], parse_domain(written[0])) == problem
    before = outcome(*texts)
    assert before[0] == kairos.Status.SOLVED
    assert outcome(*written) == before
