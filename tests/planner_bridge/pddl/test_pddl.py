"""PDDL: every refusal with its position, then what is read, then the law of writing and reading back."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import kairos
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from planner_bridge.model.problem import Domain, Metric, Problem
from planner_bridge.pddl import parse_domain, parse_problem, read_domain, read_problem
from planner_bridge.pddl.read.symbols import CONSTRAINTS
from planner_bridge.pddl.syntax.expressions import MAX_DEPTH
from planner_bridge.pddl.syntax.words import TIME_SPECIFIERS, number_text
from planner_bridge.pddl.write.writer import write_domain, write_problem
from pnm.core.logic.conditions import TRUE, All, Any, Compare, Condition, Exists, ForAll, Holds, Implies, Not, conjuncts
from pnm.core.logic.domain import ActionSchema, Declaration, DurationConstraint, Preference
from pnm.core.logic.effects import OPERATIONS, Effect, ForEach, Set, TimedChange, When
from pnm.core.logic.expressions import DURATION, UNDEFINED, Arithmetic, Constant, Expression, Fluent, ValueOf, Variable
from pnm.core.logic.rules import Rule
from pnm.core.logic.trajectory import Constraint
from pnm.errors import InputError
from tests.support.files import SHARED

PAIRS = SHARED / "pddl"

DECLARED = (
    "(define (domain d) (:types robot room - thing) (:constants hall - room)"
    " (:predicates (at ?r - robot ?l - room) (idle)) (:functions (charge ?r - robot) (total-cost))"
)
"""One line, so that what a test adds stands in line 2."""
PROBLEM = "(define (problem p) (:domain d) (:objects r2 - robot kitchen - room)"


def domain_with(text: str) -> Domain:
    return parse_domain(f"{DECLARED}\n{text})")


def problem_with(text: str) -> Problem:
    return parse_problem(f"{PROBLEM}\n{text})", domain_with(""))


def action(parts: str) -> ActionSchema:
    return domain_with(f"(:action a {parts})").actions["a"]


def durative(parts: str) -> ActionSchema:
    return domain_with(f"(:durative-action a {parts})").actions["a"]


# --- refusals: the definition --------------------------------------------------------------

WHOLE = [
    ("", "1:1: the file is empty; expected (define (domain NAME) ...)"),
    ("; nothing\n", "1:1: the file is empty; expected (define (domain NAME) ...)"),
    ("(defie (domain d))", "1:2: expected 'define', found 'defie'"),
    ("define", "1:1: expected (define (domain NAME) ...), found 'define'"),
    ("()", "1:1: expected (define (domain NAME) ...), found ()"),
    ("(define)", "1:1: expected (define (domain NAME) ...), found (define)"),
    ("(define d)", "1:9: expected (domain NAME), found 'd'"),
    ("(define (domain))", "1:9: expected (domain NAME), found (domain)"),
    ("(define (problem p))", "1:9: expected (domain NAME), found (problem ...); this file is not a domain"),
    ("(define (domain 3))", "1:17: expected the name of a domain, found '3'"),
    ("(define (domain (d)))", "1:17: expected the name of a domain, found (d)"),
    ("(define (domain d))\n(define (domain e))", "2:1: expected the end of the file after (define (domain NAME) ...), found (define ...)"),
    ("(define (domain d)\n predicates)", "2:2: expected a section such as (:predicates ...), found 'predicates'"),
    ("(define (domain d)\n (predicates))", "2:2: expected a section such as (:predicates ...), found (predicates)"),
    ("(define (domain d)\n (:predicate))", "2:3: unknown section ':predicate'; did you mean ':predicates'?"),
    (
        "(define (domain d)\n (:init))",
        "2:3: unknown section ':init'; expected one of"
        " :requirements, :predicates, :types, :constants, :functions, :action, :durative-action, :derived, :constraints, :task, :method",
    ),
    (
        "(define (domain d)\n (:predicates (p)\n (:action a))",
        "2:2: this '(' is not closed before the next section; expected ')' before ':action' in line 3",
    ),
    ("(" * 20_000, f"1:{MAX_DEPTH + 1}: nested deeper than {MAX_DEPTH} lists"),
]

CONTINGENT = "a contingent planner, of which unified-planning brings none, would be needed"
NOT_SUPPORTED = [
    ("(:process p)", "2:2: processes (:process) are not supported yet; a simulation of change over time would be needed"),
    ("(:event e)", "2:2: events (:event) are not supported yet; changes that happen without an action would be needed"),
    ("(:action a :observe (idle))", f"2:12: sensing actions (:observe) are not supported yet; {CONTINGENT}"),
    ("(:action a :effect (oneof (idle) (and)))", f"2:20: uncertain facts (oneof) are not supported yet; {CONTINGENT}"),
    (
        "(:action a :effect (probabilistic 0.5 (idle)))",
        "2:20: probabilistic effects are not supported yet; a probabilistic planner would be needed",
    ),
    (
        "(:durative-action a :parameters (?r - robot) :duration () :effect (increase (charge ?r) (* #t 2)))",
        "2:92: continuous effects (#t) are not supported yet; a simulation of change over time would be needed",
    ),
    (
        "(:durative-action a :duration () :effect (when (over all (idle)) (at end (idle))))",
        "2:48: conditional effects on a condition 'over all' are not supported yet; a watch over what is not required would be needed",
    ),
    (
        "(:durative-action a :duration (at end (= ?duration 3)))",
        "2:31: durations that are decided at the end are not supported yet;"
        " a bound that is only known when the action ends would be needed",
    ),
]

DECLARATIONS = [
    ("(:requirements :)", "2:16: expected the name of a requirement, found ':'"),
    ("(:requirements (a))", "2:16: expected a requirement such as :typing, found (a)"),
    ("(:types a - b b - a)", "2:9: the type 'a' is a kind of itself"),
    ("(:types object - thing)", "2:9: the type 'object' is a kind of itself"),
    ("(:types a -)", "2:11: expected a type after '-', found nothing"),
    ("(:types a - (either))", "2:13: expected a type or (either TYPE ...), found (either)"),
    ("(:types a - (or a b))", "2:13: expected a type or (either TYPE ...), found (or ...)"),
    ("(:types é)", "2:9: 'é' cannot name a type; expected letters, digits and _ - . @"),
    ("(:types ?x)", "2:9: expected the name of a type, found '?x'"),
    ("(:constants c - rom)", "2:17: unknown type 'rom'; did you mean 'room'?"),
    ("(:constants c - x)", "2:17: unknown type 'x'; expected one of object, robot, room, thing"),
    ("(:predicates p)", "2:14: expected a predicate in parentheses such as (name ?x - type), found 'p'"),
    ("(:predicates ())", "2:14: expected a predicate in parentheses such as (name ?x - type), found ()"),
    ("(:predicates (p x))", "2:17: expected a variable such as ?x, found 'x'"),
    ("(:predicates (p ?))", "2:17: expected a variable such as ?x, found '?'"),
    ("(:predicates (IDLE ?x))", "2:14: the predicate 'idle' is declared twice, and differently; the first time in line 1"),
    ("(:predicates (forall ?x))", "2:15: 'forall' is a word of PDDL and cannot name a predicate"),
    ("(:functions (CHARGE))", "2:13: the function 'charge' is declared twice, and differently; the first time in line 1"),
    ("(:functions (total-cost) - room)", "2:13: the function 'total-cost' is declared twice, and differently; the first time in line 1"),
    ("(:functions (home) - rom)", "2:22: unknown type 'rom'; did you mean 'room'?"),
    ("(:functions (idle))", "2:13: the function 'idle' has the name and the number of arguments of a predicate"),
]

ACTIONS = [
    ("(:action)", "2:1: expected a name after ':action', found nothing"),
    ("(:action (a))", "2:10: expected the name of an action, found (a)"),
    ("(:action a)\n(:durative-action A :duration ())", "3:1: the action 'A' is declared twice; the first time in line 2"),
    ("(:action a :efect (idle))", "2:12: unknown key ':efect' in the action 'a'; did you mean ':effect'?"),
    ("(:action a (idle))", "2:12: expected one of :parameters, :precondition, :effect, :vars; found (idle)"),
    ("(:action a :effect)", "2:12: expected a value after ':effect', found nothing"),
    ("(:action a :precondition :effect (idle))", "2:12: expected a value after ':precondition', found ':effect'"),
    ("(:action a :effect (idle) :effect (idle))", "2:27: a second :effect; expected one"),
    ("(:action a :parameters ?x)", "2:24: expected the parameters in parentheses, found '?x'"),
    ("(:action a :parameters (?x ?X))", "2:28: the variable '?X' is there twice"),
    ("(:action a :precondition idle)", "2:26: expected a condition in parentheses, found 'idle'"),
    ("(:action a :precondition (idel))", "2:27: unknown predicate 'idel'; did you mean 'idle'?"),
    ("(:action a :precondition (charge hall))", "2:27: 'charge' is a function; expected a predicate"),
    ("(:action a :precondition ((idle)))", "2:27: expected the name of a predicate, found (idle)"),
    ("(:action a :precondition (idle hall))", "2:26: (idle) takes 0 arguments, found 1"),
    ("(:action a :precondition (at hall))", "2:26: (at ?r - robot ?l - room) takes 2 arguments, found 1"),
    ("(:action a :precondition (at hall hall))", "2:30: 'hall' is of type room; expected robot"),
    ("(:action a :parameters (?r - robot) :precondition (at ?r ?r))", "2:58: '?r' is of type robot; expected room"),
    ("(:action a :parameters (?r - robot) :precondition (at ?r hal))", "2:58: unknown object 'hal'; did you mean 'hall'?"),
    ("(:action a :effect (xyz))", "2:21: unknown predicate 'xyz'; expected one of at, idle"),
    ("(:action a :precondition (iff (idle) (idle)))", "2:27: unknown predicate 'iff'; expected one of at, idle"),
    ("(:action a :parameters (?robot) :precondition (at ?robt hall))", "2:51: unknown variable '?robt'; did you mean '?robot'?"),
    ("(:action a :precondition (at ?r hall))", "2:30: unknown variable '?r'; none is declared"),
    ("(:action a :precondition (at (r) hall))", "2:30: expected an object or a variable, found (r)"),
    ("(:action a :precondition (not))", "2:26: 'not' takes 1 operand, found 0"),
    ("(:action a :precondition (imply (idle)))", "2:26: 'imply' takes 2 operands, found 1"),
    ("(:action a :precondition (forall ?x (idle)))", "2:34: expected variables in parentheses, found '?x'"),
    ("(:action a :precondition (and (exists (?r - robot) (idle)) (at ?r hall)))", "2:64: unknown variable '?r'; none is declared"),
    ("(:action a :precondition (assign (total-cost) 3))", "2:27: 'assign' cannot stand here; expected a predicate"),
    ("(:action a :precondition (= hall 3))", "2:34: unknown object '3'; expected one of hall"),
    ("(:action a :precondition (= (total-cost) hall))", "2:29: expected an object or a variable, found (total-cost)"),
    ("(:action a :precondition (< hall 3))", "2:29: expected a number or a function in parentheses, found 'hall'"),
    ("(:action a :precondition (< (idle) 3))", "2:30: 'idle' is a predicate; expected a function"),
    ("(:action a :precondition (< (total-time) 3))", "2:30: unknown function 'total-time'; did you mean 'total-cost'?"),
    ("(:action a :precondition (< (charge) 3))", "2:29: (charge ?r - robot) takes 1 argument, found 0"),
    ("(:action a :precondition (< charge 3))", "2:29: (charge ?r - robot) takes 1 argument, found 0"),
    ("(:action a :precondition (< (+ 1) 3))", "2:29: '+' takes at least 2 operands, found 1"),
    ("(:action a :precondition (< (- 1 2 3) 3))", "2:29: '-' takes 1 or 2 operands, found 3"),
    ("(:action a :precondition (< (/ 1) 3))", "2:29: '/' takes 2 operands, found 1"),
    ("(:action a :precondition (< 1e999 3))", "2:29: the number 1e999 is too large"),
    (
        "(:action a :precondition (< ?duration 3))",
        "2:29: '?duration' can only be used in the conditions and effects of a durative action",
    ),
    ("(:action a :effect idle)", "2:20: expected an effect in parentheses, found 'idle'"),
    ("(:action a :effect (or (idle)))", "2:20: 'or' cannot stand in an effect; expected a fact, not, forall, when or assign"),
    ("(:action a :effect (not (not (idle))))", "2:26: 'not' cannot stand here; expected a predicate"),
    ("(:action a :effect (not idle))", "2:25: expected a fact in parentheses, found 'idle'"),
    ("(:action a :effect (= (total-cost) 3))", "2:20: '=' cannot stand in an effect; expected (assign FUNCTION VALUE)"),
    ("(:action a :effect (increase (total-cost)))", "2:20: 'increase' takes 2 operands, found 1"),
    ("(:action a :effect (increase (total) 1))", "2:31: unknown function 'total'; did you mean 'total-cost'?"),
    ("(:durative-action a)", "2:1: the durative action 'a' has no :duration; expected :duration (= ?duration ...), or () for any"),
    ("(:durative-action a :duration 3)", "2:31: expected (= ?duration ...), <=, >= or and of these; found '3'"),
    ("(:durative-action a :duration (< ?duration 3))", "2:31: expected (= ?duration ...), <=, >= or and of these; found (< ...)"),
    ("(:durative-action a :duration (= 3 4))", "2:34: expected ?duration, found '3'"),
    (
        "(:durative-action a :duration (= ?duration ?duration))",
        "2:44: '?duration' can only be used in the conditions and effects of a durative action",
    ),
    (
        "(:durative-action a :duration () :precondition (idle))",
        "2:34: unknown key ':precondition' in the durative action 'a'; did you mean ':condition'?",
    ),
    (
        "(:durative-action a :duration () :condition (idle))",
        "2:45: expected (at start ...), (over all ...), (at end ...), and or forall; found (idle)",
    ),
    (
        "(:durative-action a :duration () :effect (and (idle)))",
        "2:47: expected (at start ...), (at end ...), and, forall or when; found (idle)",
    ),
    (
        "(:durative-action a :duration () :effect (over all (idle)))",
        "2:42: expected (at start ...), (at end ...), and, forall or when; found (over ...)",
    ),
]

PROBLEMS = [
    ("(:goa (idle))", "2:2: unknown section ':goa'; did you mean ':goal'?"),
    ("(:goal)", "2:1: expected (:goal CONDITION), found 0 conditions"),
    ("(:goal (idle) (idle))", "2:1: expected (:goal CONDITION), found 2 conditions"),
    ("(:goal ())\n(:goal (idle))", "3:1: a second :goal section; the first is in line 2"),
    ("(:goal (at r2 nowhere))", "2:15: unknown object 'nowhere'; expected one of hall, r2, kitchen"),
    ("(:goal (at r2 kitchn))", "2:15: unknown object 'kitchn'; did you mean 'kitchen'?"),
    ("(:goal (at r2))", "2:8: (at ?r - robot ?l - room) takes 2 arguments, found 1"),
    ("(:goal (at kitchen r2))", "2:12: 'kitchen' is of type room; expected robot"),
    ("(:goal (sometime (idle)))", "2:9: 'sometime' cannot stand here; expected it in :constraints"),
    ("(:goal (xyz))", "2:9: unknown predicate 'xyz'; expected one of at, idle"),
    ("(:goal (> (charge r2) ?duration))", "2:23: '?duration' can only be used in the conditions and effects of a durative action"),
    ("(:objects 5 - room)", "2:11: expected the name of an object, found '5'"),
    ("(:init idle)", "2:8: expected a fact, (= FUNCTION VALUE) or (at TIME ...), found 'idle'"),
    ("(:init (idel))", "2:9: unknown predicate 'idel'; did you mean 'idle'?"),
    ("(:init (at r2 ?x))", "2:15: unknown variable '?x'; none is declared"),
    ("(:init (at -1 (idle)))", "2:12: expected a time of at least 0, found '-1'"),
    ("(:init (at r2 (idle)))", "2:15: expected an object or a variable, found (idle)"),
    ("(:init (at 5 hall))", "2:12: unknown object '5'; expected one of hall, r2, kitchen"),
    ("(:init (= (charge r2) hall))", "2:23: expected a number, found 'hall'"),
    ("(:init (idle) (not (idle)))", "2:15: (idle) has another value before; expected one value"),
    ("(:init (at 5 (idle)) (at 5.0 (not (idle))))", "2:22: (idle) has another value before; expected one value"),
    (
        "(:init (oneof (idle)))",
        f"2:8: uncertain initial states (oneof in :init) are not supported yet; {CONTINGENT}",
    ),
    (
        "(:init (unknown (idle)))",
        f"2:8: uncertain initial states (unknown in :init) are not supported yet; {CONTINGENT}",
    ),
    ("(:init (or (idle)))", f"2:8: uncertain initial states (or in :init) are not supported yet; {CONTINGENT}"),
    ("(:init (and (idle)))", "2:9: 'and' cannot stand here; expected a predicate"),
    ("(:goal ()) (:metric minimise (total-time))", "2:12: expected (:metric minimize EXPRESSION) or (:metric maximize EXPRESSION)"),
]


@pytest.mark.parametrize(("text", "message"), WHOLE, ids=[message for _, message in WHOLE])
def test_a_text_that_is_no_domain_is_refused(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_domain(text)
    assert str(caught.value) == f"domain.pddl:{message}"


DOMAINS = [*NOT_SUPPORTED, *DECLARATIONS, *ACTIONS]


@pytest.mark.parametrize(("text", "message"), DOMAINS, ids=[message for _, message in DOMAINS])
def test_a_bad_domain_is_refused(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        domain_with(text)
    assert str(caught.value) == f"domain.pddl:{message}"


@pytest.mark.parametrize(("text", "message"), PROBLEMS, ids=[message for _, message in PROBLEMS])
def test_a_bad_problem_is_refused(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        problem_with(text)
    assert str(caught.value) == f"problem.pddl:{message}"


def test_a_domain_is_no_problem() -> None:
    with pytest.raises(InputError, match=r"1:9: expected \(problem NAME\), found \(domain \.\.\.\); this file is not a problem"):
        parse_problem("(define (domain d))", domain_with(""))


def test_files_that_cannot_be_read_are_refused_at_their_beginning(tmp_path: Path) -> None:
    (tmp_path / "empty").write_text("")
    (tmp_path / "zeros").write_bytes(b"(define\0)")
    (tmp_path / "bytes").write_bytes(b"(define (domain d) (:types \xff))")
    (tmp_path / "sixteen").write_bytes(b"\xff\xfe(")
    (tmp_path / "zeros16").write_bytes("(define\0)".encode("utf-16"))
    for name, message in {
        "missing": "1:1: cannot be read: No such file or directory",
        "": "1:1: cannot be read: it is not a regular file",
        "empty": "1:1: the file is empty; expected (define (domain NAME) ...)",
        "zeros": "1:1: not a text file: it contains zero bytes",
        "bytes": "1:28: '\u00ff' cannot name a type; expected letters, digits and _ - . @",
        "sixteen": "1:1: not a text file: it begins as UTF-16 does and is none",
        "zeros16": "1:1: not a text file: it contains zero characters",
    }.items():
        with pytest.raises(InputError) as caught:
            read_domain(tmp_path / name)
        assert str(caught.value) == f"{tmp_path / name}:{message}"


# --- what is read: declarations ------------------------------------------------------------


def test_an_empty_domain_is_read() -> None:
    assert parse_domain("(define (domain d))") == Domain("d")
    assert parse_domain("(define (domain d) (:types) (:constants) (:predicates) (:functions))") == Domain("d")


def test_types_have_parents() -> None:
    domain = parse_domain("(define (domain d) (:types a b - c d - (either c e) a - e a f - object))")
    assert domain.types == {"a": ("c", "e"), "b": ("c",), "c": (), "d": ("c", "e"), "e": (), "f": ()}
    assert list(domain.types) == ["a", "b", "c", "d", "e", "f"]
    assert domain.supertypes("d") == {"object", "c", "e", "d"}


def test_sections_stand_in_any_order() -> None:
    text = "(:action a :parameters (?x - t) :effect (p ?x c)) (:functions (f ?x - t))"
    text += " (:predicates (p ?x ?y - t)) (:constants c - t) (:types t)"
    domain = parse_domain(f"(define (domain d) {text})")
    assert domain.actions["a"].end_effects == (Set(("p", "?x", "c"), Constant(True)),)


@pytest.mark.parametrize("suffix", ["", " - number", " -number", " - Number"])
def test_functions_are_numbers(suffix: str) -> None:
    domain = parse_domain(f"(define (domain d) (:functions (f ?x){suffix} (g)))")
    assert domain.functions == {"f": Declaration("f", (Variable("?x"),)), "g": Declaration("g")}


def test_names_may_clash_begin_with_digits_and_repeat_parameters() -> None:
    domain = parse_domain(
        "(define (domain a) (:types a 2d) (:constants a - a 3x - 2d) (:predicates (a ?a ?a - a) (4p ?5 - 2d))"
        " (:action a :parameters (?a - a) :precondition (and (a ?a a) (4p 3x))))"
    )
    assert domain.actions["a"].precondition == All((Holds(("a", "?a", "a")), Holds(("4p", "3x"))))
    assert [variable.name for variable in domain.predicates["a"].parameters] == ["?a", "?a"]


def test_typed_lists_need_no_spaces() -> None:
    assert domain_with("(:action a :parameters (?a -robot?b - room?c))").actions["a"].parameters == (
        Variable("?a", ("robot",)),
        Variable("?b", ("room",)),
        Variable("?c"),
    )


def test_requirements_are_kept_known_or_not() -> None:
    assert parse_domain("(define (domain d) (:requirements :STRIPS :foo bar :strips))").requirements == (":strips", ":foo", ":bar")


def test_names_are_spelled_as_first_declared() -> None:
    domain = parse_domain(
        "(DEFINE (DOMAIN D) (:Types Robot ROBOT - Thing thing) (:CONSTANTS Jack - ROBOT jack - robot)"
        " (:Predicates (Busy ?R - robot)) (:Functions (F))"
        " (:ACTION Go :Parameters (?Robot - rObOt) :Precondition (AND (busy ?ROBOT) (NOT (BUSY JACK))) :EFFECT (Increase (f) 1)))"
    )
    assert domain.types == {"Robot": ("Thing",), "Thing": ()}
    go = domain.actions["Go"]
    assert go.parameters == (Variable("?Robot", ("Robot",)),)
    assert go.precondition == All((Holds(("Busy", "?Robot")), Not(Holds(("Busy", "Jack")))))
    assert go.end_effects == (Set(("F",), Constant(1.0), "increase"),)
    problem = parse_problem("(define (problem P) (:objects JACK Jill - robot) (:init (BUSY jack) (= F 2)) (:GOAL (busy JILL)))", domain)
    assert problem.own_objects == {"Jill": ("Robot",)}
    assert problem.init == {("Busy", "Jack"): True, ("F",): 2.0}
    assert problem.goal == Holds(("Busy", "Jill"))


def test_an_inner_variable_hides_an_outer_one_of_another_spelling() -> None:
    schema = action("(:parameters (?X - robot) :precondition (and (at ?x hall) (exists (?x - robot) (at ?X hall))))"[1:-1])
    assert schema.precondition == All((Holds(("at", "?X", "hall")), Exists((Variable("?x", ("robot",)),), Holds(("at", "?x", "hall")))))


@pytest.mark.parametrize("kind", ["object", "thing", "robot", "(either robot room)", "little"])
def test_a_variable_is_accepted_where_its_type_could_match(kind: str) -> None:
    text = f"(:types little - robot) (:action a :parameters (?r - {kind}) :precondition (at ?r hall))"
    assert domain_with(text).actions["a"].precondition == Holds(("at", "?r", "hall"))


def test_an_object_of_either_type_is_accepted_for_both() -> None:
    problem = problem_with("(:objects both - (either robot room)) (:goal (at both both))")
    assert problem.goal == Holds(("at", "both", "both"))
    assert problem.objects_by_type["robot"] == ("r2", "both")


# --- what is read: actions -----------------------------------------------------------------


@pytest.mark.parametrize("parts", ["", ":parameters () :precondition () :effect ()", ":effect (and) :precondition (and (and))"])
def test_parts_of_an_action_may_be_empty_or_missing(parts: str) -> None:
    assert action(parts) == ActionSchema("a")


IDLE = Holds(("idle",))
CHARGE = ValueOf(("charge", "?r"))


@pytest.mark.parametrize(
    ("text", "condition"),
    [
        ("(idle)", IDLE),
        ("(and (idle))", IDLE),
        ("(and (idle) (and (idle) (idle)))", All((IDLE, IDLE, IDLE))),
        ("(or (idle) (not (idle)))", Any((IDLE, Not(IDLE)))),
        ("(or)", Any(())),
        ("(imply (idle) ())", Implies(IDLE, TRUE)),
        ("(forall (?l - room) (at ?r ?l))", ForAll((Variable("?l", ("room",)),), Holds(("at", "?r", "?l")))),
        ("(exists (?l - room) (at ?r ?l))", Exists((Variable("?l", ("room",)),), Holds(("at", "?r", "?l")))),
        ("(= ?r hall)", Compare("=", Constant("?r"), Constant("hall"))),
        ("(= (charge ?r) 3)", Compare("=", CHARGE, Constant(3.0))),
        ("(= total-cost total-cost)", Compare("=", ValueOf(("total-cost",)), ValueOf(("total-cost",)))),
        ("(>= (charge ?r) -.5e1)", Compare(">=", CHARGE, Constant(-5.0))),
        (
            "(< (+ 1 2 (charge ?r)) (- (* 2 3 4) (/ 1 (- 2))))",
            Compare(
                "<",
                Arithmetic("+", (Constant(1.0), Constant(2.0), CHARGE)),
                Arithmetic(
                    "-",
                    (
                        Arithmetic("*", (Constant(2.0), Constant(3.0), Constant(4.0))),
                        Arithmetic("/", (Constant(1.0), Arithmetic("-", (Constant(2.0),)))),
                    ),
                ),
            ),
        ),
    ],
)
def test_conditions(text: str, condition: Condition) -> None:
    assert action(f":parameters (?r - robot) :precondition {text}").precondition == condition


SET_IDLE = Set(("idle",), Constant(True))
NOT_IDLE = Set(("idle",), Constant(False))


@pytest.mark.parametrize(
    ("text", "effects"),
    [
        ("(idle)", (SET_IDLE,)),
        ("(and (idle) (and (not (idle))))", (SET_IDLE, NOT_IDLE)),
        ("(when (idle) (and (not (idle)) (idle)))", (When(IDLE, (NOT_IDLE, SET_IDLE)),)),
        ("(forall (?l - room) (not (at ?r ?l)))", (ForEach((Variable("?l", ("room",)),), (Set(("at", "?r", "?l"), Constant(False)),)),)),
        *((f"({name} (charge ?r) 2)", (Set(("charge", "?r"), Constant(2.0), name),)) for name in OPERATIONS),
    ],
)
def test_effects(text: str, effects: tuple[Effect, ...]) -> None:
    assert action(f":parameters (?r - robot) :effect {text}").end_effects == effects


@pytest.mark.parametrize(
    ("text", "constraints"),
    [
        ("()", ()),
        ("(and)", ()),
        ("(= ?duration 3)", (DurationConstraint("=", Constant(3.0)),)),
        ("(at start (= ?DURATION 3))", (DurationConstraint("=", Constant(3.0)),)),
        (
            "(and (<= ?duration 3) (at start (>= ?duration (charge ?r))))",
            (DurationConstraint("<=", Constant(3.0)), DurationConstraint(">=", CHARGE)),
        ),
    ],
)
def test_durations(text: str, constraints: tuple[DurationConstraint, ...]) -> None:
    assert durative(f":parameters (?r - robot) :duration {text}").duration == constraints


def test_timed_conditions_go_to_their_moments() -> None:
    at_hall = Holds(("at", "?r", "hall"))
    robots = (Variable("?r", ("robot",)),)
    schema = durative(
        ":duration () :condition (and (at start (and (idle) (idle))) (over all (idle)) (over all (not (idle))) (at end (>= ?duration 1))"
        " (forall (?r - robot) (and (at start (at ?r hall)) (at end (at ?r hall)))))"
    )
    assert schema.precondition == All((IDLE, IDLE, ForAll(robots, at_hall)))
    assert schema.invariant == All((IDLE, Not(IDLE)))
    assert schema.end_condition == All((Compare(">=", ValueOf(DURATION), Constant(1.0)), ForAll(robots, at_hall)))


def test_timed_effects_go_to_their_moments() -> None:
    robots = (Variable("?r", ("robot",)),)
    charged = Set(("charge", "?r"), Arithmetic("*", (Constant(2.0), ValueOf(DURATION))), "increase")
    schema = durative(
        ":duration () :effect (and (at start (not (idle))) (at end (idle)) (at end (when (idle) (idle)))"
        " (when (at start (idle)) (at start (and (idle) (not (idle)))))"
        " (forall (?r - robot) (and (at start (idle)) (at end (increase (charge ?r) (* 2 ?duration)))"
        " (when (at end (idle)) (at end (idle))))))"
    )
    assert schema.start_effects == (NOT_IDLE, When(IDLE, (SET_IDLE, NOT_IDLE)), ForEach(robots, (SET_IDLE,)))
    assert schema.end_effects == (SET_IDLE, When(IDLE, (SET_IDLE,)), ForEach(robots, (charged, When(IDLE, (SET_IDLE,)))))


# --- what is read: problems ----------------------------------------------------------------


def test_a_problem_is_read() -> None:
    problem = problem_with(
        "(:init (at r2 kitchen) (at r2 kitchen) (not (idle)) (= (charge r2) 10) (= total-cost 0)"
        " (at 7 (= (charge r2) -3)) (at 5 (idle)) (at 5.0 (not (at r2 kitchen))))"
        " (:requirements :typing) (:length (:serial 3)) (:metric maximize (- total-time (total-cost))) (:objects r2 - robot) (:goal ())"
    )
    assert problem == Problem(
        "p",
        domain_with(""),
        {"r2": ("robot",), "kitchen": ("room",)},
        {("at", "r2", "kitchen"): True, ("charge", "r2"): 10.0, ("total-cost",): 0.0},
        (
            TimedChange(5.0, {("idle",): True, ("at", "r2", "kitchen"): False}),
            TimedChange(7.0, {("charge", "r2"): -3.0}),
        ),
        TRUE,
        Metric("maximize", Arithmetic("-", (ValueOf(("total-time",)), ValueOf(("total-cost",))))),
        requirements=(":typing",),
    )


def test_at_is_an_ordinary_predicate_too() -> None:
    domain = parse_domain("(define (domain d) (:predicates (at ?x ?y)))")
    problem = parse_problem("(define (problem p) (:objects 1st b) (:init (at 1st b) (at 1 (at b b))) (:goal (at b 1st)))", domain)
    assert problem.init == {("at", "1st", "b"): True}
    assert problem.timed == (TimedChange(1.0, {("at", "b", "b"): True}),)


@pytest.mark.parametrize(
    ("before", "inner", "after"),
    [
        ("(not ", "(p ?x)", ")"),
        ("(or (p ?x) ", "(p ?x)", ")"),
        ("(imply (p ?x) ", "(p ?x)", ")"),
        ("(exists (?y) ", "(p ?x)", ")"),
        ("(< 1 ", "", ")"),
    ],
)
def test_the_deepest_nesting_is_read_and_written(before: str, inner: str, after: str) -> None:
    levels = MAX_DEPTH - 3
    nested = f"(< 1 {'(+ 1 ' * (levels - 1)}1{')' * (levels - 1)})" if not inner else before * levels + inner + after * levels
    domain = parse_domain(f"(define (domain d) (:predicates (p ?x)) (:action a :parameters (?x) :precondition {nested}))")
    assert parse_domain(write_domain(domain)) == domain
    effect = "(when (p ?x) " * levels + "(p ?x)" + ")" * levels
    domain = parse_domain(f"(define (domain d) (:predicates (p ?x)) (:action a :parameters (?x) :effect {effect}))")
    assert parse_domain(write_domain(domain)) == domain


# --- the law: what is written is read as an equal model ------------------------------------

TYPES = {"thing": (), "robot": ("thing",), "room": ("thing",), "dock": ("room", "place"), "place": ()}
KINDS = st.sampled_from([("object",), ("thing",), ("robot",), ("dock",), ("robot", "place")])
NUMBERS = st.one_of(st.integers(-1000, 1000).map(float), st.floats(allow_nan=False, allow_infinity=False))
FUNCTIONS: list[Fluent] = [("charge", "?r"), ("charge", "R1"), ("total-cost",)]
FACTS: list[Fluent] = [("at", "?r", "hall"), ("at", "R1", "hall"), ("idle",)]
OWN = (Variable("?r", ("robot",)), Variable("?Other", ("object",)))


def expressions(duration: bool) -> st.SearchStrategy[Expression]:
    values = st.sampled_from([*FUNCTIONS, *([DURATION] if duration else [])]).map(ValueOf)
    return st.recursive(
        st.one_of(NUMBERS.map(Constant), values),
        lambda inner: st.one_of(
            st.builds(Arithmetic, st.sampled_from("+*"), st.lists(inner, min_size=2, max_size=3).map(tuple)),
            st.builds(Arithmetic, st.just("/"), st.tuples(inner, inner)),
            st.builds(Arithmetic, st.just("-"), st.lists(inner, min_size=1, max_size=2).map(tuple)),
        ),
        max_leaves=4,
    )


def joined(parts: list[Condition]) -> Condition:
    flat = conjuncts(All(tuple(parts)))
    return flat[0] if len(flat) == 1 else All(flat)


VARIABLES = st.lists(st.builds(Variable, st.sampled_from(["?x", "?y", "?z"]), KINDS), max_size=2, unique_by=lambda one: one.name).map(tuple)


def conditions(duration: bool = False) -> st.SearchStrategy[Condition]:
    numbers = st.builds(Compare, st.sampled_from(["=", "<", "<=", ">", ">="]), expressions(duration), expressions(duration))
    terms = st.sampled_from([*map(Constant, ["?r", "?Other", "R1", "hall"]), ValueOf(("home", "?r")), ValueOf(("home", "R1"))])
    return st.recursive(
        st.one_of(st.sampled_from(FACTS).map(Holds), numbers, st.builds(Compare, st.just("="), terms, terms)),
        lambda inner: st.one_of(
            st.lists(inner, max_size=3).map(joined),
            st.builds(Any, st.lists(inner, max_size=3).map(tuple)),
            inner.map(Not),
            st.builds(Implies, inner, inner),
            st.builds(ForAll, VARIABLES, inner),
            st.builds(Exists, VARIABLES, inner),
        ),
        max_leaves=6,
    )


def effects(duration: bool = False) -> st.SearchStrategy[tuple[Effect, ...]]:
    truth = st.builds(Set, st.sampled_from(FACTS), st.booleans().map(Constant))
    numbers = st.builds(Set, st.sampled_from(FUNCTIONS), expressions(duration), st.sampled_from(OPERATIONS))
    places = st.sampled_from([Constant("?Other"), Constant("hall"), ValueOf(("home", "R1")), Constant(UNDEFINED)])
    one = st.recursive(
        st.one_of(truth, numbers, st.builds(Set, st.just(("home", "?r")), places)),
        lambda inner: st.one_of(
            st.builds(When, conditions(duration), st.lists(inner, max_size=2).map(tuple)),
            st.builds(ForEach, VARIABLES, st.lists(inner, max_size=2).map(tuple)),
        ),
        max_leaves=4,
    )
    return st.lists(one, max_size=3).map(tuple)


def early_effects() -> st.SearchStrategy[tuple[Effect, ...]]:
    """Effects at the end on conditions at the start, which are not trivial: a trivial one is written away."""
    real = conditions(duration=True).filter(lambda condition: condition != TRUE)
    inner = effects(duration=True).filter(lambda found: not any(isinstance(one, When) and one.condition == TRUE for one in found))
    early = st.builds(When, real, inner, early=st.just(True))
    around = st.one_of(early, st.builds(ForEach, VARIABLES, st.tuples(early)), st.builds(When, real, st.tuples(early)))
    return st.tuples(effects(duration=True), st.lists(around, max_size=2)).map(lambda both: (*both[0], *both[1]))


def constraints() -> st.SearchStrategy[Constraint]:
    def one(operator: str) -> st.SearchStrategy[Constraint]:
        times, several = CONSTRAINTS.get(operator, (0, 1))
        seconds = st.tuples(*[st.floats(0, 1e9)] * times)
        return st.builds(Constraint, st.just(operator), st.tuples(*[conditions()] * several), seconds, VARIABLES)

    return st.sampled_from([*CONSTRAINTS, "at end"]).flatmap(one)


def over(constraint: Constraint) -> Constraint:
    """The constraint in a place without an action around it."""
    return replace(constraint, variables=(*OWN, *constraint.variables))


PREFERENCES = st.builds(Preference, st.sampled_from(["p", "Q-2", ""]), conditions(), VARIABLES)
WISHES = st.builds(Preference, st.sampled_from(["p", "c", ""]), st.lists(constraints(), max_size=2).map(tuple), st.just(OWN))
RULES = st.builds(Rule, st.sampled_from(["calm", "near"]), st.just(OWN), conditions())

INSTANTANEOUS = st.builds(
    ActionSchema,
    st.just("now"),
    st.just(OWN),
    precondition=conditions(),
    end_effects=effects(),
    preferences=st.lists(PREFERENCES, max_size=2).map(tuple),
)
DURATIVE = st.builds(
    ActionSchema,
    st.just("later"),
    st.just(OWN),
    precondition=conditions(duration=True),
    invariant=conditions(duration=True),
    end_condition=conditions(duration=True),
    start_effects=effects(duration=True),
    end_effects=early_effects(),
    preferences=st.lists(
        st.builds(Preference, st.sampled_from(["p", ""]), conditions(duration=True), VARIABLES, st.sampled_from(TIME_SPECIFIERS)),
        max_size=2,
    ).map(tuple),
    duration=st.lists(st.builds(DurationConstraint, st.sampled_from(["=", "<=", ">="]), expressions(duration=False)), max_size=2).map(
        tuple
    ),
)


def domain_of(actions: list[ActionSchema]) -> Domain:
    return Domain(
        "d",
        TYPES,
        {"R1": ("robot",), "hall": ("dock",), "odd": ("robot", "place")},
        {
            "at": Declaration("at", (Variable("?r", ("robot",)), Variable("?l", ("room", "robot")))),
            "same": Declaration("same", (Variable("?x"), Variable("?x"), Variable("?y", ("dock",)))),
            "idle": Declaration("idle"),
            "calm": Declaration("calm", OWN),
            "near": Declaration("near", OWN),
        },
        {
            "charge": Declaration("charge", (Variable("?r", ("robot",)),)),
            "home": Declaration("home", (Variable("?r", ("robot",)),), ("room", "place")),
            "total-cost": Declaration("total-cost"),
        },
        {one.name: one for one in actions},
        requirements=(":typing", ":adl"),
    )


@settings(max_examples=25, suppress_health_check=[HealthCheck.too_slow], deadline=None)
@given(st.tuples(INSTANTANEOUS, DURATIVE), st.lists(RULES, max_size=2), st.lists(constraints(), max_size=2), st.lists(WISHES, max_size=2))
def test_a_written_domain_reads_as_an_equal_one(
    actions: tuple[ActionSchema, ActionSchema], rules: list[Rule], kept: list[Constraint], wished: list[Preference]
) -> None:
    domain = replace(
        domain_of(list(actions)),
        rules=tuple(rules),
        constraints=tuple(map(over, kept)),
        preferences=tuple(wished),
        hierarchy=("(:task t)",),
    )
    text = write_domain(domain)
    again = parse_domain(text)
    assert again == domain
    assert [list(part) for part in (again.types, again.actions)] == [list(part) for part in (domain.types, domain.actions)]
    kairos.parse_domain(write_domain(replace(domain, hierarchy=())))


GROUND_FACTS = st.sampled_from([("at", "R1", "hall"), ("at", "r2", "hall"), ("idle",)])
GROUND_FUNCTIONS = st.sampled_from([("charge", "R1"), ("charge", "r2"), ("total-cost",)])


def values(truth: st.SearchStrategy[bool]) -> st.SearchStrategy[dict[Fluent, bool | float | str]]:
    homes = st.dictionaries(st.sampled_from([("home", "R1"), ("home", "r2")]), st.sampled_from(["hall", "y"]))
    parts = st.tuples(st.dictionaries(GROUND_FACTS, truth), st.dictionaries(GROUND_FUNCTIONS, NUMBERS), homes)
    return parts.map(lambda found: {**found[0], **found[1], **found[2]})


TIMED = st.dictionaries(st.floats(0, 1e9), values(st.booleans()).filter(bool), max_size=3).map(
    lambda found: tuple(TimedChange(time, found[time]) for time in sorted(found))
)


@settings(max_examples=25, suppress_health_check=[HealthCheck.too_slow], deadline=None)
@given(
    values(st.just(True)),
    TIMED,
    NUMBERS,
    st.lists(PREFERENCES, max_size=2),
    st.lists(constraints(), max_size=2),
    st.lists(WISHES, max_size=2),
)
def test_a_written_problem_reads_as_an_equal_one(
    init: dict[Fluent, bool | float | str],
    timed: tuple[TimedChange, ...],
    number: float,
    goals: list[Preference],
    kept: list[Constraint],
    wished: list[Preference],
) -> None:
    goal = All((Holds(("idle",)), Compare(">", ValueOf(("charge", "r2")), Constant(number))))
    soft = (*(replace(one, variables=(*OWN, *one.variables)) for one in goals), *wished, Preference("p", IDLE))
    metric = Metric("minimize", Arithmetic("*", (ValueOf(("is-violated", "p")), ValueOf(("total-time",)))))
    problem = Problem(
        "p",
        domain_of([]),
        {"r2": ("robot",), "x": ("object",), "y": ("robot", "place")},
        init,
        timed,
        goal,
        metric,
        tuple(map(over, kept)),
        tuple(sorted(soft, key=lambda one: isinstance(one.wanted, tuple))),
        requirements=(":typing",),
    )
    text = write_problem(problem)
    assert parse_problem(text, problem.domain) == problem
    kairos.parse_problem(text, kairos.parse_domain(write_domain(problem.domain)))
    network = replace(problem, network="(:htn :subtasks (and))\n(:tasks)")
    assert parse_problem(write_problem(network), problem.domain) == network


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


WORDS = [
    *(
        "(",
        ")",
        "?",
        "?x",
        "-",
        ":",
        ":effect",
        "and",
        "at",
        "start",
        "end",
        "not",
        "=",
        "3",
        "?duration",
        "when",
        "forall",
        "either",
        "é",
        ";",
    ),
    *(
        "preference",
        "always",
        "within",
        ":derived",
        ":constraints",
        "home",
        "undefined",
        "is-violated",
        "assign",
        "over",
        "all",
        ":vars",
        ":htn",
    ),
]


@settings(deadline=None)
@given(st.data())
def test_a_damaged_text_is_read_or_refused_with_a_position(data: st.DataObject) -> None:
    domain = replace(domain_of([SAMPLE, EARLY]), rules=(Rule("calm", OWN, Not(IDLE)),), constraints=(LAW,), hierarchy=("(:task t)",))
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
        words[at : at + data.draw(st.integers(0, 2))] = data.draw(st.lists(st.sampled_from([*WORDS, *words[:40]]), max_size=2))
    error = _error(" ".join(words), domain if which else None)
    assert error is None or error.position is not None


def _error(text: str, domain: Domain | None) -> InputError | None:
    try:
        parse_problem(text, domain) if domain else parse_domain(text)
    except InputError as error:
        return error
    return None


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


# --- files of others -----------------------------------------------------------------------

REFUSED = {
    "blocks_observe": f"domain.pddl:11:4: sensing actions (:observe) are not supported yet; {CONTINGENT}",
    "rosplan_test_invalid": "problem.pddl:1:2: expected 'define', found 'defie'",
    "simple_3": "problem.pddl:1:1: this '(' is never closed; expected ')' before the end of the file",
}
"""Pairs that are not read, and why; none of `ipc` is among them."""


def pairs() -> list[Path]:
    manifests = sorted(PAIRS.glob("*/manifest.json"))
    return [manifest.parent / pair["name"] for manifest in manifests for pair in json.loads(manifest.read_text())]


@pytest.mark.parametrize("folder", [folder for folder in pairs() if folder.name in REFUSED], ids=lambda folder: folder.name)
def test_pairs_that_are_refused(folder: Path) -> None:
    with pytest.raises(InputError) as caught:
        read_problem(folder / "problem.pddl", read_domain(folder / "domain.pddl"))
    assert str(caught.value) == f"{folder}/{REFUSED[folder.name]}"


@pytest.mark.parametrize("folder", [folder for folder in pairs() if folder.name not in REFUSED], ids=lambda folder: folder.name)
def test_pairs_are_read_and_written(folder: Path) -> None:
    domain = read_domain(folder / "domain.pddl")
    problem = read_problem(folder / "problem.pddl", domain)
    written = write_domain(domain), write_problem(problem)
    kairos.parse_problem(written[1], kairos.parse_domain(written[0]))
    again = parse_domain(written[0])
    assert again == domain
    assert parse_problem(written[1], again) == problem


def test_large_files_are_read() -> None:
    facts = "\n".join(f"(at r{index} room{index % 50})" for index in range(20_000))
    robots = " ".join(f"r{index}" for index in range(20_000))
    rooms = " ".join(f"room{index}" for index in range(50))
    text = f"{PROBLEM} (:objects {robots} - robot {rooms} - room) (:init {facts}) (:goal ()))"
    domain = domain_with("")
    problem = parse_problem(text, domain)
    assert len(problem.init) == 20_000
