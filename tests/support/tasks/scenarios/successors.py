"""Task managers in processes that follow each other, with robots that outlive them, under the virtual clock."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from uuid import UUID

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.problem import Problem
from planner_bridge.tasks.result import TASKS
from planner_bridge.tasks.settings import Settings
from planner_bridge.tasks.task_manager import TaskLimits, TaskManager
from pnm.actions.backend import ClientBackend, SimulatedBackend
from pnm.actions.simulated_robots import SimulatedRobots
from pnm.core.logic.conditions import Condition, Holds
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Reporter, Request
from pnm.errors import InputError
from pnm.journal.journal import WrittenJournal
from pnm.journal.replay import Replay
from pnm.journal.resume import replayed
from pnm.journal.store import JournalFile
from pnm.language.runner import PlanRunner, Program


class Link:
    """What a process reaches robots by; once it is cut, nothing gets through."""

    def __init__(self, robots: SimulatedRobots) -> None:
        self._robots = robots
        self.is_cut = False
        self.sent: list[str] = []

    def goal_fields(self, action: GroundAction, /) -> tuple[str, ...] | None:
        return self._robots.goal_fields(action)

    def send(self, request: Request, report: Reporter, /) -> None:
        if not self.is_cut:
            self.sent.append(str(request.action))
            self._robots.send(request, lambda what: None if self.is_cut else report(what))

    def reattach(self, request: Request, report: Reporter, /, *, accepted: bool) -> None:
        if not self.is_cut:
            self._robots.reattach(request, lambda what: None if self.is_cut else report(what), accepted=accepted)

    def cancel(self, request: UUID, /) -> None:
        if not self.is_cut:
            self._robots.cancel(request)


@dataclass
class Process:
    """A process: a task manager, its journal and its link to robots. Everything in it changes."""

    manager: TaskManager
    journal: WrittenJournal
    link: Link
    others: frozenset[asyncio.Task[object]]
    """What was there before the process, and outlives it."""

    async def die(self) -> None:
        """Do nothing any more, from this moment."""
        self.journal.close()
        self.link.is_cut = True
        for task in asyncio.all_tasks() - self.others:
            task.cancel()
        await asyncio.sleep(0)


@dataclass
class Successors:
    """Processes that follow each other.

    Args:
        problem: of their world.
        settings: theirs.
        robots: outlive them.
        journal: what they share.
        goals: what texts stand for; another one is no goal.
        programs: plans that are loaded.
        limits: of the task managers.
    """

    problem: Problem
    settings: Settings
    robots: SimulatedBackend
    journal: Path
    goals: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    programs: Mapping[str, Program] = field(default_factory=dict)
    limits: TaskLimits | None = None

    async def first(self) -> Process:
        """Return the first process."""
        return await self._process(None)

    async def next(self) -> tuple[Process, Replay]:
        """Return the next process, which has restored nothing yet, and what it is to go on with."""
        replay = replayed(self.journal, TASKS)
        return await self._process(replay), replay

    async def _process(self, replay: Replay | None) -> Process:
        link, others = Link(self.robots.robots), frozenset(asyncio.all_tasks())
        backend = SimulatedBackend(self.robots.robots)
        ClientBackend.__init__(backend, link)  # the requests of this process go through its link
        written = WrittenJournal(JournalFile(self.journal, 0.0), TASKS, replay)
        knowledge = replay.world if replay else initial_knowledge(self.problem)
        await backend.open(knowledge)
        runner = PlanRunner(self.programs, backend, knowledge, None, written, replay.resources if replay else None)
        if replay is None:
            written.begin(knowledge, runner.resources)
        manager = TaskManager(self.problem, runner, self.settings, self._read, limits=self.limits)
        return Process(manager, written, link, others)

    def _read(self, text: str) -> Condition:
        if text not in self.goals:
            raise InputError(f"no goal has the name {text}")
        return Holds(self.goals[text])
