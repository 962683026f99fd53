"""Sensors that are slower than others: what they have not said yet of a call that has begun is no reason for another plan."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field

import pytest

from planner_bridge.model.problem import Problem
from planner_bridge.model.simulation import robots_of
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.pipeline.achieve import achieve_at
from planner_bridge.tasks.result import TaskResult
from planner_bridge.tasks.settings import OnChange, Settings, TaskObserver
from pnm.actions.backend import SimulatedBackend
from pnm.actions.faults import NO_FAULTS, Faults
from pnm.clock import run_async
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.machine.machine import OnFailure

FETCH = """(define (domain fetch) (:requirements :adl :durative-actions :numeric-fluents)
  (:types robot place item) (:predicates (at ?r - robot ?p - place) (in ?i - item ?p - place)
    (carries ?r - robot ?i - item) (free ?r - robot))
  (:functions (battery ?r - robot))
  (:durative-action move :parameters (?r - robot ?to - place) :duration (= ?duration 4)
    :condition (and (at start (free ?r)) (at start (> (battery ?r) 0.2)) (at start (not (at ?r ?to))))
    :effect (and (at start (not (free ?r))) (at end (free ?r)) (at start (forall (?p - place) (not (at ?r ?p)))) (at end (at ?r ?to))))
  (:durative-action grasp :parameters (?r - robot ?i - item ?p - place) :duration (= ?duration 1)
    :condition (and (at start (free ?r)) (over all (at ?r ?p)) (at start (in ?i ?p)))
    :effect (and (at start (not (free ?r))) (at end (free ?r)) (at end (not (in ?i ?p))) (at end (carries ?r ?i))))
  (:durative-action release :parameters (?r - robot ?i - item ?p - place) :duration (= ?duration 1)
    :condition (and (at start (free ?r)) (over all (at ?r ?p)) (at start (carries ?r ?i)))
    :effect (and (at start (not (free ?r))) (at end (free ?r)) (at end (in ?i ?p)) (at end (not (carries ?r ?i))))))"""
THERE_AND_BACK = """(define (problem p) (:domain fetch) (:objects r1 - robot dock hall - place cup - item)
  (:init (free r1) (at r1 hall) (in cup dock) (= (battery r1) 0.9)) (:goal (in cup hall)))"""
CALLS = ["move(r1, dock)", "grasp(r1, cup, dock)", "move(r1, hall)", "release(r1, cup, hall)"]


@dataclass
class Sampled(SimulatedBackend):
    """Simulated robots whose place is reported once in a while, and their battery all the time, a little less each time."""

    problem: Problem
    period: float
    phase: float = 0.0
    faults: Faults = NO_FAULTS
    tasks: list[asyncio.Task[None]] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__(robots_of(self.problem, Settings().bindings, self.faults))

    async def open(self, knowledge: KnowledgeBase) -> None:
        world, quick = self.robots.world, frozenset({"battery", "in", "carries"})
        knowledge.sense({"at"}, lag=1.0)
        knowledge.sense(quick, lag=1.0)
        knowledge.replace({"at", *quick}, world.report(frozenset({"at", *quick})))
        self.robots.begin()

        async def sample(names: frozenset[str], period: float, phase: float) -> None:
            await asyncio.sleep(phase)
            while True:
                knowledge.replace(names, world.report(names))
                await asyncio.sleep(period)

        async def drain() -> None:
            while True:
                await asyncio.sleep(0.2)
                world.change({("battery", "r1"): float(world.truth.value(("battery", "r1"))) - 0.0001})  # type: ignore[arg-type]

        samples = sample(frozenset({"at"}), self.period, self.phase), sample(quick, 0.1, 0.05)
        self.tasks = [asyncio.ensure_future(one) for one in (*samples, drain())]

    async def close(self) -> None:
        for task in self.tasks:
            task.cancel()
        await super().close()


def fetched(backend: Sampled) -> TaskResult:
    settings = Settings(on_change=OnChange.EAGER, on_failure=OnFailure.CONTINUE_OTHERS)
    return run_async(achieve_at(backend, backend.problem, settings, TaskObserver()), virtual=True)


def problem() -> Problem:
    return parse_problem(THERE_AND_BACK, parse_domain(FETCH))


@pytest.mark.parametrize("phase", [0.0, 0.31, 0.62, 0.93])
@pytest.mark.parametrize("period", [0.5, 0.9])
def test_where_a_robot_has_just_left_is_not_where_it_is_planned_with(period: float, phase: float) -> None:
    result = fetched(Sampled(problem(), period, phase))
    assert result.goal_reached
    assert (result.plans, result.replans, result.failures) == (1, 0, ())
    assert [str(call.call.action) for call in result.calls] == CALLS
