"""What is not as it should be but can be understood: read as it was meant, and told with its position."""

from __future__ import annotations

from pathlib import Path

import kairos
import pytest

from planner_bridge.loading import load, warning_lines
from planner_bridge.model.problem import Borrowed, Domain, Problem
from planner_bridge.pddl import parse_domain, parse_problem, read_domain, write_domain, write_problem
from pnm.core.logic.conditions import TRUE, All, Any, Compare, Holds, Not
from pnm.core.logic.domain import Declaration, DurationConstraint
from pnm.core.logic.expressions import Constant, ValueOf, Variable
from pnm.errors import InputError, Position, Tolerated
from tests.support.files import ROOT

WORDS = ":requirements :typing :action-costs :negative-preconditions"
DECLARED = (
    f"(define (domain d) ({WORDS}) (:types robot room - thing) (:constants hall - room)"
    " (:predicates (at-room ?r - robot ?l - room) (idle)) (:functions (charge ?r - robot) (total-cost))"
)
"""One line, so that what a test adds stands in line 2."""
PROBLEM = "(define (problem p) (:domain d) (:objects r2 - robot kitchen - room)"


def domain_with(text: str) -> Domain:
    return parse_domain(f"{DECLARED}\n{text})")


def problem_with(text: str) -> Problem:
    return parse_problem(f"{PROBLEM}\n{text})", domain_with(""))


def warnings(model: Domain | Problem) -> list[str]:
    return [str(one).partition(".pddl:")[2] for one in model.warnings]


# --- domains -------------------------------------------------------------------------------

SECOND = "read as part of the first in line 1"
DOMAINS = [
    (
        "(:requirements :foo typing)",
        [
            f"2:1: warning: a second :requirements section, {SECOND}",
            "2:16: warning: unknown requirement ':foo'",
            "2:21: warning: 'typing' is read as ':typing'",
        ],
    ),
    (
        "(:types a - b a - c object d - object)",
        [f"2:1: warning: a second :types section, {SECOND}", "2:15: warning: the type 'a' is declared twice; it is of all the kinds given"],
    ),
    (
        "(:types - a)",
        [f"2:1: warning: a second :types section, {SECOND}", "2:9: warning: there is no name before the type 'a'; it is ignored"],
    ),
    (
        "(:constants HALL - room)",
        [f"2:1: warning: a second :constants section, {SECOND}", "2:13: warning: the object 'HALL' is declared twice"],
    ),
    (
        "(:predicates (idle) (p ?x ?x))",
        [
            f"2:1: warning: a second :predicates section, {SECOND}",
            "2:14: warning: the predicate 'idle' is declared twice, the first time in line 1; it takes the types of both",
            "2:27: warning: the variable '?x' is there twice",
        ],
    ),
    ("(:action a :parameters (? r - robot) :effect (at-room ?r hall))", ["2:25: warning: '? r' is read as '?r'"]),
    ("(:action a :vars (?r - robot) :effect (at-room ?r hall))", ["2:18: warning: the variables of :vars are read as further parameters"]),
    (
        "(:action a :effect (at_room r hall))",
        [
            "2:21: warning: the predicate 'at_room' is read as 'at-room'",
            "2:29: warning: the object 'r' is not among the :constants; every problem has to declare it",
        ],
    ),
    ("(:action a :effect (increase (total_cost) 1))", ["2:31: warning: the function 'total_cost' is read as 'total-cost'"]),
    (
        "(:action a :precondition (and (xyz hall) (not (xyz hall))))",
        [
            "2:32: warning: the predicate 'xyz' is not declared; it is read as false",
            "2:48: warning: the predicate 'xyz' is not declared; it is read as false",
        ],
    ),
    (
        "(:derived (p ?x - room) (idle))",
        [
            "2:1: warning: :derived-predicates is needed here but not among the :requirements",
            "2:11: warning: the predicate 'p' is derived here but not among the :predicates",
        ],
    ),
    (
        "(:constraints (always (idle)) (sometime (idle)))",
        [
            "2:15: warning: :constraints is needed here but not among the :requirements",
            "2:31: warning: several constraints without 'and' around them; all of them count",
        ],
    ),
    ("))\n ; the end\n )", ["2:2: warning: this ')' closes nothing"]),
]


@pytest.mark.parametrize(("text", "expected"), DOMAINS, ids=[text for text, _ in DOMAINS])
def test_domains_are_read_with_warnings(text: str, expected: list[str]) -> None:
    domain = domain_with(text)
    assert warnings(domain) == expected
    assert parse_domain(write_domain(domain)) == domain


def test_what_is_tolerated_is_read_as_it_was_meant() -> None:
    domain = domain_with(
        "(:types a - b a - c) (:constants hall - a both - robot both - room) (:predicates (IDLE) (p ?x - robot) (P ?y - room))"
        " (:action x :parameters (?r - robot) :vars (?l - room) :precondition (and (at_room ?r ?l) (not (xyz ?l))))"
        " (:derived (q ?x - room) (idle))"
    )
    assert domain.types == {"robot": ("thing",), "room": ("thing",), "thing": (), "a": ("b", "c"), "b": (), "c": ()}
    assert domain.constants == {"hall": ("room", "a"), "both": ("robot", "room")}
    assert domain.predicates["p"] == Declaration("p", (Variable("?x", ("robot", "room")),))
    assert domain.predicates["q"] == Declaration("q", (Variable("?x", ("room",)),))
    action = domain.actions["x"]
    assert action.parameters == (Variable("?r", ("robot",)), Variable("?l", ("room",)))
    assert action.precondition == All((Holds(("at-room", "?r", "?l")), Not(Any(()))))


def test_a_type_in_one_section_says_nothing_of_names_in_another() -> None:
    domain = parse_domain("(define (domain d) (:types t) (:constants a) (:constants b - t) (:functions (f)) (:functions (g) - t))")
    assert domain.constants == {"a": ("object",), "b": ("t",)}
    assert (domain.functions["f"].values, domain.functions["g"].values) == ((), ("t",))


DURATIVE = "(:durative-action a :duration {} :condition {})"
TIMED = [
    ("(<= 3 ?duration)", "()", DurationConstraint(">=", Constant(3.0)), "2:31: warning: ?duration is expected first"),
    ("()", "(not (at start (idle)))", Not(Holds(("idle",))), "2:45: warning: (not ...) is expected inside (at start ...)"),
    (
        "()",
        "(or (at start (idle)) (at start (at-room r hall)))",
        Any((Holds(("idle",)), Holds(("at-room", "r", "hall")))),
        "2:45: warning: (or ...) is expected inside (at start ...)",
    ),
]


@pytest.mark.parametrize(("duration", "condition", "meant", "warning"), TIMED, ids=[warning for *_, warning in TIMED])
def test_timed_parts_may_be_the_other_way_round(duration: str, condition: str, meant: object, warning: str) -> None:
    domain = domain_with(DURATIVE.format(duration, condition))
    assert warning in warnings(domain)
    schema = domain.actions["a"]
    assert (schema.duration[0] if schema.duration else schema.precondition) == meant


# --- the total cost, and objects of the problem --------------------------------------------

COSTLY = "(define (domain d) (:requirements :action-costs) (:predicates (p))\n(:action a :effect (and (p) (increase (total-cost) 2))))"
METRIC = "(define (problem p) (:domain d) (:init (= (total-cost) 0)) (:goal (p)) (:metric minimize (total-cost)))"


def test_the_total_cost_need_not_be_declared() -> None:
    domain = parse_domain(COSTLY)
    assert warnings(domain) == ["2:40: warning: the function 'total-cost' is not declared; it is read as (total-cost) - number"]
    assert domain.functions == {"total-cost": Declaration("total-cost")}
    problem = parse_problem(METRIC, domain)
    assert problem.warnings == domain.warnings
    read = kairos.parse_problem(write_problem(problem), kairos.parse_domain(write_domain(problem.domain)))
    result = kairos.Planner().solve(read, timeout=5, anytime=False, threads=1)
    assert result.plan.cost == 2


def test_a_problem_may_count_a_cost_that_no_action_has() -> None:
    domain = parse_domain("(define (domain d) (:requirements :action-costs) (:predicates (p)))")
    problem = parse_problem(METRIC, domain)
    assert warnings(problem) == ["1:44: warning: the function 'total-cost' is not declared; it is read as (total-cost) - number"]
    assert problem.domain.functions == {"total-cost": Declaration("total-cost")}
    assert problem.init == {("total-cost",): 0.0}


BORROWING = "(:action a :parameters (?r - robot) :precondition (at-room ?r Dock) :effect (not (at-room ?r dock)))"


def test_actions_may_name_objects_that_problems_declare() -> None:
    domain = domain_with(BORROWING)
    position = Position("domain.pddl", 2, 63)
    assert domain.borrowed == {"Dock": Borrowed(("room",), position)}
    assert domain.borrowed["Dock"].position == position
    problem = parse_problem("(define (problem p) (:domain d) (:objects DOCK - room) (:init) (:goal (not (idle))))", domain)
    assert problem.own_objects == {"Dock": ("room",)}
    again = parse_domain(write_domain(domain))
    assert again == domain
    assert parse_problem(write_problem(problem), again) == problem


@pytest.mark.parametrize(
    ("objects", "message"),
    [
        ("r2 - robot", "1:1: the object 'Dock' is not declared; the domain names it at domain.pddl:2:63"),
        ("dock - robot", "1:1: 'Dock' is of type robot; the domain expects room"),
    ],
)
def test_and_then_problems_have_to(objects: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_problem(f"(define (problem p) (:domain d) (:objects {objects}) (:goal (idle)))", domain_with(BORROWING))
    assert str(caught.value) == f"problem.pddl:{message}"


# --- problems ------------------------------------------------------------------------------

PROBLEMS = [
    (
        "(:objects HALL - room r2 - room)",
        [
            f"2:1: warning: a second :objects section, {SECOND}",
            "2:11: warning: the object 'HALL' is declared twice",
            "2:23: warning: the object 'r2' is declared twice: as room here, as robot before; it is of both types",
        ],
    ),
    (
        "(:init (idle) (IDLE) (= (charge r2) 1) (= (charge r2) 1.0))",
        ["2:15: warning: (idle) is there twice", "2:40: warning: (charge r2) is there twice"],
    ),
    (
        "(:init (xyz r2) (not (xyz)) (at 5 (xyz)) (= (fuel) 3))",
        [
            "2:8: warning: the predicate 'xyz' is not declared; the fact is ignored",
            "2:22: warning: the predicate 'xyz' is not declared; the fact is ignored",
            "2:29: warning: :timed-initial-literals is needed here but not among the :requirements",
            "2:35: warning: the predicate 'xyz' is not declared; the fact is ignored",
            "2:42: warning: the function (fuel) is not declared; its value is ignored",
        ],
    ),
    ("(:init (idle r2))", ["2:8: warning: (idle) takes 0 arguments, found 1; the fact is ignored"]),
    ("(:init (= (charge r2) 1) (= (charge r2) 2))", ["2:26: warning: (charge r2) has another value before; this one is used"]),
    ("(:init (assign (charge r2) 5))", ["2:8: warning: 'assign' is read as '='"]),
    ("(:length (:serial 3))", ["2:1: warning: ':length' is ignored"]),
    ("(:goal (not (idle)))", ["2:1: warning: a second :goal section, read as part of the first in line 2"]),
]


@pytest.mark.parametrize(("text", "expected"), PROBLEMS, ids=[text for text, _ in PROBLEMS])
def test_problems_are_read_with_warnings(text: str, expected: list[str]) -> None:
    problem = parse_problem(f"{PROBLEM}\n{text} (:goal (not (idle))))", domain_with(""))
    if "a second :goal" in expected[0]:
        expected = [warning.replace("2:1", f"2:{len(text) + 2}") for warning in expected]
    assert warnings(problem) == expected
    assert parse_problem(write_problem(problem), problem.domain) == problem


def test_the_name_of_the_domain_may_differ_or_be_missing() -> None:
    other = parse_problem("(define (problem p)\n(:domain e) (:goal (idle)))", domain_with(""))
    assert warnings(other) == ["2:10: warning: the problem is for a domain 'e'; this one is 'd'"]
    nameless = parse_problem("(define (problem p) (:goal (idle)))", domain_with(""))
    assert warnings(nameless) == ["1:1: warning: the problem does not name its domain; expected (:domain d)"]


def test_there_may_be_no_goal() -> None:
    problem = problem_with("")
    assert warnings(problem) == ["1:1: warning: there is no :goal; any state will do"]
    assert problem.goal == TRUE


def test_of_two_values_the_last_is_used() -> None:
    assert problem_with("(:init (= (charge r2) 1) (= (charge r2) 2)) (:goal ())").init == {("charge", "r2"): 2.0}


def test_an_object_declared_twice_is_of_both_types() -> None:
    problem = problem_with("(:objects r2 - room hall - robot kitchen) (:goal (at-room r2 hall))")
    assert problem.own_objects == {"r2": ("robot", "room"), "kitchen": ("room",), "hall": ("room", "robot")}
    assert problem.objects["hall"] == ("room", "robot")


def test_a_problem_tells_what_was_wrong_with_its_domain_first() -> None:
    problem = parse_problem(f"{PROBLEM} (:length) (:goal (idle)))", domain_with("(:requirements :foo)"))
    assert [one.position.file for one in problem.warnings] == ["domain.pddl", "domain.pddl", "problem.pddl"]
    assert problem.requirements == ()


# --- requirements --------------------------------------------------------------------------

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
    "(:durative-action a :duration ())": ":durative-actions",
    "(:derived (p) (p))": ":derived-predicates",
    "(:constraints (always (p)))": ":constraints",
    "(:task t)": ":hierarchy",
}
IMPLIED = {
    ":adl": {
        ":typing",
        ":disjunctive-preconditions",
        ":negative-preconditions",
        ":universal-preconditions",
        ":existential-preconditions",
        ":equality",
        ":conditional-effects",
    },
    ":fluents": {":numeric-fluents", ":object-fluents"},
    ":quantified-preconditions": {":universal-preconditions", ":existential-preconditions"},
}


def needing(text: str, *words: str) -> list[str]:
    return warnings(
        parse_domain(
            f"(define (domain d) (:requirements :strips {' '.join(words)}) (:predicates (p)) (:functions (n) (total-cost))\n{text})"
        )
    )


@pytest.mark.parametrize("text", NEEDED)
def test_what_is_used_should_be_required(text: str) -> None:
    word = NEEDED[text]
    second = "a second"
    found = [one for one in needing(text) if second not in one]
    assert [one.partition(" warning: ")[2] for one in found] == [f"{word} is needed here but not among the :requirements"]
    assert [one for one in needing(text, word) if second not in one] == []
    for short, words in IMPLIED.items():
        assert bool([one for one in needing(text, short) if second not in one]) is (
            word not in words and (short, word) != (":fluents", ":action-costs")
        )


def test_object_fluents_need_types_too() -> None:
    found = [one.partition(" warning: ")[2] for one in needing("(:functions (f) - object)")[1:]]
    assert found == [f"{word} is needed here but not among the :requirements" for word in (":object-fluents", ":typing")]


def test_a_missing_requirement_is_told_once() -> None:
    found = needing("(:action a :precondition (not (p)))\n(:action b :precondition (not (p)))")
    assert found == ["2:26: warning: :negative-preconditions is needed here but not among the :requirements"]


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("(:durative-action a :duration (<= ?duration 3))", ":duration-inequalities"),
        ("(:durative-action a :duration (= ?duration (n)))", ":numeric-fluents"),
        ("(:durative-action a :duration () :effect (at end (when (p) (p))))", ":conditional-effects"),
        ("(:durative-action a :duration () :effect (when (at end (p)) (at end (p))))", ":conditional-effects"),
        ("(:durative-action a :duration () :condition (forall (?x) (at end (p))))", ":universal-preconditions"),
    ],
)
def test_durative_actions_have_requirements_of_their_own(text: str, word: str) -> None:
    assert [one.partition(" warning: ")[2] for one in needing(text, ":durative-actions")] == [
        f"{word} is needed here but not among the :requirements"
    ]
    assert needing(text, ":durative-actions", word) == []


def test_a_problem_has_the_requirements_of_its_domain_and_its_own() -> None:
    domain = parse_domain("(define (domain d) (:requirements :typing :preferences) (:types t) (:predicates (p ?x - t)))")
    text = "(define (problem p) (:domain d) {} (:objects a - t) (:init (at 5 (p a))) (:goal (and (p a) (preference (p a)))))"
    assert warnings(parse_problem(text.format(""), domain)) == [
        "1:58: warning: :timed-initial-literals is needed here but not among the :requirements"
    ]
    problem = parse_problem(text.format("(:requirements :timed-initial-literals)"), domain)
    assert (problem.requirements, problem.warnings) == ((":timed-initial-literals",), ())


# --- what is plain PDDL has no warnings ----------------------------------------------------


@pytest.mark.parametrize("path", sorted(ROOT.glob("problems/*/p*.pddl")), ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_our_own_files_have_no_warnings(path: Path) -> None:
    assert load(ROOT / "domains" / path.parent.name / "domain.pddl", path).warnings == ()


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


# --- bytes ---------------------------------------------------------------------------------

PLAIN = "(define (domain d)\n  ; caf\u00e9\n\t(:predicates (p)))\n"


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


# --- how it is told ------------------------------------------------------------------------


def test_no_more_than_twenty_warnings_of_a_file_are_shown() -> None:
    many = [Tolerated("odd", Position("a.pddl", line, 1)) for line in range(1, 24)]
    lines = list(warning_lines([*many, Tolerated("even", Position("b.pddl", 1, 1))]))
    assert lines == [*(f"a.pddl:{line}:1: warning: odd" for line in range(1, 21)), "a.pddl: 3 more warnings", "b.pddl:1:1: warning: even"]


def test_there_may_be_many_warnings() -> None:
    facts = "\n".join("(idle)" for _ in range(20_000))
    text = f"{PROBLEM} (:init {facts}) (:goal (idle)))"
    domain = domain_with("")
    problem = parse_problem(text, domain)
    assert len(problem.warnings) == 19_999


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
