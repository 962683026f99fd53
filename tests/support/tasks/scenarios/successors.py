"""Task managers in processes that follow each other, with robots that outlive them, under the virtual clock."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from uuid import UUID

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.world import simulated_backend
from planner_bridge.tasks.result import TASKS
from planner_bridge.tasks.settings import Settings
from planner_bridge.tasks.task_manager import TaskLimits, TaskManager
from pnm.actions.backend import ClientBackend, SimulatedBackend
from pnm.actions.faults import NO_FAULTS, Faults
from pnm.actions.simulated_robots import SimulatedRobots
from pnm.core.logic.conditions import Condition, Holds
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Reporter, Request
from pnm.errors import InputError
from pnm.journal.journal import WrittenJournal
from pnm.journal.replay import Replay
from pnm.journal.resume import replayed
from pnm.journal.store import JournalFile
from pnm.language.runner import PlanRunner, Program
from pnm.tasks import TaskEnding, TaskListener, TraceEvent, TraceKind
from tests.support.pddl.problems import fleet


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


class Heard(TaskListener):
    """A listener that notes what is sent, what is given up, and how tasks end."""

    def __init__(self) -> None:
        self.sent = asyncio.Event()
        self.given_up = asyncio.Event()
        self.endings: dict[UUID, TaskEnding] = {}
        self.over = asyncio.Event()

    def happened(self, event: TraceEvent) -> None:
        if event.kind is TraceKind.SENT:
            self.sent.set()
        if event.kind is TraceKind.WITHHELD:
            self.given_up.set()

    def ended(self, task: UUID, ending: TaskEnding) -> None:
        self.endings[task] = ending
        self.over.set()


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


class Successors:
    """Processes that follow each other in a world of two robots; everything in it may be changed between them.

    Args:
        folder: for the journal that they share.
        goals: what texts stand for; another one is no goal.
        binding: of all calls.
        programs: plans that are loaded.
        limits: of the task managers.
    """

    def __init__(
        self,
        folder: Path,
        goals: Mapping[str, tuple[str, ...]],
        binding: Binding = Binding(resources=("{r}",)),
        faults: Faults = NO_FAULTS,
        programs: Mapping[str, Program] | None = None,
        limits: TaskLimits | None = None,
    ) -> None:
        self.journal, self.goals, self.problem = folder / "journal", goals, fleet(robots=2)
        self._settings = Settings(improve=0.0, bindings=Bindings({"move": binding}))
        self._robots = simulated_backend(self.problem, self._settings.bindings, faults).robots
        self._programs, self._limits = programs or {}, limits

    @asynccontextmanager
    async def begun(self) -> AsyncIterator[tuple[TaskManager, Heard]]:
        """The tasks of the first process, which dies at the end, and what is heard of them."""
        process, heard = await self._process(None)
        yield process.manager, heard
        await process.die()

    @asynccontextmanager
    async def gone_on(self) -> AsyncIterator[tuple[Process, Replay, Heard]]:
        """The next one, which has gone on with what the replay has, and what is heard of its tasks."""
        replay = replayed(self.journal, TASKS)
        process, heard = await self._process(replay)
        process.manager.restore(replay)
        async with asyncio.timeout(1000.0):
            yield process, replay, heard
        await process.manager.close()
        process.journal.close()

    async def _process(self, replay: Replay | None) -> tuple[Process, Heard]:
        link, others, heard = Link(self._robots), frozenset(asyncio.all_tasks()), Heard()
        backend = SimulatedBackend(self._robots)
        ClientBackend.__init__(backend, link)  # the requests of this process go through its link
        written = WrittenJournal(JournalFile(self.journal, 0.0), TASKS, replay)
        knowledge = replay.world if replay else initial_knowledge(self.problem)
        await backend.open(knowledge)
        runner = PlanRunner(self._programs, backend, knowledge, None, written, replay)
        if replay is None:
            written.begin(knowledge, runner.resources)
        manager = TaskManager(self.problem, runner, self._settings, self._read, limits=self._limits)
        manager.listen(heard)
        return Process(manager, written, link, others), heard

    def _read(self, text: str) -> Condition:
        if text not in self.goals:
            raise InputError(f"no goal has the name {text}")
        return Holds(self.goals[text])
