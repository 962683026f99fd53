"""Requirements that are missing are warned about, and plain PDDL has no warnings."""

from __future__ import annotations

from pathlib import Path

import pytest

from planner_bridge.model.problem import Domain
from planner_bridge.pddl import parse_domain, parse_problem, read_domain
from planner_bridge.pipeline.loading import load, warning_lines
from pnm.core.logic.conditions import All, Compare
from pnm.core.logic.domain import Declaration
from pnm.core.logic.expressions import Constant, ValueOf
from pnm.errors import Position, Tolerated
from tests.support.pddl.files import OWN, Pair, name_of
from tests.support.pddl.text import DECLARING, warnings

domain_with = DECLARING.domain_with

NEEDED = {
    "(:types t)": ":typing",
    "(:predicates (q ?x - object))": ":typing",
    "(:action a :precondition (or (p) (p)))": ":disjunctive-preconditions",
    "(:action a :precondition (imply (p) (p)))": ":disjunctive-preconditions",
    "(:action a :precondition (not (p)))": ":negative-preconditions",
    "(:action a :precondition (not (and (p) (p))))": ":disjunctive-preconditions",
    "(:action a :precondition (forall (?x) (p)))": ":universal-preconditions",
    "(:action a :precondition (exists (?x) (p)))": ":existential-preconditions",
    "(:action a :parameters (?x) :precondition (= ?x ?x))": ":equality",
    "(:action a :precondition (> (n) 3))": ":numeric-fluents",
    "(:action a :precondition (preference (p)))": ":preferences",
    "(:action a :effect (when (p) (p)))": ":conditional-effects",
    "(:action a :effect (forall (?x) (p)))": ":conditional-effects",
    "(:action a :effect (increase (n) 1))": ":numeric-fluents",
    "(:action a :effect (increase (total-cost) (n)))": ":action-costs",
    "(:action a :effect (increase (total-cost) (+ (n) 1)))": ":numeric-fluents",
    "(:action a :effect (oneof (p) (and)))": ":non-deterministic",
    "(:action a :effect (probabilistic 1 (p)))": ":probabilistic-effects",
    "(:durative-action a :duration ())": ":durative-actions",
    "(:derived (p) (p))": ":derived-predicates",
    "(:constraints (always (p)))": ":constraints",
    "(:task t)": ":hierarchy",
    "(:functions (f) - object)": ":object-fluents :typing",
    "(:durative-action a :duration (<= ?duration 3))": ":duration-inequalities :durative-actions",
    "(:durative-action a :duration (= ?duration (n)))": ":numeric-fluents :durative-actions",
    "(:durative-action a :duration () :effect (at end (when (p) (p))))": ":conditional-effects :durative-actions",
    "(:durative-action a :duration () :effect (when (at end (p)) (at end (p))))": ":conditional-effects :durative-actions",
    "(:durative-action a :duration () :condition (forall (?x) (at end (p))))": ":universal-preconditions :durative-actions",
}
"""Parts of domains, and the requirements of each: the one that is missing is the first."""
FORMULAS = {":disjunctive-preconditions", ":negative-preconditions", ":equality", ":conditional-effects", ":typing"}
QUANTIFIED = {":universal-preconditions", ":existential-preconditions"}
IMPLIED = {":adl": FORMULAS | QUANTIFIED, ":fluents": {":numeric-fluents", ":object-fluents"}, ":quantified-preconditions": QUANTIFIED}


def needed(text: str, *words: str) -> list[str]:
    """The warnings about what a domain with these requirements needs besides."""
    head = f"(define (domain d) (:requirements :strips {' '.join(words)}) (:predicates (p)) (:functions (n) (total-cost))"
    return [one for one in warnings(parse_domain(f"{head}\n{text})")) if "a second" not in one]


# --- requirements ---


@pytest.mark.parametrize("text", NEEDED)
def test_what_is_used_should_be_required(text: str) -> None:
    word, *given = NEEDED[text].split()
    assert [one.partition(" warning: ")[2] for one in needed(text, *given)] == [f"{word} is needed here but not among the :requirements"]
    assert needed(text, word, *given) == []
    for short, words in IMPLIED.items() if not given else ():
        assert bool(needed(text, short)) is (word not in words and (short, word) != (":fluents", ":action-costs"))


def test_a_missing_requirement_is_told_once() -> None:
    found = needed("(:action a :precondition (not (p)))\n(:action b :precondition (not (p)))")
    assert found == ["2:26: warning: :negative-preconditions is needed here but not among the :requirements"]


def test_a_problem_has_the_requirements_of_its_domain_and_its_own() -> None:
    domain = parse_domain("(define (domain d) (:requirements :typing :preferences) (:types t) (:predicates (p ?x - t)))")
    text = "(define (problem p) (:domain d) {} (:objects a - t) (:init (at 5 (p a))) (:goal (and (p a) (preference (p a)))))"
    assert warnings(parse_problem(text.format(""), domain)) == [
        "1:58: warning: :timed-initial-literals is needed here but not among the :requirements"
    ]
    problem = parse_problem(text.format("(:requirements :timed-initial-literals)"), domain)
    assert (problem.requirements, problem.warnings) == ((":timed-initial-literals",), ())


# --- what is plain PDDL has no warnings ---


@pytest.mark.parametrize("pair", OWN, ids=name_of)
def test_our_own_files_have_no_warnings(pair: Pair) -> None:
    assert load(*pair).warnings == ()


CORRECT = (
    "(define (domain Clean) (:requirements :strips :typing :fluents :durative-actions :duration-inequalities)"
    " (:constants) (:functions (cost) (f ?x - (either a b)) - number) (:predicates (a ?a - a) (a-b ?x ?y - (either a b) ?z) (2nd))"
    " (:action 2nd :parameters (?2 - a) :precondition (a ?2) :effect (and (2nd) (assign cost 3)))"
    " (:durative-action a :parameters (?a -a?b - b) :duration (and (>= ?duration 1) (<= ?duration (f ?a)))"
    " :condition (and) :effect (and (at end (A ?a)) (at end (increase (COST) ?duration))))"
    " (:types a b - object object))"
)


def test_correct_pddl_has_no_warnings() -> None:
    domain = parse_domain(CORRECT)
    assert domain.warnings == ()
    problem = parse_problem(
        "(define (problem clean) (:init (a a) (not (2nd)) (= cost 0) (= (f a) 3)) (:objects a - a b - b free) (:domain clean)"
        " (:goal (A-B a b FREE)) (:metric minimize (+ total-time (cost))))",
        domain,
    )
    assert problem.warnings == ()
    assert problem.own_objects == {"a": ("a",), "b": ("b",), "free": ("object",)}


PLAIN = "(define (domain d)\n  ; caf\u00e9\n\t(:predicates (p)))\n"


# --- bytes ---


@pytest.mark.parametrize(
    ("raw", "expected"),
    [
        (PLAIN.encode(), []),
        (b"\xef\xbb\xbf" + PLAIN.encode(), []),
        (PLAIN.encode("latin-1"), ["2:8: warning: byte 0xe9 is not UTF-8; the file is read as Latin-1"]),
        (PLAIN.encode("utf-16"), ["1:1: warning: the file is in UTF-16; expected UTF-8"]),
        (b"\xfe\xff" + PLAIN.encode("utf-16-be"), ["1:1: warning: the file is in UTF-16; expected UTF-8"]),
        (PLAIN.replace("\n", "\r").encode(), []),
        (PLAIN.replace("\n", "\r\n").encode(), []),
        (PLAIN.replace("\n", "\n\f\v\u00a0").encode(), []),
    ],
)
def test_texts_come_in_many_encodings(tmp_path: Path, raw: bytes, expected: list[str]) -> None:
    (tmp_path / "d.pddl").write_bytes(raw)
    domain = read_domain(tmp_path / "d.pddl")
    assert domain == Domain("d", predicates={"p": Declaration("p")})
    assert warnings(domain) == expected


# --- how it is told ---


def test_no_more_than_twenty_warnings_of_a_file_are_shown() -> None:
    many = [Tolerated("odd", Position("a.pddl", line, 1)) for line in range(1, 24)]
    lines = list(warning_lines([*many, Tolerated("even", Position("b.pddl", 1, 1))]))
    assert lines == [*(f"a.pddl:{line}:1: warning: odd" for line in range(1, 21)), "a.pddl: 3 more warnings", "b.pddl:1:1: warning: even"]


def test_large_files_are_read_with_as_many_warnings() -> None:
    facts = "\n".join(f"(at-room r{index} room{index % 50}) (at-room r{index} room{index % 50})" for index in range(10_000))
    robots = " ".join(f"r{index}" for index in range(10_000) if index != 2)
    rooms = " ".join(f"room{index}" for index in range(50))
    text = f"{DECLARING.problem} (:objects {robots} - robot {rooms} - room) (:init {facts}) (:goal (idle)))"
    problem = parse_problem(text, domain_with(""))
    assert (len(problem.init), len(problem.warnings)) == (10_000, 10_001)


def test_a_function_and_an_object_of_one_name_are_told_apart() -> None:
    domain = parse_domain(
        "(define (domain d) (:requirements :equality :fluents) (:constants c) (:functions (c))"
        " (:action a :parameters (?x) :precondition (and (= ?x c) (= (c) 3) (= c c))))"
    )
    assert domain.actions["a"].precondition == All(
        (
            Compare("=", Constant("?x"), Constant("c")),
            Compare("=", ValueOf(("c",)), Constant(3.0)),
            Compare("=", Constant("c"), Constant("c")),
        )
    )
