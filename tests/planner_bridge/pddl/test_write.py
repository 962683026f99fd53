"""The law of writing and reading back, as PDDL or as YAML: an equal model, which means the same to the planner."""

from __future__ import annotations

from dataclasses import replace

import kairos
import pytest
from hypothesis import given, settings, strategies as st

from planner_bridge.model.problem import Domain, Problem
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.pddl.expressions import number_text
from planner_bridge.pddl.writer import write_domain, write_problem
from planner_bridge.yaml.reader import parse
from planner_bridge.yaml.writer import write_domain as domain_as_yaml, write_problem as problem_as_yaml
from tests.support.files import input_error
from tests.support.pddl.models import DOMAINS, NUMBERS, PROBLEMS
from tests.support.pddl.text import EXTENDED, SMALL

domain_with = SMALL.domain_with


@settings(max_examples=15)
@given(DOMAINS)
def test_a_written_domain_reads_as_an_equal_one(domain: Domain) -> None:
    in_yaml = parse(domain_as_yaml(domain), "x.yaml")
    assert in_yaml.problem is None
    for again in (parse_domain(write_domain(domain)), in_yaml.domain):
        assert again == domain
        assert [list(part) for part in (again.types, again.actions)] == [list(part) for part in (domain.types, domain.actions)]
    if not domain.uncertain:
        kairos.parse_domain(write_domain(replace(domain, hierarchy=())))


@settings(max_examples=15)
@given(PROBLEMS)
def test_a_written_problem_reads_as_an_equal_one(problem: Problem) -> None:
    assert parse_problem(write_problem(problem), problem.domain) == problem == parse(problem_as_yaml(problem), "x.yaml").problem
    kairos.parse_problem(write_problem(replace(problem, network="")), kairos.parse_domain(write_domain(problem.domain)))


@given(NUMBERS)
def test_numbers_are_written_exactly_and_without_an_exponent(number: float) -> None:
    text = number_text(number)
    assert float(text) == number
    assert set(text) <= set("-.0123456789")


def test_the_layout_is_for_people() -> None:
    text = write_domain(domain_with("(:durative-action go :parameters (?r - robot ?a ?b - room) :duration (= ?duration 2.50)"
        " :condition (and (at start (at ?r ?a)) (over all (idle)) (at start (> (charge ?r) 0.1)) (at end (idle)))"
        " :effect (and (at start (not (at ?r ?a))) (at end (at ?r ?b))))"))  # fmt: skip
    assert text == (
        "(define (domain d)\n"
        "  (:types\n"
        "    robot room - thing\n"
        "    thing - object)\n"
        "  (:constants\n"
        "    hall - room)\n"
        "  (:predicates\n"
        "    (at ?r - robot ?l - room)\n"
        "    (idle))\n"
        "  (:functions\n"
        "    (charge ?r - robot)\n"
        "    (total-cost))\n"
        "  (:durative-action go\n"
        "    :parameters (?r - robot ?a ?b - room)\n"
        "    :duration (= ?duration 2.5)\n"
        "    :condition (and\n"
        "      (at start (at ?r ?a))\n"
        "      (at start (> (charge ?r) 0.1))\n"
        "      (over all (idle))\n"
        "      (at end (idle)))\n"
        "    :effect (and (at start (not (at ?r ?a))) (at end (at ?r ?b)))))\n"
    )


WORDS = """( ) ? ?x - : :effect and at start end not = 3 ?duration when forall either é ; preference always within :derived
    :constraints home undefined is-violated assign over all :vars :htn"""


DOMAIN = (
    f"{EXTENDED.domain} (:derived (busy) (not (idle))) (:constraints (within 5 (forall (?x - room) (dirty ?x)))) (:task t)"
    " (:durative-action later :parameters (?r - robot) :duration (<= ?duration 5)"
    " :condition (and (at start (= (charge ?r) ?duration)) (at end (forall (?x - room) (dirty ?x))) (preference care (at end (idle))))"
    " :effect (and (at start (forall (?x - room) (when (idle) (not (dirty ?x))))) (at end (increase (charge ?r) (+ 1 (charge ?r))))"
    " (when (at start (idle)) (at end (assign (home ?r) undefined)))))"
    " (:action now :parameters () :precondition (or (idle) (imply (idle) (dirty hall))) :effect (when (idle) (dirty hall))))"
)
PROBLEM = (
    f"{EXTENDED.problem} (:init (idle) (= (charge r2) 3) (= (home r2) hall) (at 5 (not (idle))))"
    " (:goal (and (idle) (preference p (idle)))) (:constraints (preference q (always (idle)))))"
)


@given(st.data())
def test_a_damaged_text_is_read_or_refused_with_a_position(data: st.DataObject) -> None:
    is_problem, domain = data.draw(st.booleans()), parse_domain(DOMAIN)
    words = (PROBLEM if is_problem else DOMAIN).replace("(", " ( ").replace(")", " ) ").split()
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(words) - 1))
        words[at : at + data.draw(st.integers(0, 2))] = data.draw(st.lists(st.sampled_from([*WORDS.split(), *words[:40]]), max_size=2))
    text = " ".join(words)
    error = input_error(lambda: parse_problem(text, domain) if is_problem else parse_domain(text))
    assert error is None or error.position is not None


# --- the same meaning ---


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
