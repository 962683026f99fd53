"""Preemption: a task is paused while one of higher priority, with which it is in conflict, goes on.

It goes on by itself as soon as none of those goes on (they are over, are paused by an operator, or only wait for answers) and nothing
of them is under way any more.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Mapping
from math import inf
from typing import Final
from uuid import UUID

from planner_bridge.ordering.forecast import Forecast
from planner_bridge.ordering.interference import ReadWriteSets, interference
from planner_bridge.tasks.context import Conflict, RunningCalls
from planner_bridge.tasks.scheduling.planning_queue import PlanningQueue
from planner_bridge.tasks.task import Task
from pnm.core.execution.run import Run
from pnm.core.resources import Resources
from pnm.tasks import TaskListener, TaskState, TraceKind

_SHORTEST: Final = 1.0
"""Seconds after which a task tries again at the earliest when others are expected to be out of its way."""


class Preemption(TaskListener):
    """Finds the tasks that are in conflict with each other, and pauses and resumes those of lower priority, as `Scheduler`.

    The mutable state is which tasks are being paused.

    Args:
        tasks: all that are not over.
        resources: what they share.
        queue: where they wait for their turn to plan.
    """

    def __init__(self, tasks: Mapping[UUID, Task], resources: Resources, queue: PlanningQueue[Task]) -> None:
        self._tasks = tasks
        self._resources = resources
        self._queue = queue
        self._pausing: dict[UUID, asyncio.Task[None]] = {}

    # --- conflicts ------------------------------------------------------------------------------

    def conflicts(self, task: Task, footprint: Callable[[], ReadWriteSets]) -> tuple[Conflict, ...]:
        """Return the tasks that conflict with a plan of the task, because they are active or their pause has yet to take effect.

        `footprint` is called only if there are any.
        """
        others = self._others(task)
        if not others:  # the footprint is computed only when needed: it walks through the whole plan
            return ()
        conflicts, needed = list[Conflict](), footprint()
        for other in others:
            its = other.control.footprint
            if its is not None and (why := interference(needed, its)):
                conflicts.append(Conflict(other.id, other.name, its, why, other.yields_to(task)))
        return tuple(conflicts)

    def new_conflicts(self, task: Task, footprint: Callable[[], ReadWriteSets]) -> tuple[Conflict, ...]:
        """Return the conflicts in which neither task has been preempted for the other yet."""
        # Between these the order is decided already; asking again would preempt them in a circle.
        settled = task.preempted_by | {other.id for other in self._others(task) if task.id in other.preempted_by}
        return tuple(conflict for conflict in self.conflicts(task, footprint) if conflict.task not in settled)

    def forecasts(self, task: Task) -> Mapping[Task, Forecast]:
        """Return what is expected of the plans of other active tasks that do not yield to this one."""
        ahead = [other for other in self._others(task) if not other.yields_to(task)]
        return {other: expected for other in ahead if (expected := other.control.forecast) is not None}

    def runs(self) -> tuple[Run, ...]:
        """Return the current runs of all tasks."""
        return tuple(run for task in self._tasks.values() if (run := task.control.run) is not None)

    def running_calls(self, task: Task) -> tuple[RunningCalls, ...]:
        """Return the calls of other tasks that have begun and not ended; tasks that are being paused or cancelled are among them."""
        running: list[RunningCalls] = []
        for other in self._tasks.values():
            run = other.control.run if other is not task else None
            if run is not None and (calls := run.unsettled):
                running.append(RunningCalls(other.id, other.name, calls, other.yields_to(task)))
        return tuple(running)

    def _others(self, task: Task) -> list[Task]:
        begun = (other for other in self._tasks.values() if other is not task and other.control.has_begun and other.ending is None)
        return [other for other in begun if other.control.state is not TaskState.PAUSED]

    def release(self, task: Task) -> None:
        """Note that the task has no plan in mind any more: those that waited for it may try again.

        Nothing else tells them where its run has ended without a change of facts, and it may wait for its next turn behind them.
        """
        if task.control.reserved is not None:
            task.control.reserved = None
            asyncio.get_running_loop().call_soon(self._queue.changed)  # when it is in the queue itself, which goes by rank

    async def begin_turn(self, task: Task) -> None:
        """Wait for the turn of the task to plan, with no plan in mind; one whose attempt failed waits for a change first."""
        self.release(task)
        await self._queue.enter(task)

    def end_turn(self, task: Task, *, failed: bool, again: float = inf) -> None:
        """End the turn of the task to plan. After so many seconds it may try again though nothing is known to have changed."""
        self._queue.leave(task, failed=failed)
        if again < inf:
            asyncio.get_running_loop().call_later(max(again, _SHORTEST), self._queue.changed)

    # --- preempting -----------------------------------------------------------------------------

    async def preempt(self, task: Task, conflicts: tuple[Conflict, ...]) -> None:
        """Have the tasks of lower priority pause until this task is over; return when nothing of theirs is under way."""
        yielding = {conflict.task for conflict in conflicts if conflict.yields}
        await asyncio.gather(*(self._pause_for(other, task) for other in self._others(task) if other.id in yielding))

    async def _pause_for(self, task: Task, other: Task) -> None:
        if task.control.state is TaskState.CANCELLING:  # it cannot be paused any more, but ends soon; waiting for that has the same effect
            await task.control.over.wait()
        self._set_preempted(task, other)
        if pausing := self._pausing.get(task.id):
            # Shielded: the other task may be cancelled while this one is being paused, which must be completed.
            await asyncio.shield(pausing)

    def preempt_holders(self) -> None:
        """Preempt the tasks that have what a claim of higher priority waits for."""
        # Only holders of something that this very claim needs: others of lower priority stay undisturbed.
        for higher, lower in dict.fromkeys((claim.task, held.task) for claim, held in self._resources.outranking()):
            if {higher, lower} <= self._tasks.keys():
                self._set_preempted(self._tasks[lower], self._tasks[higher])

    def _set_preempted(self, task: Task, other: Task) -> None:
        if other.id not in task.preempted_by and task.id in self._tasks:
            task.preempted_by.add(other.id)
            task.note(TraceKind.CONFLICT, "", f"makes way for {other.name}")
        self._update(task)

    def changed(self, task: UUID) -> None:
        """Decide again which tasks go on: this one may have ceased to, or have begun again."""
        self.update_all()

    def update_all(self) -> None:
        """Pause the tasks that are preempted, and resume those that are not any more; those that are served first come first."""
        for task in sorted(self._tasks.values(), key=lambda task: task.rank):
            if task.control.is_paused or any(self._opponents(task)):
                self._update(task)

    def _update(self, task: Task) -> None:
        # An operator's pause is stronger than preemption, and a task that is being cancelled is past both.
        if task.is_held or task.id not in self._tasks or task.control.state is TaskState.CANCELLING:
            return
        if not (why := self._why_paused(task)):
            task.control.resume()
        elif (task.is_active or task.control.reason != why) and task.id not in self._pausing:
            self._pausing[task.id] = asyncio.get_running_loop().create_task(self._pause(task))

    def _goes_on(self, task: Task) -> bool:
        """Return whether the task goes on, or is about to: it wants to, and makes way for none that does."""
        return task.wants_to_go_on and not any(map(self._goes_on, self._superiors(task)))

    def _why_paused(self, task: Task) -> str:
        """Return why the task is not to go on now; empty when it is.

        Of two opponents one goes on. The other one is at rest before: a robot that is still at work for one gets no command of the other.
        """
        if preempting := [other.name for other in self._superiors(task) if self._goes_on(other)]:
            return f"makes way for {', '.join(preempting)}"
        if not task.wants_to_go_on:
            ahead = [other.name for other in self._opponents(task) if self._goes_on(other)]
            return f"waits for an answer, and {', '.join(ahead)} goes on meanwhile" if ahead else ""
        opponents = self._opponents(task) if task.control.is_paused else ()
        working = [other.name for other in opponents if other.control.state is not TaskState.PAUSED]
        return f"waits until {', '.join(working)} has stopped" if working else ""

    def _superiors(self, task: Task) -> list[Task]:
        """Return the tasks of higher priority for which the task is preempted."""
        return sorted((self._tasks[other] for other in task.preempted_by if other in self._tasks), key=lambda other: other.rank)

    def _opponents(self, task: Task) -> Iterator[Task]:
        """Yield the tasks that do not go on together with this one: one of the two is preempted for the other."""
        yield from self._superiors(task)
        yield from (other for other in self._tasks.values() if task.id in other.preempted_by)

    async def _pause(self, task: Task) -> None:
        try:
            if (why := self._why_paused(task)) and not task.is_held:  # still
                self._queue.leave(task)
                await task.control.pause(why, at_once=any(map(self._goes_on, self._superiors(task))))
        finally:
            del self._pausing[task.id]
        self._queue.changed()  # what the paused task kept from others is free now, so those that failed may try again
        self.update_all()  # another task may have preempted it meanwhile, or have waited for it
