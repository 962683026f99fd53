"""Progress: replans that bring a task further are not counted, and those that do not end it."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from itertools import pairwise
from random import Random

import pytest

from planner_bridge.model.plan import Plan, PlanStep
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.tasks.replanning import GiveUp, Limits, Reached, Repeats
from planner_bridge.tasks.settings import Settings
from pnm.actions.faults import Fault, FaultKind, Faults, HiddenChange
from pnm.core.execution.call_results import CallResult
from pnm.core.logic.expressions import UNKNOWN
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.requests import CallOutcome
from pnm.tasks import Code
from tests.support.pddl.problems import rooms
from tests.support.tasks.replanning import decisions, pursued
from tests.support.tasks.simulation import TaskSimulation, simulate_tasks

DOORS = """(define (domain doors) (:requirements :negative-preconditions)
 (:predicates (locked) (inside) (outside) (round))
 (:action enter :parameters () :precondition (not (locked)) :effect (inside))
 (:action leave :parameters () :effect (outside))
 (:action climb :parameters () :precondition (outside) :effect (round))
 (:action jump :parameters () :precondition (round) :effect (inside)))"""
INSIDE = "(define (problem p) (:domain doors) (:goal (inside)))"
ONE_WAY = DOORS.replace("(:action climb :parameters () :precondition (outside)", "(:action climb :parameters () :precondition (inside)")
IN_VAIN = "replans brought no progress: nothing new is known, and no fewer calls are left"
NO_RETRY = Bindings({"move": Binding(retries=0)})


def test_a_long_task_may_be_replanned_as_often_as_it_gets_further() -> None:
    places = "abcdefghijklmnopq"
    problem = rooms(init="(at r1 a)", goal="(at r1 q)", ways=" ".join(map("".join, pairwise(places))))
    once = Faults(tuple(Fault(f"move(r1, {here}, {there})", FaultKind.ABORT, times=1) for here, there in pairwise(places)))
    result, _ = pursued(problem, once, bindings=NO_RETRY)
    assert result.goal_reached, result.reason
    assert result.replans == len(places) - 1


def test_a_task_that_always_comes_too_late_ends_and_says_so() -> None:
    def opens_elsewhere(here: str, there: str, arrival: str) -> HiddenChange:
        return HiddenChange({("way", here, "c"): False, ("way", there, "c"): True}, moment="end", what=arrival)

    moves = [("b", "d", "move(r1, a, b)"), ("b", "d", "move(r1, d, b)"), ("d", "b", "move(r1, b, d)")]
    changes = tuple(opens_elsewhere(*move) for move in moves)
    result, _ = pursued(rooms(init="(at r1 a)", goal="(at r1 c)", ways="ab bc bd db"), Faults(changes=changes))
    assert (result.code, result.replans) == (Code.REPLAN_LIMIT, 12), "two of them found something out"
    assert result.reason.startswith(f"the last 10 {IN_VAIN}; last failure: move(r1, ")
    assert decisions(result)[-1] is GiveUp


WASH = """(define (domain wash) (:requirements :fluents) (:predicates (clean)) (:functions (washed) (total-cost))
 (:action wash :parameters () :effect (and (increase (total-cost) 1) (oneof (increase (washed) 1) (clean) (and)))))"""


def repeated(domain: str, label: str, *states: dict[str, float]) -> str:
    """Return what is wrong after `wash` has come to this outcome in these states, again and again."""
    problem = parse_problem(
        "(define (problem p) (:domain wash) (:init (= (washed) 0)) (:goal (or (clean) (> (washed) 9))))", parse_domain(domain)
    )
    (call,) = plan_graph(problem, Plan((PlanStep("wash"),))).calls
    results, repeats = [CallResult(call, CallOutcome.SUCCEEDED, declared=label)], Repeats()
    for state in states:
        repeats = repeats.after(results, replace(problem, init={**problem.init, **{(name,): value for name, value in state.items()}}))
    return repeats.livelock(results)


def test_what_is_absurdly_unlikely_is_given_up() -> None:
    rare = WASH.replace("(oneof (increase (washed) 1) (clean)", "(probabilistic 0.01 (clean) 0.99")
    alike: dict[str, float] = {"washed": 0.0}
    costs = [{"total-cost": float(number)} for number in range(60)]  # which no condition reads
    assert "has ended 60 times in a row as 3, and nothing is new; its outcomes are 1, 2, 3, and 1, 2 never" in repeated(WASH, "3", *costs)
    assert not repeated(WASH, "3", *costs[1:])
    assert not repeated(WASH, "1", *({"washed": float(number)} for number in range(100)))
    assert not repeated(rare, "2", *[alike] * 2000)
    assert "1 never came about" in repeated(rare, "2", *[alike] * 2100)
    assert "nothing tells which it was" in repeated(rare, "1 or 2", *[alike] * 60)


def test_a_success_that_changes_nothing_is_no_progress() -> None:
    idle = Faults((Fault("move(r1, a, b)", FaultKind.NO_EFFECT),))
    problem, limits = rooms(init="(at r1 a)", goal="(at r1 c)", ways="ab bc"), Limits(forbid_after=100, without_progress=2)
    result, _ = pursued(problem, idle, limits=limits)
    assert result.replans == 3
    assert result.reason.startswith(f"the last 2 {IN_VAIN}; last failure: move(r1, a, b)")


@pytest.mark.parametrize("seed", range(20))
def test_no_task_replans_for_ever(seed: int) -> None:
    rng, facts, longest, most = Random(seed), 12, 15, 5
    reached, left, replans = Reached(), longest, 0
    while reached.in_vain <= most:
        left = rng.choice([rng.randint(0, longest), max(0, left - 1)])  # another plan, or the rest of the same
        reached = reached.at_replan({f"fact {rng.randrange(facts)}" for _ in range(rng.choice([0, 0, 1]))}, left)
        replans += 1
        assert replans <= (facts + 1) * (longest + 2) * (most + 1)


@pytest.mark.parametrize("opens_after", [None, 8.0])
def test_a_fact_that_is_not_known_is_no_longer_taken_as_false_once_a_call_could_not_begin(opens_after: float | None) -> None:
    """Else the same plan was found again and again, in vain, although another one needs nothing that is not known."""
    problem = parse_problem(INSIDE, parse_domain(DOORS if opens_after is None else ONE_WAY))

    async def scenario(simulation: TaskSimulation) -> None:
        simulation.knowledge.update({("locked",): UNKNOWN})
        task = simulation.want("(inside)")
        if opens_after is not None:
            await asyncio.sleep(opens_after)
            simulation.knowledge.update({("locked",): False})
        await simulation.reaches(task)
        assert simulation.sent(task) == (["leave()", "climb()", "jump()"] if opens_after is None else ["enter()"])
        assert simulation.endings[task].replans == 1

    simulate_tasks(scenario, problem, chosen=Settings())


def test_what_stays_unknown_is_waited_for_once() -> None:
    problem = parse_problem(INSIDE, parse_domain(ONE_WAY))

    async def scenario(simulation: TaskSimulation) -> None:
        simulation.knowledge.update({("locked",): UNKNOWN})
        task = simulation.want("(inside)")
        assert await simulation.ended_with(task) == [Code.CONDITION_LOST]
        assert "no plan without enter(), for which too little is known" in simulation.endings[task].message
        assert len(simulation.seen(task, "failed")) == 1

    simulate_tasks(scenario, problem, chosen=Settings())
