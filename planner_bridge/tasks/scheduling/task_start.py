"""How tasks start: by their text, as a goal, as a plan that is sent, or as a plan that is loaded; each with its context."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Final
from uuid import UUID, uuid4

from planner_bridge.model.grounding import problem_now
from planner_bridge.model.plan import Plan
from planner_bridge.model.problem import Problem
from planner_bridge.tasks.context import Scheduler, TaskContext
from planner_bridge.tasks.goal_loop import GoalLoop
from planner_bridge.tasks.plan_task import PlanTask
from planner_bridge.tasks.result import goal_of
from planner_bridge.tasks.scheduling.task_text import TaskText, read_text
from planner_bridge.tasks.settings import OnChange, Settings
from planner_bridge.tasks.task import StartTask, Task
from pnm.core.knowledge_base import Layered
from pnm.core.logic.conditions import TRUE, Condition
from pnm.core.machine.requests import NOT_REATTACHED, Ended, ReattachingClient, Report, Request
from pnm.journal.replay import ReplayedTask
from pnm.knowledge.source import Source
from pnm.language.runner import PlanRunner
from pnm.tasks import OnConflict

PREFIX: Final = 4
"""Bytes that the identities of all requests of a process have in common."""


@dataclass
class TaskStart:
    """Starts tasks in one world. The arguments are those of `TaskManager`; the problem, and when it began, change with the world."""

    problem: Problem
    runner: PlanRunner
    settings: Settings
    read_goal: Callable[[str], Condition]
    scheduler: Scheduler
    on_conflict: OnConflict
    helper: Source | None
    began: float = field(default_factory=lambda: asyncio.get_running_loop().time())

    def reader(self, task: Task) -> Callable[[], TaskText]:
        """Return what reads the text of a task, in any thread."""
        return partial(read_text, task.wanted, self.read_goal, self.runner.programs, self._now() if task.wanted.is_plan else self.problem)

    def start(self, task: Task, text: TaskText, kept: ReplayedTask | None) -> StartTask:
        """Return what carries out a task with this text, where another process has left it.

        Raises:
            InputError: there is no such plan, or it has no such parameter.
        """
        match text:
            case None:
                return PlanTask(self.runner, self._context(task, TRUE, None), kept).carry_out
            case Plan() as plan:
                context = partial(self._context, task, TRUE, kept, on_change=OnChange.LAZY)
                return lambda: GoalLoop(context(), given=plan, kept=goal_of(kept)).pursue()
            case goal:
                task.goal = str(goal)
                return lambda: GoalLoop(self._context(task, goal, kept), kept=goal_of(kept)).pursue()

    def recall(self, requests: Iterable[Request]) -> None:
        """Cancel requests that another process has given up; their resources are free when their servers say that they are over."""

        def hear(report: Report) -> None:
            if isinstance(report, Ended):
                self.runner.journal.confirmed(report.request, self.runner.resources)

        client = self.runner.backend.client
        for request in requests:
            if isinstance(client, ReattachingClient):
                client.reattach(request, hear, accepted=True)
                client.cancel(request.id)
            else:
                hear(Ended(request.id, NOT_REATTACHED))

    def _now(self, at: float | None = None) -> Problem:
        return problem_now(self.problem, self.runner.world, (asyncio.get_running_loop().time() if at is None else at) - self.began)

    def _context(self, task: Task, goal: Condition, kept: ReplayedTask | None, *, on_change: OnChange | None = None) -> TaskContext:
        runner = self.runner
        since = kept.replay.now if kept and kept.notes else None  # facts that change by themselves have done so until then
        return TaskContext(
            task,
            replace(self._now(since), goal=goal),
            kept.runs[-1].run.knowledge if kept and kept.runs else Layered(runner.world),
            runner.backend,
            replace(self.settings, on_change=on_change or self.settings.on_change),
            runner.resources,
            runner.source,
            self.helper,
            self.scheduler,
            task.wanted.on_conflict or self.on_conflict,
            lambda: UUID(bytes=runner.prefix + uuid4().bytes[PREFIX:]),
            runner.journal,
            since,
        )
