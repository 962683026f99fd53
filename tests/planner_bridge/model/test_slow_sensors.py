"""Sensors that are slower than others: what they have not said yet of a call that has begun is no reason for another plan."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from planner_bridge.model.problem import Problem
from planner_bridge.model.world import robots_of
from planner_bridge.pddl import parse_domain, parse_problem, write_domain, write_problem
from planner_bridge.pipeline.achieve import achieve_at
from planner_bridge.pipeline.goal_handle import GoalHandle, TaskJournal
from planner_bridge.tasks.replanning import decision_words
from planner_bridge.tasks.result import TASKS, Stopwatch, TaskResult
from planner_bridge.tasks.settings import OnChange, Settings, TaskObserver
from pnm.actions.backend import SimulatedBackend
from pnm.actions.faults import NO_FAULTS, Faults, HiddenChange
from pnm.clock import run_async
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.machine.machine import OnFailure
from pnm.journal.resume import replayed

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


@pytest.mark.parametrize(("period", "phase"), [(0.5, 0.0), (0.5, 0.31), (0.9, 0.62), (0.9, 0.93)])
def test_where_a_robot_has_just_left_is_not_where_it_is_planned_with(period: float, phase: float) -> None:
    result = fetched(Sampled(problem(), period, phase))
    assert result.goal_reached
    assert (result.plans, result.replans, result.failures) == (1, 0, ())
    assert [str(call.call.action) for call in result.calls] == CALLS


TWO_CUPS = THERE_AND_BACK.replace("cup - item", "cup ball - item").replace("(in cup dock)", "(in cup dock) (in ball dock)")


def because(*changed: tuple[str, bool]) -> tuple[str, TaskResult]:
    """What is said of the first other plan, when somebody moves the ball after a second; and the result."""
    two = parse_problem(TWO_CUPS.replace("(in cup hall)", "(and (in cup hall) (in ball hall))"), parse_domain(FETCH))
    moved = HiddenChange({("in", "ball", place): value for place, value in changed}, at=1.02)
    result = fetched(Sampled(two, 0.5, faults=Faults(changes=(moved,))))
    return next(decision_words(episode.decision) for episode in result.episodes if episode.decision), result


def test_the_report_that_sets_off_another_plan_is_named() -> None:
    said, result = because(("dock", False), ("hall", True))
    assert result.goal_reached
    assert (
        "although (in ball dock) is false; set off by the report (not (in ball dock)) (in ball hall) (= (battery r1) 0.8995) at 1.05 s"
        in said
    )


def test_what_a_report_makes_needless_is_named_with_what_is_so_already() -> None:
    said, result = because(("hall", True))
    assert result.goal_reached
    assert "set off by the report (in ball hall) (= (battery r1) 0.8995) at 1.05 s; " in said
    assert "release(r1, ball, hall) is not needed: " in said
    assert "(in ball hall)" in said.partition("release(r1, ball, hall) is not needed: ")[2].partition(" already")[0]


class Silent(Sampled):
    """The position is not reported any more after three seconds."""

    async def open(self, knowledge: KnowledgeBase) -> None:
        await super().open(knowledge)
        self.tasks[0].cancel()
        places = [("at", "r1", place) for place in ("dock", "hall")]
        asyncio.get_running_loop().call_later(3.0, knowledge.forget, places, "nothing was heard on /r1/pose for 3 s")


def test_a_silent_sensor_is_named_in_the_reason_of_the_goal_and_by_what_replays_it(tmp_path: Path) -> None:
    journal = TaskJournal.of(tmp_path / "j", write_domain(problem().domain), write_problem(problem()))
    goal = GoalHandle(Silent(problem(), 0.5), problem(), Settings(), TaskObserver(), Stopwatch(), journal)
    result = run_async(goal.run(), virtual=True)
    assert not result.goal_reached
    assert "is unknown" in result.reason
    assert "nothing was heard on /r1/pose for 3 s" in result.reason
    replay = replayed(tmp_path / "j", TASKS)
    assert set(replay.world.why_unknown().values()) == {"nothing was heard on /r1/pose for 3 s"}
