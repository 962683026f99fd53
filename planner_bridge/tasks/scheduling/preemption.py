"""Who makes way for whom: a task is held up while one of higher priority, with which it is in conflict, goes on.

It goes on by itself when nobody holds it up any more: those of higher priority are over, are paused, or only wait for answers.

The tasks beside one, as its pursuit sees them.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from uuid import UUID

from planner_bridge.ordering.interference import ReadWriteSets, interference
from planner_bridge.tasks.context import Begun, Conflict, Neighbours
from planner_bridge.tasks.scheduling.planning_queue import Turnstile
from planner_bridge.tasks.task import Task
from pnm.core.execution.resources import Resources
from pnm.tasks import TaskState


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


class Neighbourhood(Neighbours):
    """The neighbours of one task.

    Args:
        task: whose they are.
        tasks: all that are not over.
        precedence: has those make way that yield.
        turnstile: where they wait for their turn to look for a plan.
    """

    def __init__(self, task: Task, tasks: Mapping[UUID, Task], precedence: Precedence, turnstile: Turnstile[Task]) -> None:
        self._task = task
        self._tasks = tasks
        self._precedence = precedence
        self._turnstile = turnstile

    def conflicts(self, footprint: Callable[[], ReadWriteSets], /) -> tuple[Conflict, ...]:
        """Return the tasks that are active and beside which a plan with this footprint cannot be carried out."""
        others = self._others
        if not others:
            return ()
        found, mine = list[Conflict](), footprint()
        for other in others:
            its = other.doing.footprint if other.doing else None
            if its is not None and (why := interference(mine, its)):
                found.append(Conflict(other.id, other.name, its, why, other.wanted.priority < self._task.wanted.priority))
        return tuple(found)

    def newcomers(self, footprint: Callable[[], ReadWriteSets], /) -> tuple[Conflict, ...]:
        """Return those of the conflicts in which it is not said already who makes way."""
        settled = self._task.preempted_by | {one.id for one in self._others if self._task.id in one.preempted_by}
        return tuple(one for one in self.conflicts(footprint) if one.task not in settled)

    def begun(self) -> tuple[Begun, ...]:
        """Return what others have begun and not brought to its end, those that are being paused or cancelled among them."""
        found: list[Begun] = []
        for other in self._tasks.values():
            run = other.doing.run if other is not self._task and other.doing else None
            if run is not None and (calls := (*run.open_calls.values(), *run.settling)):
                found.append(Begun(other.id, other.name, calls, other.is_active and other.wanted.priority < self._task.wanted.priority))
        return tuple(found)

    async def preempt(self, conflicts: tuple[Conflict, ...], /) -> None:
        """Have those that yield pause until this task is over; return when nothing of theirs is under way."""
        yielding = {one.task for one in conflicts if one.yields}
        await asyncio.gather(*(self._precedence.make_way(one, self._task) for one in self._others if one.id in yielding))

    async def turn(self) -> None:
        """Wait for one's turn to look for a plan; who has looked in vain, until something has changed."""
        await self._turnstile.enter(self._task)

    def leave(self, *, in_vain: bool) -> None:
        """Note that the search is over; once it is, no more is noted."""
        self._turnstile.leave(self._task, in_vain=in_vain)

    @property
    def _others(self) -> list[Task]:
        return [one for one in self._tasks.values() if one is not self._task and one.is_active]
