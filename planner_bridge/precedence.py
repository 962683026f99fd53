"""Who makes way for whom: a task is held up while one of higher priority, with which it is in conflict, goes on.

It goes on by itself when nobody holds it up any more: those of higher priority are over, are paused, or only wait for answers.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from uuid import UUID

from planner_bridge.task import Task
from planner_bridge.turnstile import Turnstile
from pnm.resources import Resources
from pnm.tasking import TaskState


class Precedence:
    """Has tasks pause for others, and go on. The mutable state is who is being paused.

    Args:
        tasks: all that are not over.
        resources: what they share.
        turnstile: where they wait for their turn to look for a plan.
    """

    def __init__(self, tasks: Mapping[UUID, Task], resources: Resources, turnstile: Turnstile[Task]) -> None:
        self._tasks = tasks
        self._resources = resources
        self._turnstile = turnstile
        self._pausing: dict[UUID, asyncio.Task[None]] = {}

    async def make_way(self, task: Task, other: Task) -> None:
        """Have a task make way for another one; return when nothing of it is under way."""
        if task.state is TaskState.CANCELLING:
            await task.over.wait()
        self._yield(task, other)
        self.update(task)
        if pausing := self._pausing.get(task.id):
            await asyncio.shield(pausing)

    def arrange(self) -> None:
        """Have those make way that have what a claim of higher priority waits for."""
        outranked = self._resources.outranked()
        for claim in self._resources.line:
            for held in self._resources.held:
                is_outranked = held.task in outranked and held.priority < claim.priority and self._resources.gives(held)
                if is_outranked and not set(held.names).isdisjoint(claim.names):
                    self._arrange(held.task, claim.task)

    def _arrange(self, holder: UUID, waiting: UUID) -> None:
        if holder in self._tasks and waiting in self._tasks:
            self._yield(self._tasks[holder], self._tasks[waiting])
            self.update(self._tasks[holder])

    def changed(self, task: UUID) -> None:
        """Look at those that make way for a task: it may have ceased to go on, or have begun again."""
        for other in tuple(self._tasks.values()):
            if task in other.preempted_by:
                self.update(other)

    def update(self, task: Task) -> None:
        """Have a task pause if it is held up, and go on if nobody has paused it either."""
        if task.is_held or task.id not in self._tasks or task.state is TaskState.CANCELLING:
            return
        if not (why := self._why_held_up(task)):
            task.go_on()
        elif (task.is_active or task.why != why) and task.id not in self._pausing:
            self._pausing[task.id] = asyncio.get_running_loop().create_task(self._pause(task))

    def _yield(self, task: Task, other: Task) -> None:
        if other.id not in task.preempted_by and task.id in self._tasks:
            task.preempted_by.add(other.id)
            task.note("conflict", "", f"makes way for {other.name}")

    def _why_held_up(self, task: Task) -> str:
        others = [self._tasks[one] for one in task.preempted_by if one in self._tasks]
        names = [one.name for one in sorted(others, key=lambda one: one.rank) if one.goes_on]
        return f"makes way for {', '.join(names)}" if names else ""

    async def _pause(self, task: Task) -> None:
        try:
            if (why := self._why_held_up(task)) and not task.is_held:  # still
                self._turnstile.leave(task)
                await task.pause(why, at_once=True)
        finally:
            del self._pausing[task.id]
        self._turnstile.changed()
        if task.is_active:
            self.update(task)  # somebody else may have come
