"""Tasks in processes that die, and others that go on with them, in one simulated world under the virtual clock."""

from __future__ import annotations

import asyncio
import random
from collections import Counter
from collections.abc import Callable, Coroutine, Mapping, Sequence
from contextvars import Context
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Final, TypeAlias
from uuid import UUID

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.problem import Problem
from planner_bridge.model.world import simulated_backend
from planner_bridge.tasks.result import TASKS
from planner_bridge.tasks.settings import Settings
from planner_bridge.tasks.task_manager import TaskLimits, TaskManager
from pnm.actions.backend import ClientBackend
from pnm.actions.faults import NO_FAULTS, Faults
from pnm.actions.simulated_robots import LAG
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.expressions import Fluent, Unknown, Value
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.plan_graph import GroundAction
from pnm.journal.kept import UNSHARED, Hold, JournalChoice
from pnm.journal.resume import take_up
from pnm.knowledge.source import Source
from pnm.language.runner import PlanRunner, Program
from pnm.tasks import TaskEnding, TaskListener, Wanted
from tests.support.pddl.problems import read_goal
from tests.support.runs.simulation.course import quiet
from tests.support.runs.simulation.disk import Disk, DiskPlan, Fate, Folder
from tests.support.runs.simulation.fleet import Connection, Fleet, Weather
from tests.support.runs.simulation.laws import GENERAL, broken_laws
from tests.support.runs.simulation.plans import Scenario
from tests.support.runs.simulation.processes import Process, ProcessLoop, run_processes
from tests.support.runs.simulation.story import Story

LIMIT: Final = 20000.0
"""Virtual seconds within which everything must be over."""
_ANY: Final = UUID(int=0)


class ConnectedBackend(ClientBackend):
    """The backend of one process: the servers of a fleet, and what sensors report."""

    def __init__(self, process: Process, fleet: Fleet, assumed: frozenset[str]) -> None:
        super().__init__(Connection(process, fleet, _ANY))
        self._process = process
        self._fleet = fleet
        self._assumed = assumed

    async def open(self, knowledge: KnowledgeBase) -> None:
        """Start the world's clock and its state reports."""
        world = self._fleet.robots.world
        names = world.reported(self._assumed)
        knowledge.sense(sorted(names), lag=LAG)
        knowledge.replace(names, world.report(names))

        def report(changes: Mapping[Fluent, Value | Unknown]) -> None:
            seen = {fluent: value for fluent, value in changes.items() if fluent[0] in names}
            self._process.do(knowledge.update, seen)

        world.truth.listen(report)
        Context().run(self._fleet.robots.begin)


@dataclass
class Survival(TaskListener):
    """What was left when everything was over."""

    story: Story = field(default_factory=lambda: Story(Scenario((), Bindings(), {}), TASKS))
    endings: dict[UUID, TaskEnding] = field(default_factory=dict)
    told: list[tuple[UUID, GroundAction]] = field(default_factory=list)
    """The requests that robots have begun, and their actions."""
    deaths: int = 0
    wrong: list[str] = field(default_factory=list)
    """What is against the rules."""
    news: asyncio.Event = field(default_factory=asyncio.Event)

    @property
    def doubled(self) -> list[str]:
        """The calls that robots have begun more than once."""
        return [str(action) for action, count in Counter(action for _, action in self.told).items() if count > 1]

    @property
    def repeated(self) -> list[str]:
        """The requests that robots have begun more than once."""
        return [str(request) for request, count in Counter(request for request, _ in self.told).items() if count > 1]

    def ended(self, task: UUID, ending: TaskEnding) -> None:
        self.endings[task] = ending
        self.news.set()


People: TypeAlias = Callable[[TaskManager, Survival], Coroutine[None, None, None]]


@dataclass(frozen=True)
class Deployment:
    """What processes are started with, one after the other."""

    problem: Problem
    tasks: Sequence[Wanted]
    settings: Settings
    programs: Mapping[str, Program]
    limits: TaskLimits | None
    folder: Folder
    fleet: Fleet
    survival: Survival
    in_turn: bool
    person: Source | None
    wall: Callable[[], float] | None
    people: People | None = None

    async def process(self, process: Process, plan: DiskPlan) -> None:
        """Go on with what is in the journal until everything is over."""
        story, survival = self.survival.story, self.survival

        def take(*_: object) -> tuple[Disk, Hold]:
            return Disk(self.folder, process, plan, story, lambda: None), UNSHARED

        taken = take_up(JournalChoice(self.folder.journal), TASKS, "", take)
        journal, replay = taken.write(wall=self.wall or process.loop.time), taken.replay
        knowledge = replay.world if replay else initial_knowledge(self.problem)
        backend = ConnectedBackend(process, self.fleet, self.settings.bindings.assumed)
        await backend.open(knowledge)
        runner = PlanRunner(self.programs, backend, knowledge, self.person, journal, replay)
        if replay is None:
            journal.begin(knowledge, runner.resources)
        manager = TaskManager(self.problem, runner, self.settings, partial(read_goal, self.problem), helper=self.person, limits=self.limits)
        manager.listen(survival)
        if replay:
            manager.restore(replay)
            survival.endings |= {id: task.ending for id, task in replay.tasks.items() if task.ending is not None}
        beside = asyncio.ensure_future(self.people(manager, survival)) if self.people else None
        new = [wanted for wanted in self.tasks if not (replay and wanted.id in replay.tasks)]  # whose clients ask again
        begun = {wanted.id for wanted in self.tasks} - {wanted.id for wanted in new}
        while not {wanted.id for wanted in self.tasks} <= survival.endings.keys():
            survival.news.clear()
            while new and (not self.in_turn or begun <= survival.endings.keys()):
                begun.add(new[0].id)
                manager.begin(new.pop(0))
            await survival.news.wait()
        if beside is not None:
            await beside
        await manager.close()
        journal.close()
        story.beliefs = knowledge


def survive(
    problem: Problem,
    tasks: Sequence[Wanted],
    settings: Settings,
    journal: Path,
    deaths: Sequence[int | DiskPlan],
    *,
    faults: Faults = NO_FAULTS,
    programs: Mapping[str, Program] | None = None,
    limits: TaskLimits | None = None,
    weather: Weather | None = None,
    in_turn: bool = False,
    person: Source | None = None,
    wall: Callable[[], float] | None = None,
    people: People | None = None,
) -> Survival:
    """Carry out tasks in processes that die as they are told, one after the other, and in one more that does not.

    A number is that of the commit, from the birth of its process, after which a process dies.
    Tasks in turn are begun when those before them are over. The person is asked by plans, and for help. `wall` returns the time of day.
    `people` do in each process what they want of its tasks.
    """
    survival = Survival()
    files = Folder(journal)
    plans = [plan if isinstance(plan, DiskPlan) else DiskPlan(plan, Fate.DIES_AFTER) for plan in deaths]

    async def whole(loop: ProcessLoop) -> None:
        robots = simulated_backend(problem, settings.bindings, faults).robots
        fleet = Fleet(robots, loop, random.Random(0), survival.story, weather or Weather())
        fleet.carried_out = survival.told
        deployment = Deployment(problem, tasks, settings, programs or {}, limits, files, fleet, survival, in_turn, person, wall, people)
        async with asyncio.timeout(LIMIT):
            for plan in (*plans, DiskPlan()):
                process = Process(loop, f"p{survival.deaths}", lambda error: survival.wrong.append(f"{type(error).__name__}: {error}"))
                process.start(deployment.process(process, plan))
                await process.over.wait()
                if not process.is_dead:
                    break
                survival.deaths += 1
                await asyncio.sleep(0.5)  # robots go on meanwhile
        robots.close()
        survival.story.truth = robots.world.truth
        stubborn = [fault for fault in faults.faults if fault.ignores_cancel]
        at_work = [request.action for request in robots.at_work]
        survival.wrong += [f"{action} goes on" for action in at_work if not any(fault.concerns(action) for fault in stubborn)]

    with quiet():
        run_processes(whole)
    survival.story.read(files.journal)
    survival.wrong += [*survival.story.failures, *broken_laws(survival.story, GENERAL)]
    return survival
