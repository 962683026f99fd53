"""The handle of a goal that is pursued on the event loop that runs here: awaited for its result; paused, resumed, stopped meanwhile."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, cast
from uuid import uuid4

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.problem import Problem
from planner_bridge.tasks.result import TASKS, PlanResult, Stopwatch, TaskResult
from planner_bridge.tasks.settings import Settings, TaskObserver
from planner_bridge.tasks.task_manager import TaskManager
from pnm.actions.backend import Backend, SimulatedBackend, check_ready
from pnm.clock import continue_from
from pnm.core.knowledge_base import KnowledgeBase
from pnm.errors import InputError, check_kinds
from pnm.files.database.place import place_of
from pnm.journal.journal import NO_JOURNAL, Journal
from pnm.journal.kept import Fenced, JournalChoice
from pnm.journal.records import SharedBegan
from pnm.journal.replay import Replay
from pnm.knowledge.source import Source
from pnm.knowledge.sources import SourceChoice, Sources, Surroundings, make_source
from pnm.language.runner import PlanRunner, Program
from pnm.tasks import Code, TaskState, Wanted

if TYPE_CHECKING:
    from pnm.journal.resume import Taken


@dataclass(frozen=True)
class TaskJournal:
    """The journal of one task.

    Args:
        taken: the journal, which nobody else can write now; None for none.
        origin: what its world is made from.
        replay: of what goes on; None if the task begins.
    """

    taken: Taken | None = None
    origin: str = ""
    replay: Replay | None = None

    @staticmethod
    def of(journal: JournalChoice | Path | str, *origin: str) -> TaskJournal:
        """Return the journal with the task in it that is not finished, if there is one; raise an `InputError` if it cannot be used.

        Args:
            origin: the texts that its world is made from.
        """
        from pnm.journal.resume import take_up  # here, because it takes its time to import, for which runs without a journal need not wait

        choice = JournalChoice(place_of(str(journal))) if isinstance(journal, Path | str) else journal
        check_kinds("the journal", {"journal": (choice, JournalChoice)})
        digest = sha256("\0".join(origin).encode()).hexdigest()
        taken = take_up(choice, TASKS, digest)
        return TaskJournal(taken, digest, taken.replay if taken.replay and taken.replay.unfinished else None)

    def world(self, initial: KnowledgeBase) -> KnowledgeBase:
        """Return the knowledge of the world: that of another process, or the initial knowledge."""
        return self.replay.world if self.replay else initial

    @contextmanager
    def opened(self, backend: Backend) -> Iterator[Journal]:
        """Enter the journal; the time of what goes on in it goes on as well, and simulated robots begin in its world."""
        if self.taken is None:
            yield NO_JOURNAL
            return
        if self.replay:
            continue_from(self.replay.now)
            if isinstance(backend, SimulatedBackend):
                backend.robots.go_on_from(self.replay.world, self.replay.now - self.replay.began)
        fenced, task = list[Fenced](), asyncio.current_task()

        def end(why: Fenced) -> None:
            """Leave what runs alone: another process goes on with it."""
            fenced.append(why)
            if task is not None:
                task.cancel()
                task.get_loop().call_later(0.0, task.cancel)  # the first one only asks for an end, which this journal does not record

        journal = replace(self.taken, replay=self.replay).write(end)
        try:
            yield journal
        except asyncio.CancelledError:
            if not fenced:
                raise
            raise fenced[0] from None
        finally:
            journal.close()

    def runner(
        self, backend: Backend, world: KnowledgeBase, journal: Journal, programs: Mapping[str, Program], source: Source | None
    ) -> PlanRunner:
        """Return the executor of plans, with the resources that go on; or begin the journal."""
        runner = PlanRunner(programs, backend, world, source, journal, self.replay)
        if self.replay is None:
            command, seal = (self.taken.choice.command, self.taken.choice.seal) if self.taken else ((), "")
            began = SharedBegan(runner.resources.capacities, runner.prefix, self.origin, command=command, seal=seal)
            journal.begin(world, runner.resources, began=began)
        return runner


KEPT_NOWHERE: Final = TaskJournal()


@dataclass(frozen=True)
class GivenPlan:
    """A hand-written plan to carry out in place of a goal to pursue.

    Args:
        programs: the plan and those that it calls, by name.
        wanted: the plan by its name, with its parameters.
        open_sources: opens the sources of knowledge, given the connection of the backend to ROS, if it has one.
    """

    programs: Mapping[str, Program]
    wanted: Wanted
    open_sources: Callable[[Any], Sources]


class GoalHandle:
    """A goal that is pursued on a backend, by a task manager with one task.

    The mutable state is the task manager, once the backend is open, and the asyncio task, once it has begun.
    """

    def __init__(
        self,
        backend: Backend,
        problem: Problem,
        settings: Settings,
        observer: TaskObserver,
        stopwatch: Stopwatch,
        journal: TaskJournal = KEPT_NOWHERE,
        plan: GivenPlan | None = None,
    ) -> None:
        self._journal = journal
        self._backend = backend
        self._problem = problem
        self._settings = settings
        self._observer = observer
        self._stopwatch = stopwatch
        self._plan = plan
        self._manager: TaskManager | None = None
        self._task: asyncio.Task[TaskResult] | None = None

    def __repr__(self) -> str:
        return f"<GoalHandle of {self._problem.goal}: {self.state.name.lower()}>"

    def __await__(self) -> Generator[Any, None, TaskResult]:
        """Wait for the result; cancelling that alone does not stop it."""
        if self._task is None:
            raise InputError("the goal has not begun")
        return asyncio.shield(self._task).__await__()

    def begin(self) -> GoalHandle:
        """Begin on the running event loop; return the handle itself."""
        self._task = self._task or asyncio.get_running_loop().create_task(self.run(), name=repr(self))
        return self

    async def run(self) -> TaskResult:
        """Pursue the goal to its end.

        Cancelling this stops the task: what is under way is cancelled and waited for; cancelling it again leaves it alone.
        """
        backend, plan, is_ready, sources = self._backend, self._plan, False, None
        described = plan.programs[plan.wanted.text].plan if plan else self._problem
        with self._journal.opened(backend) as journal:
            world = self._journal.world(initial_knowledge(described))
            try:
                await backend.open(world)
                ros = getattr(backend, "ros", None)
                if plan:
                    sources = plan.open_sources(ros)
                elif self._settings.ask_for_help:  # a person may be asked for help with a goal, whose runs ask nobody else
                    sources = Sources((), make_source(SourceChoice("person"), Surroundings(ros)))
                runner = await self._runner(world, journal, sources)
                is_ready, helper = True, sources if self._settings.ask_for_help else None
                goal = self._problem.goal
                self._manager = TaskManager(self._problem, runner, self._settings, lambda _: goal, helper=helper)
                wanted = plan.wanted if plan else Wanted(uuid4(), "")
                return await self._manager.run(wanted, self._observer, self._stopwatch, self._journal.replay)
            except asyncio.CancelledError:
                if is_ready:  # and has been cancelled twice
                    raise
                cast("asyncio.Task[object]", asyncio.current_task()).uncancel()
                return (PlanResult if plan else TaskResult)(Code.CANCELLED, "cancelled", 0, (), self._stopwatch.seconds)
            finally:
                if sources is not None:
                    await sources.close()
                await backend.close()

    async def _runner(self, world: KnowledgeBase, journal: Journal, sources: Sources | None) -> PlanRunner:
        """Return the executor of plans, once the backend is ready for them; raise an `InputError` if it, or a parameter, is wrong."""
        backend, plan = self._backend, self._plan
        programs, source = plan.programs if plan else {}, sources if plan else None
        asked = PlanRunner(programs, backend, world, source)  # of which nothing is kept
        await check_ready(backend, asked.actions)
        if plan:
            await asked.check(asked.prepare_run(plan.wanted.text, plan.wanted.parameters))  # before anything is prepared
        runner = self._journal.runner(backend, world, journal, programs, source)
        if source is not None:
            await backend.share(runner.prefix, runner.knowledge_of, source)
            await runner.prepare()
        return runner

    @property
    def state(self) -> TaskState:
        """The state of the goal."""
        if self._task is not None and self._task.done():
            return TaskState.OVER
        return next((status.state for status in self._manager.status()), TaskState.PLANNING) if self._manager else TaskState.QUEUED

    @property
    def reason(self) -> str:
        """Why it is in this state: what it waits for, what failed."""
        return next((status.reason for status in self._manager.status()), "") if self._manager else ""

    async def pause(self, *, at_once: bool = False) -> None:
        """Start nothing more, and return when what is under way has ended; `at_once` cancels it, to begin it anew later."""
        if self._manager is not None:
            await self._manager.pause(None, at_once=at_once)

    async def resume(self) -> None:
        """Go on after a pause: with the rest of the plan if that still works."""
        if self._manager is not None:
            await self._manager.resume(None)

    async def stop(self) -> TaskResult:
        """Cancel what is under way, wait until it is over, and return the result; a second time, leave it alone."""
        if self._task is None:
            raise InputError("the goal has not begun")
        self._task.cancel()
        return await self
