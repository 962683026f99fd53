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
from pnm.core.logic.conditions import All, Any, Compare, ForAll, Implies, Not
from pnm.core.logic.domain import ActionSchema, DurationConstraint, Preference
from pnm.core.logic.effects import ForEach, Set, TimedChange, When
from pnm.core.logic.expressions import DURATION, UNDEFINED, Arithmetic, Constant, Fluent, ValueOf, Variable
from pnm.core.logic.rules import DerivationRule, Rules
from pnm.core.logic.trajectory import Constraint
from tests.support.files import input_error
from tests.support.pddl.models import DOMAINS, NUMBERS, OWN, PROBLEMS, domain_of
from tests.support.pddl.text import CHARGE, IDLE, NOT_IDLE, SET_IDLE, SMALL

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


@given(st.data())
def test_a_damaged_text_is_read_or_refused_with_a_position(data: st.DataObject) -> None:
    domain = replace(
        domain_of([SAMPLE, EARLY]), rules=Rules((DerivationRule("calm", OWN, Not(IDLE)),)), constraints=(LAW,), hierarchy=("(:task t)",)
    )
    init: dict[Fluent, bool | float | str] = {("idle",): True, ("charge", "R1"): 3.0, ("home", "R1"): "hall"}
    wishes = Preference("p", IDLE, (Variable("?x"),)), Preference("q", (LAW,))
    texts = (
        write_domain(domain),
        write_problem(Problem("p", domain, init=init, timed=SOON, goal=IDLE, preferences=wishes, constraints=(LAW,))),
    )
    which = data.draw(st.integers(0, 1))
    words = texts[which].replace("(", " ( ").replace(")", " ) ").split()
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(words) - 1))
        words[at : at + data.draw(st.integers(0, 2))] = data.draw(st.lists(st.sampled_from([*WORDS.split(), *words[:40]]), max_size=2))
    text = " ".join(words)
    error = input_error(lambda: parse_problem(text, domain) if which else parse_domain(text))
    assert error is None or error.position is not None


SOON = (TimedChange(5.0, {("idle",): False, ("charge", "R1"): 1.0}),)
LAW = Constraint("within", (ForAll((Variable("?x"),), IDLE),), (5.0,), (Variable("?r", ("robot",)),))
SAMPLE = ActionSchema(
    "later",
    OWN,
    precondition=All((IDLE, Compare("=", CHARGE, ValueOf(DURATION)))),
    end_condition=ForAll((Variable("?x"),), Not(IDLE)),
    start_effects=(ForEach((Variable("?x"),), (When(IDLE, (NOT_IDLE,)), SET_IDLE)),),
    end_effects=(
        Set(("charge", "?r"), Arithmetic("+", (Constant(1.0), CHARGE)), "increase"),
        When(IDLE, (Set(("home", "?r"), Constant(UNDEFINED)),), early=True),
    ),
    preferences=(Preference("care", IDLE, moment="at end"),),
    duration=(DurationConstraint("<=", Constant(5.0)),),
)
EARLY = ActionSchema("now", OWN, precondition=Any((IDLE, Implies(IDLE, IDLE))), end_effects=(When(IDLE, (SET_IDLE,)),))
