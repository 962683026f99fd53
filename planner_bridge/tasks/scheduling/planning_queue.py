"""The queue of tasks that want to plan: one plans after the other, and again after a change if it failed.

A task in the queue keeps nothing from others, and has nothing under way. So tasks in the queue never wait for each other: each waits
for one outside, and whatever ends that one's hold on things, its return to the queue included, is a change. After a change every task
of the queue has its turn, however many before it have failed: the one behind them may be the one for which they all wait.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Final, Generic, TypeVar

SLOW: Final = 1.0
"""Seconds after which the next task may plan beside one that is still planning."""

T = TypeVar("T")


class PlanningQueue(Generic[T]):
    """The tasks that want to plan, and those whose attempt failed, which wait for a change.

    The mutable state is both; the tasks that are planning, and which of them are slow or have been outdated by a change; and which of
    them were planning beside each attempt that failed.

    Args:
        rank: the task of the lowest rank plans first.
    """

    def __init__(self, rank: Callable[[T], tuple[int, int]]) -> None:
        self._rank = rank
        self._waiting: dict[T, asyncio.Future[None]] = {}
        self._waiting_for_change: set[T] = set()
        self._planning: dict[T, asyncio.TimerHandle] = {}
        self._slow: set[T] = set()
        self._outdated: set[T] = set()
        self._beside: dict[T, set[T]] = {}

    async def enter(self, task: T) -> None:
        """Wait for the turn of the task; one whose attempt failed waits for a change first."""
        turn: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._waiting[task] = turn
        # all tasks that come at this moment are in the queue before the first is admitted
        asyncio.get_running_loop().call_soon(self._admit)
        try:
            await turn
        finally:
            self._waiting.pop(task, None)

    def leave(self, task: T, *, failed: bool = False) -> None:
        """End the turn of the task, if it has the turn.

        If the world changed during the attempt, its failure does not count and the task may try again at once.
        """
        if task in self._planning:
            self._planning.pop(task).cancel()
            self._slow.discard(task)
            if failed and task not in self._outdated:
                self._waiting_for_change.add(task)
                self._beside[task] = {*self._planning}
            self._outdated.discard(task)
            # What this one had in mind may have been in the way of those that failed meanwhile, and is not any more.
            for other in [other for other, beside in self._beside.items() if task in beside]:
                self._waiting_for_change.discard(other)
                del self._beside[other]
            self._admit()

    def changed(self) -> None:
        """Let the tasks whose attempts failed try again."""
        self._waiting_for_change.clear()
        self._beside.clear()
        self._outdated = {*self._planning}  # they plan from a world that is no longer so; if they fail, that says nothing about the new one
        self._admit()

    def _admit(self) -> None:
        # One at a time, because each plan must respect those found before; a slow planner holds up the others only for a moment.
        if self._planning.keys() - self._slow:
            return
        ready = (task for task, turn in self._waiting.items() if task not in self._waiting_for_change and not turn.done())
        first = min(ready, key=self._rank, default=None)
        if first is not None:
            self._planning[first] = asyncio.get_running_loop().call_later(SLOW, self._admit_beside, first)
            self._waiting[first].set_result(None)

    def _admit_beside(self, slow: T) -> None:
        self._slow.add(slow)
        self._admit()
