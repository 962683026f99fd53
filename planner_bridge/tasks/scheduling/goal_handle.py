"""The handle of a goal that is pursued on the event loop that runs here: awaited for its result; paused, resumed, stopped meanwhile."""

from __future__ import annotations

import asyncio
from collections.abc import Generator
from typing import Any, cast
from uuid import uuid4

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.problem import Problem
from planner_bridge.tasks.result import Stopwatch, TaskResult
from planner_bridge.tasks.scheduling.task_journal import KEPT_NOWHERE, TaskJournal
from planner_bridge.tasks.scheduling.task_manager import TaskManager
from planner_bridge.tasks.settings import Settings, TaskObserver
from pnm.actions.backend import Backend, check_ready
from pnm.errors import InputError
from pnm.journal.journal import Journal
from pnm.knowledge.sources import SourceChoice, Sources, Surroundings, make_source
from pnm.tasks import Code, TaskState, Wanted


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
    ) -> None:
        self._journal = journal
        self._backend = backend
        self._problem = problem
        self._settings = settings
        self._observer = observer
        self._stopwatch = stopwatch
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
        with self._journal.opened(self._backend) as journal:
            return await self._pursue(journal)

    async def _pursue(self, journal: Journal) -> TaskResult:
        backend, goal = self._backend, self._problem.goal
        knowledge = self._journal.world(initial_knowledge(self._problem))
        helper = None
        try:
            try:
                await backend.open(knowledge)
                await check_ready(backend)
            except asyncio.CancelledError:
                cast("asyncio.Task[object]", asyncio.current_task()).uncancel()
                return TaskResult(Code.CANCELLED, "cancelled", 0, (), self._stopwatch.seconds)
            if self._settings.ask_for_help:
                helper = Sources((), make_source(SourceChoice("person"), Surroundings(getattr(backend, "ros", None))))
            runner = self._journal.runner(backend, knowledge, journal)
            manager = TaskManager(self._problem, runner, self._settings, lambda _: goal, helper=helper)
            self._manager = manager
            return await self._journal.carry_out(manager, Wanted(uuid4(), ""), self._observer, self._stopwatch)
        finally:
            if helper is not None:
                await helper.close()
            await backend.close()

    @property
    def state(self) -> TaskState:
        """How the goal is doing."""
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
