"""The tasks beside one, as its pursuit sees them."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from uuid import UUID

from planner_bridge.circumstances import Begun, Conflict, Neighbours
from planner_bridge.footprints import Footprint, conflict
from planner_bridge.precedence import Precedence
from planner_bridge.task import Task
from planner_bridge.turnstile import Turnstile


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

    def conflicts(self, footprint: Callable[[], Footprint], /) -> tuple[Conflict, ...]:
        """Return the tasks that are active and beside which a plan with this footprint cannot be carried out."""
        others = self._others
        if not others:
            return ()
        found, mine = list[Conflict](), footprint()
        for other in others:
            its = other.doing.footprint if other.doing else None
            if its is not None and (why := conflict(mine, its)):
                found.append(Conflict(other.id, other.name, its, why, other.wanted.priority < self._task.wanted.priority))
        return tuple(found)

    def newcomers(self, footprint: Callable[[], Footprint], /) -> tuple[Conflict, ...]:
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
