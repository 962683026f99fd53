"""People take the household's robot over, drive it elsewhere, and give it back: it is told nothing meanwhile, and the goal is reached."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Mapping
from typing import Any
from uuid import UUID

import pytest
from pyrobosim.planning.actions import ExecutionResult

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.tasks.result import Stopwatch, TaskResult
from planner_bridge.tasks.settings import Settings, TaskObserver
from planner_bridge.tasks.task_manager import TaskManager
from pnm.clock import run_async
from pnm.core.machine.requests import Ended, Outcome, OutcomeKind, Reporter, Request
from pnm.language.runner import PlanRunner
from pnm.tasks import Wanted
from tests.support.e2e.household.in_process import SimulatorBackend, problem_of
from tests.support.e2e.household.simulator import asked, has_reached, load_world, perform, without_waiting


class Watched(SimulatorBackend):
    """Robots that remember what they were told while a person had them."""

    has_person = False
    taken = 0

    def __init__(self, problem: int, seed: int) -> None:
        super().__init__(load_world(problem, seed), problem_of(problem))
        self.wrong: list[Mapping[str, Any]] = []
        self._under_way: dict[UUID, Reporter] = {}

    def _perform(self, request: Request, report: Reporter) -> None:
        self._under_way[request.id] = report
        super()._perform(request, report)

    def _end(self, request: Request, report: Reporter, result: ExecutionResult) -> None:
        if self._under_way.pop(request.id, None):
            super()._end(request, report, result)

    def cancel(self, request: UUID, /) -> None:
        """Stop at once, where the simulator is by now: it drives in no time."""
        if report := self._under_way.pop(request, None):
            self.report(self._knowledge)
            report(Ended(request, Outcome(OutcomeKind.CANCELED)))

    def act(self, action: Mapping[str, Any]) -> ExecutionResult:
        if self.has_person:
            self.wrong.append(action)
        return super().act(action)

    async def interfere(self, tasks: TaskManager, rng: random.Random) -> None:
        """Take the robot over, maybe drive it into some room, and give it back, again and again."""
        (robot,) = self.world.robots
        while True:
            await asyncio.sleep(rng.uniform(0.0, 8.0))
            assert await tasks.take(robot.name, reason="it is in the way") == "", "what was under way is over"
            self.has_person, self.taken = True, self.taken + 1
            await asyncio.sleep(rng.uniform(0.0, 30.0))
            if rng.random() < 0.5:
                perform(self.world, asked(robot, "navigate", rng.choice([room.name for room in self.world.rooms])))
                self.report(self._knowledge)
            self.has_person = False
            await tasks.give(robot.name)


def pursued(backend: Watched, seed: int) -> TaskResult:
    async def both() -> TaskResult:
        problem, world = backend.problem, initial_knowledge(backend.problem)
        await backend.open(world)
        runner, settings = PlanRunner({}, backend, world, None), Settings(bindings=backend.bindings)
        tasks = TaskManager(problem, runner, settings, lambda _: problem.goal)
        ended = asyncio.ensure_future(tasks.run(Wanted(UUID(int=1), ""), TaskObserver(), Stopwatch()))
        person = asyncio.create_task(backend.interfere(tasks, random.Random(f"{seed}/hands")))
        await asyncio.wait([person, ended], return_when=asyncio.FIRST_COMPLETED)
        if person.done():
            await person
        person.cancel()
        await backend.close()
        return await ended

    with without_waiting():
        return run_async(both(), virtual=True)


@pytest.mark.parametrize("problem", [2, 3])
def test_a_robot_in_a_persons_hands_is_told_nothing(problem: int) -> None:
    taken = 0
    for seed in range(2):
        backend = Watched(problem, seed)
        result = pursued(backend, seed)
        assert result.goal_reached, result.reason
        assert has_reached(backend.world, problem)
        assert not backend.wrong
        taken += backend.taken
    assert taken >= 4
