"""The household's robots in this process: an action client that calls the simulator, and its sensors."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final
from uuid import UUID

from pyrobosim.core import World
from pyrobosim.planning.actions import ExecutionResult

from planner_bridge.model.problem import Problem
from planner_bridge.pipeline.goal_handle import KEPT_NOWHERE, GoalHandle, TaskJournal
from planner_bridge.pipeline.loading import load
from planner_bridge.tasks.result import Stopwatch, TaskResult
from planner_bridge.tasks.settings import Settings, TaskObserver
from pnm.actions.backend import ClientBackend
from pnm.actions.bindings_file import read_bindings
from pnm.clock import run_async
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind, Reporter, Request
from pnm.core.message_fields import value_in
from pnm.knowledge.sensor_file import read_sensing
from pnm.knowledge.sensor_model import Instance, instances, read
from tests.support.e2e.household.simulator import counted, load_world, perform, without_waiting, world_state
from tests.support.files import ROOT

HOUSEHOLD: Final = ROOT / "domains" / "household"


def problem_of(number: int) -> Problem:
    """Load one of the four problems."""
    return load(HOUSEHOLD / "domain.pddl", HOUSEHOLD / f"problem{number}.pddl")


def in_world(number: int, seed: int, folder: Path | None = None) -> SimulatorBackend:
    """Return the robots of a problem's world; see `load_world`."""
    return SimulatorBackend(load_world(number, seed, folder), problem_of(number))


def pursue(backend: SimulatorBackend, journal: Path | None = None, **settings: Any) -> TaskResult:
    """Pursue the goal of the problem with planner, executor and replanning, as fast as it goes; a journal is a new one."""
    chosen, kept = Settings(bindings=backend.bindings, **settings), TaskJournal.of(journal) if journal else KEPT_NOWHERE
    with without_waiting():
        return run_async(GoalHandle(backend, backend.problem, chosen, TaskObserver(), Stopwatch(), kept).run(), virtual=True)


class SimulatorBackend(ClientBackend):
    """The robots of a world: an action client whose drives take their time on the clock of the loop; sensors report what is so after each.

    Attributes:
        world: the simulator's.
        work: what its robots have done.
        performed: called with the type of each action, before what has changed is reported.
    """

    def __init__(self, world: World, problem: Problem) -> None:
        super().__init__(self)
        self.world = world
        self.problem = problem
        self.bindings = read_bindings(HOUSEHOLD / "bindings.yaml", problem.vocabulary)
        self.work = counted(world)
        self.performed: Callable[[str], None] = lambda kind: None
        self.sensing = read_sensing(HOUSEHOLD / "sensing.yaml", problem.vocabulary)
        self._sensors: tuple[Instance, ...] = ()

    def tell(self, times: Mapping[tuple[str, str], float]) -> None:
        """Tell planners how long drives take between places, besides what every action takes; nothing if there are none."""
        if not times:
            return
        actions = dict(self.bindings.actions)
        for name, target in (("navigate", "?to"), ("charge", "?charger")):
            besides, actions[name] = actions[name].seconds or 0.0, replace(actions[name], seconds=("drive_time", "?from", target))
            assert not isinstance(besides, tuple)
            told = {("drive_time", *way): besides + seconds for way, seconds in times.items()}
            self.problem = replace(self.problem, init={**self.problem.init, **told})
        self.bindings = replace(self.bindings, actions=actions)

    async def open(self, knowledge: KnowledgeBase) -> None:
        """Report the state of the world, from now on after every action."""
        for name in self.sensing.names:
            knowledge.sense((name,), lag=0.0)
        self._knowledge = knowledge
        self._sensors = instances(self.sensing, knowledge.objects)
        self.report(self._knowledge)

    def goal_fields(self, action: GroundAction, /) -> tuple[str, ...]:
        """Return the fields of an `ExecuteTaskAction` goal."""
        return ("action", "realtime_factor")

    def send(self, request: Request, report: Reporter, /) -> None:
        """Perform the request in the next turn of the loop."""
        asyncio.get_running_loop().call_soon(self._perform, request, report)

    def cancel(self, request: UUID, /) -> None:
        """Do nothing: what was accepted ends by itself."""

    def act(self, action: Mapping[str, Any]) -> ExecutionResult:
        """Perform an action, given its fields."""
        return perform(self.world, action)

    def _perform(self, request: Request, report: Reporter) -> None:
        report(Accepted(request.id))
        before, result = self.work.driving, self.act(request.goal["action"])
        asyncio.get_running_loop().call_later(self.work.driving - before, self._end, request, report, result)

    def _end(self, request: Request, report: Reporter, result: ExecutionResult) -> None:
        self.performed(request.goal["action"]["type"])
        self.report(self._knowledge)
        ended = Outcome(OutcomeKind.SUCCEEDED, {"execution_result": {"status": int(result.status), "message": result.message or ""}})
        report(Ended(request.id, self.bindings.of(request.action.name).judged(ended)))

    def report(self, knowledge: KnowledgeBase) -> None:
        """Report the state of the world."""
        answer = {"state": world_state(self.world)}
        for sensor in self._sensors:
            reading = read(sensor, partial(value_in, answer), knowledge.objects)
            assert not reading.unread, reading.unread
            knowledge.update(reading.facts)
