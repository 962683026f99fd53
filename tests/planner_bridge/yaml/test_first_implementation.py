"""`--seed-compatible`: what is written loads by the rules of the first implementation, runs, and ends as the PDDL plan does."""

from __future__ import annotations

import operator
from pathlib import Path
from typing import Any

import pytest
import yaml

from planner_bridge.model.grounding import ground_action, initial_knowledge
from planner_bridge.model.plan import Plan, PlanStep
from planner_bridge.model.problem import Problem
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.planning.solve import solve
from planner_bridge.yaml.first_implementation import write_original
from pnm.core.logic.effects import changes
from pnm.errors import InputError
from pnm.language.plan import read_plans
from tests.support.pddl.problems import matches, rooms, tanks

# --- the rules by which the first implementation loads and evaluates -------------------------


class Refused(Exception):
    """It would crash, or hang, or do something else than is written."""


def value(data: Any, known: dict[str, Any]) -> Any:
    """What it makes of a value: operations are applied to queries and literals alone."""
    match data:
        case {"LocalQuery": str(name)}:
            return known.get(name)
        case {"Operation": [str(name), list(operands)]}:
            if any(isinstance(one, dict) and "LocalQuery" not in one for one in operands):
                raise Refused("an operation inside an operation is not evaluated")
            return getattr(operator, name)(*(value(one, known) for one in operands))
        case {"and": _} | {"or": _} | {"not": _} | {"Comparison": _}:
            return holds(data, known)
        case bool() | int() | float() | str():
            return data
    raise Refused(f"not a value: {data}")


def holds(condition: Any, known: dict[str, Any]) -> bool:
    match condition:
        case {"Comparison": [("eq" | "lt" | "le" | "gt" | "ge") as name, [left, right]]}:
            if any(isinstance(one, dict) and "LocalQuery" not in one for one in (left, right)):
                raise Refused("an operation inside a comparison is not evaluated")
            return bool(getattr(operator, name)(value(left, known), value(right, known)))
        case {"and": [left, right]}:
            return holds(left, known) and holds(right, known)
        case {"or": [left, right]}:
            return holds(left, known) or holds(right, known)
        case {"and": []}:
            return True
        case {"or": []}:
            return False
        case {"not": inner} if not isinstance(inner, list):
            return not holds(inner, known)
    raise Refused(f"not a condition: {condition}")


def run_original_text(text: str) -> tuple[dict[str, Any], list[tuple[str, dict[str, Any]]]]:
    """Carry the plan out: what is known in the end, and the calls of servers."""
    domain, plan = yaml.safe_load_all(text)
    assert set(domain) == {"external_knowledge_base", "actions"}
    assert set(plan) == {"initial_knowledge", "plan"}
    known, calls = dict(plan["initial_knowledge"]), []
    for step in plan["plan"]:
        ((name, told),) = step.items()
        action = domain["actions"][name]
        assert set(action["type"]) == {"module", "class"}
        if "preconditions" in action and not holds(action["preconditions"], known):
            raise Refused(f"the precondition of {name} is false")
        if action["type"]["class"] != "KBAction":
            assert set(told) == set(action["params"])
            calls.append((name, told))
            continue
        match told:
            case {"operation": {"LocalUpdate": [str(target), data]}}:
                known[target] = value(data, known)
            case {"operation": {"LocalQuery": str()}}:
                pass
            case _:
                raise Refused(f"not an operation: {told}")
    return known, calls


# --- examples ------------------------------------------------------------------------------

EVERYTHING = parse_problem(
    """(define (problem p) (:domain everything) (:objects a b - thing)
        (:init (on a) (next a b) (= (level a) 3) (= (level b) 4) (= (place a) b))
        (:goal (and (forall (?t - thing) (imply (on ?t) (exists (?o - thing) (next ?o ?t))))
          (not (on a)) (= (place a) a) (>= (level a) 5))))""",
    parse_domain(
        """(define (domain everything) (:requirements :adl :fluents :typing) (:types thing)
        (:predicates (on ?t - thing) (next ?a ?b - thing) (lock) (odd-one ?t - thing))
        (:functions (level ?t - thing) (place ?t - thing) - thing)
        (:action swap-over :parameters (?from-here ?to - thing)
          :precondition (and (or (on ?from-here) (on ?to)) (not (lock))
            (>= (+ (level ?from-here) (* 2 (- (level ?to)))) (- 0 9)) (not (= ?from-here ?to)))
          :effect (and (not (on ?from-here)) (on ?to) (lock) (assign (place ?from-here) ?from-here)
            (forall (?t - thing) (when (on ?t) (odd-one ?t))) (when (lock) (not (odd-one ?to)))
            (assign (level ?from-here) (+ (level ?from-here) 2)) (assign (level ?to) (level ?from-here)))))""".replace(
            "(level ?t - thing) (place", "(level ?t - thing) - number (place"
        )
    ),
)


def solved(problem: Problem) -> Plan:
    found = solve(problem).plan
    assert found is not None
    return found


def expected(problem: Problem, plan: Plan) -> dict[tuple[str, ...], object]:
    knowledge, known = initial_knowledge(problem), set(problem.init)
    for step in plan.steps:
        action = ground_action(problem.domain.actions[step.action], step.arguments)
        changed = changes(action.end_effects, knowledge)
        knowledge.update(changed)
        known |= set(changed)
    return {fluent: knowledge.value(fluent) or False for fluent in known}


PLANS = {"rooms": (rooms(), None), "tanks": (tanks(), None), "everything": (EVERYTHING, Plan((PlanStep("swap-over", ("a", "b")),)))}


@pytest.mark.parametrize("name", PLANS)
def test_it_runs_by_the_old_rules_and_ends_as_the_plan_does(name: str, tmp_path: Path) -> None:
    problem, plan = PLANS[name]
    plan = plan or solved(problem)
    text = write_original(problem, plan)
    known, calls = run_original_text(text)
    assert [(name, tuple(told.values())) for name, told in calls] == [
        (step.action.replace("-", "_"), step.arguments) for step in plan.steps
    ]
    for fluent, wanted in expected(problem, plan).items():
        variable = "__".join(one.replace("-", "_") for one in fluent) + ("_" if fluent == ("lock",) else "")
        assert (known.get(variable) or False) == wanted, fluent
    file = tmp_path / "plan.yaml"
    file.write_text(text, encoding="utf-8")
    assert len(read_plans(file)["plan"].graph.calls) == len(yaml.safe_load(text.split("---\n")[1])["plan"])


def test_a_false_precondition_stops_it() -> None:
    with pytest.raises(Refused, match="the precondition of before_move is false"):
        run_original_text(write_original(rooms(), Plan((PlanStep("move", ("r1", "b", "c")),))))


def test_every_text_is_quoted() -> None:
    text = write_original(rooms(), Plan((PlanStep("move", ("r1", "a", "b")),)))
    assert '  - move: {r: "r1", a: "a", b: "b"}\n' in text
    assert '- Comparison: ["eq", [{LocalQuery: "at__r1__a"}, true]]\n' in text


ONE = "(:predicates (p ?x) (q-r) (q_r)) (:functions (f))"


def written_for_original(action: str, init: str = "", domain: str = "", problem: str = "", objects: str = "a") -> str:
    read = parse_domain(f"(define (domain d) {ONE} {domain} (:action go :parameters (?x) {action}))")
    whole = parse_problem(f"(define (problem p) (:domain d) (:objects {objects}) (:init {init}) (:goal (and)) {problem})", read)
    return write_original(whole, Plan((PlanStep("go", (objects.split()[0],)),)))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"action": ":effect (when (p ?x) (increase (f) 1))"}, "a conditional effect on a value, (increase (f) 1), of the action 'go'"),
        ({"action": "", "domain": "(:derived (p ?x) (q_r))"}, "the derived predicate 'p'"),
        ({"action": "", "domain": "(:constraints (always (q_r)))"}, "the constraint (always (q_r))"),
        ({"action": "", "init": "(at 5 (q_r))"}, "the change of facts by themselves at 5 s"),
        ({"action": ":effect (and (q-r) (q_r))"}, "no variable for (q_r): 'q_r' stands for (q-r)"),
    ],
)
def test_what_it_cannot_say_is_refused_by_name(arguments: dict[str, str], message: str) -> None:
    with pytest.raises(InputError) as refusal:
        written_for_original(**arguments)
    assert message in str(refusal.value)


def test_durative_actions_are_refused_by_name() -> None:
    with pytest.raises(InputError, match="no way to say the duration of the action 'strike'"):
        write_original(matches(1), Plan((PlanStep("strike", ("m0",), 0.0, 8.0),), temporal=True))
