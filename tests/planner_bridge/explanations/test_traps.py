"""Why a policy does not take the short way: what is said to have no way out has none."""

from __future__ import annotations

from pathlib import Path

from hypothesis import given, settings, strategies as st

from planner_bridge.explanations.answer import Answer, Known, Unsolvable
from planner_bridge.explanations.goal_now import why_goal
from planner_bridge.explanations.needed_call import why_not
from planner_bridge.explanations.no_plan import AnswerLimit, why_not_short
from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.plan import PlanStep
from planner_bridge.model.problem import Problem
from planner_bridge.model.rates import Call, Counts, End, Rates
from planner_bridge.pddl import parse_domain, parse_problem, write_domain, write_problem
from planner_bridge.planning.policies.policy import policies
from pnm.core.machine.bindings import Binding, Bindings
from tests.support.e2e.command_line import pnm
from tests.support.files import written
from tests.support.pddl.chance import Exact, random_problem

TIRES = parse_domain("""
(define (domain tires) (:requirements :typing :non-deterministic) (:types place)
  (:predicates (car ?p - place) (spare ?p - place) (road ?p ?q - place) (flat))
  (:action drive :parameters (?p ?q - place) :precondition (and (car ?p) (road ?p ?q) (not (flat)))
    :effect (and (car ?q) (not (car ?p)) (oneof (and) (flat))))
  (:action change :parameters (?p - place) :precondition (and (car ?p) (spare ?p)) :effect (and (not (spare ?p)) (not (flat)))))
""")
TRAP = "drive(a, b) leads with 50% to a state without a way out: "


def tires(spares: str) -> Problem:
    roads = "(road a b) (road b z) (road a c) (road c d) (road d z)"
    text = f"(define (problem p) (:domain tires) (:objects a b c d z - place) (:init (car a) {spares} {roads}) (:goal (car z)))"
    return parse_problem(text, TIRES)


def check(answer: Answer) -> None:
    """Check by looking at all states that those of the claims have no way out."""
    assert answer.claims
    for claim in answer.claims:
        assert isinstance(claim, Unsolvable)
        assert Exact(claim.problem).best_chance == 0.0


def test_the_short_way_is_not_taken_because_of_a_flat_tire_without_a_spare() -> None:
    problem, limit = tires("(spare c) (spare d)"), AnswerLimit.of(60.0)
    found = limit.first_plan(problem)
    plan, short = why_goal(problem, found, limit)
    assert plan.statement.startswith("there is a plan with 3 calls")
    assert short.statement.startswith("there is a way with 2 calls, but ")
    other = why_not(problem, PlanStep("drive", ("a", "b")), found, limit)
    assert "(spare b) is false, and no action changes that" in str(other)
    for answer in (short, other):
        assert answer.statement[answer.statement.index("drive") :] == f"{TRAP}(flat) and (car b) are true"
        assert answer.known is Known.RELAXATION
        check(answer)


def test_chances_are_those_that_were_learned(tmp_path: Path) -> None:
    rates = Rates({Call("car", "drive", ("a", "b")): Counts({End.SUCCEEDED: 100}, outcomes={"1": 75, "2": 25})})
    problem, car = tires("(spare c) (spare d)"), Bindings({"drive": Binding(server="car")})
    limit = AnswerLimit.of(60.0, car, rates)
    _, short = why_goal(problem, limit.first_plan(problem), limit)
    assert "drive(a, b) leads with 25% to a state" in short.statement
    files = [
        str(written(tmp_path / name, text)) for name, text in (("domain.pddl", write_domain(TIRES)), ("p.pddl", write_problem(problem)))
    ]
    known = ["--bindings", str(written(tmp_path / "car.yaml", "actions: {drive: {server: car}}\n"))]
    known += ["--rates", str(written(tmp_path / "learned.yaml", rates.text()))]
    assert "drive(a, b) leads with 50% to a state" in pnm("why", *files, "--seconds", "60").stdout
    assert "drive(a, b) leads with 25% to a state" in pnm("why", *files, *known, "--seconds", "60").stdout
    assert "expected DOMAIN and PROBLEM" in pnm("why", *known).stderr


def test_what_the_policy_risks_itself_is_no_reason() -> None:
    problem, limit = tires(""), AnswerLimit.of(60.0)
    found = limit.first_plan(problem)
    assert len(why_goal(problem, found, limit)) == 1
    other = why_not(problem, PlanStep("drive", ("a", "c")), found, limit)
    assert other.statement.startswith("drive(a, c) leads with 50%")


@settings(max_examples=100)
@given(st.integers(0, 10**9))
def test_what_is_said_to_have_no_way_out_has_none(seed: int) -> None:
    problem = random_problem(seed)
    *_, best = [None, *policies(problem, 60.0)]
    plan = best and best.plan(initial_knowledge(problem))
    if plan and (answer := why_not_short(problem, plan, AnswerLimit.of(60.0))):
        check(answer)
