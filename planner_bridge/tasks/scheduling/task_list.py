"""The tasks that are not over, and those that ended last."""

from __future__ import annotations

from uuid import UUID

from planner_bridge.tasks.control import Execution
from planner_bridge.tasks.task import Task
from pnm.core.knowledge_base import Layered
from pnm.knowledge.source import Asker
from pnm.tasks import REMEMBERED, TaskRefused, TaskStatus


class TaskList:
    """The tasks of a task manager. The mutable state is the tasks that are not over, by their identities, and those that ended last."""

    def __init__(self) -> None:
        self.active: dict[UUID, Task] = {}
        self.past: list[Task] = []

    def chosen(self, task: UUID | None) -> list[Task]:
        """Return one task, or all that are not over; raise `TaskRefused` if there is no such task."""
        if task is None:
            return list(self.active.values())
        if task not in self.active:
            over = any(past.id == task for past in self.past)
            raise TaskRefused(f"the task {task} is over" if over else f"there is no task {task}")
        return [self.active[task]]

    def in_order(self) -> list[Task]:
        """Return the tasks that are not over, in the order in which they are served."""
        return sorted(self.active.values(), key=lambda task: task.rank)

    def status(self) -> tuple[TaskStatus, ...]:
        """Return the status of all tasks that are not over, in the order in which they are served, and of those that ended last."""
        return tuple(task.status for task in (*self.in_order(), *self.past))

    def of(self, id: UUID) -> Task:
        """Return a task of this identity, which is not over, or has ended just now."""
        return self.active.get(id) or next(past for past in self.past if past.id == id)

    def knowledge_of(self, request: UUID) -> tuple[Layered, Asker] | None:
        """Return the knowledge of the run that has sent a request, and as whom it asks; None unless the request is open."""
        for task in self.active.values():
            run = task.control.run
            if run is not None and request in run.open_requests:
                return run.knowledge, Asker(run.id, task.wanted.text)
        return None

    def execution_of(self, request: UUID) -> Execution:
        """Return the execution of the plan that has sent a request; raise `TaskRefused` unless it is open."""
        for task in self.active.values():
            if (execution := task.control.execution) and (call := execution.executor.run.open_calls.get(request)):
                if call.action.operation is not None:
                    raise TaskRefused(f"{call.action.operation} is about knowledge: no server does it")
                return execution
        raise TaskRefused("no call of a task has that request under way")

    def remember(self, task: Task) -> None:
        """List a task that is over."""
        self.past = [*self.past[1 - REMEMBERED :], task]
