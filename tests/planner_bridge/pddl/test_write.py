"""The law of writing and reading back: what is written, as PDDL or as YAML, is read as an equal model."""

from __future__ import annotations

from dataclasses import replace

import kairos
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
