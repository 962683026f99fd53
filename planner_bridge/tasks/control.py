"""How a task stands: what it is doing, and whether it has been told to pause or to stop."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable
from contextlib import suppress
from typing import Final

from planner_bridge.tasks.settings import TaskObserver
from pnm.executor import Executor
from pnm.tasks import Code, TaskState

_ALWAYS_SHOWN: Final = frozenset({TaskState.PAUSING, TaskState.PAUSED, TaskState.CANCELLING, TaskState.OVER})


class Over(Exception):
    """The task has come to its end."""

    def __init__(self, code: Code, reason: str) -> None:
        super().__init__(reason)
        self.code = code
        self.reason = reason


class Standing:
    """What whoever does a task has been told, and what others are told of it. Everything in it is mutable state.

    Args:
        observer: is told in which state the task is.
        first: what it does first.
    """

    def __init__(self, observer: TaskObserver, first: TaskState = TaskState.PLANNING) -> None:
        self._observer = observer
        self._shown = TaskState.QUEUED, ""
        self._doing = first, ""
        """What it does, or will do after a pause."""
        self.stopped: Over | None = None
        """Why the task is over before its goal is reached."""
        self._is_over = asyncio.Event()
        self._may_go = asyncio.Event()
        self._may_go.set()

    @property
    def is_paused(self) -> bool:
        """Whether it was told to pause."""
        return not self._may_go.is_set()

    def stop(self, over: Over) -> bool:
        """Note why the task is to end; tell whether that is news. What cannot be made good comes before what was said first."""
        is_worse = over.code is Code.CONSTRAINT_VIOLATED
        if self.stopped and not (is_worse and self.stopped.code is not over.code):
            return False
        self.stopped = over
        self._is_over.set()
        self._may_go.set()
        return True

    async def pause(self, reason: str, executor: Executor | None, *, at_once: bool) -> None:
        """Be paused from now on, unless the task is to end; return when nothing is under way, or it is not paused any more.

        Args:
            reason: why.
            executor: what carries out the plan, if there is one.
            at_once: cancel what is under way, to begin it anew later.
        """
        if self.stopped:
            return
        self._may_go.clear()
        self.enter(TaskState.PAUSING, reason)
        if executor:
            executor.pause(at_once=at_once)
            while self.is_paused and not (executor.paused or executor.ended):
                await executor.happens()
        if self.is_paused:
            self.enter(TaskState.PAUSED, reason)

    def go_on(self) -> None:
        """Be paused no longer."""
        if self.is_paused:
            self._may_go.set()
            self._show(*self._doing)

    def enter(self, state: TaskState, why: str = "") -> None:
        """Be in another state from now on; a pause or an end that is coming hides what the task would be doing."""
        if state not in _ALWAYS_SHOWN:
            self._doing = state, why
            if self.is_paused or self.stopped:
                return
        self._show(state, why)

    def _show(self, state: TaskState, why: str) -> None:
        if (state, why) != self._shown:
            self._shown = state, why
            self._observer.entered(state, why)

    # --- waiting, which always ends when the task is to end ---------------------------------------

    async def may_go(self) -> None:
        """Wait until the task is not paused.

        Raises:
            Over: nobody wants it any more.
        """
        await self._may_go.wait()
        self.check()

    async def until(self, happens: Awaitable[object]) -> None:
        """Wait for something.

        Raises:
            Over: nobody wants it any more.
        """
        waiting = asyncio.ensure_future(happens), asyncio.ensure_future(self._is_over.wait())
        try:
            await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for one in waiting:
                one.cancel()
        self.check()
        await waiting[0]  # raises what has gone wrong

    async def wait(self, seconds: float) -> None:
        """Wait so many seconds, or until nobody wants the task any more."""
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                await self._is_over.wait()

    def check(self) -> None:
        """Raise `Over` if nobody wants the task any more."""
        if self.stopped:
            raise self.stopped
