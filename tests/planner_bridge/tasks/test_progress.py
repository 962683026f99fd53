"""Progress: replans that bring a task further are not counted, and those that do not end it."""

from __future__ import annotations

import asyncio
from itertools import pairwise
from random import Random

import pytest

from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.tasks.replanning import GiveUp, Limits, Reached
from planner_bridge.tasks.settings import Settings
from pnm.actions.faults import Fault, FaultKind, Faults, HiddenChange
from pnm.core.logic.expressions import UNKNOWN
from pnm.core.machine.bindings import Binding, Bindings
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
