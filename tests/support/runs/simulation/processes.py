"""Processes on one event loop under the virtual clock, which are killed, stopped and woken as an operating system does it.

Whatever a process schedules carries its name in its context: nothing of a dead process runs any more, and what a stopped one would
do waits until it is woken. A process may also die or be stopped in the midst of what it does.
"""

from __future__ import annotations

import asyncio
from asyncio import tasks
from collections.abc import Callable, Coroutine
from concurrent.futures import Executor
from contextvars import Context, ContextVar, copy_context
from functools import partial
from typing import Any, TypeVar

from pnm.clock import VirtualTimeLoop

T = TypeVar("T")
_CURRENT: ContextVar[Process | None] = ContextVar("process", default=None)


class Killed(BaseException):
    """Unwinds what a process was doing when it was killed; nothing comes of it any more."""


class Process:
    """A process. Its mutable state is all that it has.

    Args:
        loop: where it runs.
        name: for people.
        failed: is told of errors that nothing in the process has handled.
    """

    def __init__(self, loop: ProcessLoop, name: str, failed: Callable[[Exception], None]) -> None:
        self.loop = loop
        self.name = name
        self.failed = failed
        self.is_dead = False
        self.is_stopped = False
        self._is_in_call = False
        """Whether it was stopped in the midst of something, which goes on before anything else does: calls of others may lie above it."""
        self.over = asyncio.Event()
        """Set once it is dead, or its main coroutine has ended."""
        loop.processes.append(self)
        self._backlog: list[tuple[Callable[..., object], tuple[object, ...], Context]] = []
        self._context = copy_context()
        self._context.run(_CURRENT.set, self)

    def start(self, main: Coroutine[Any, Any, None]) -> None:
        """Begin the main coroutine of the process."""

        async def whole() -> None:
            try:
                await main
            except Killed:
                pass
            except Exception as error:
                self._fail(error)
            finally:
                self.over.set()

        self.loop.create_task(whole(), context=self._context)

    def do(self, callback: Callable[..., object], *args: object) -> None:
        """Have the process do something in the next turn of the loop, such as receive a message."""
        self.loop.call_soon(callback, *args, context=self._context)

    def kill(self) -> None:
        """Kill it: nothing that it has begun goes on."""
        self.is_dead = True
        self.over.set()

    def die(self) -> None:
        """Kill it in the midst of what it does."""
        self.kill()
        raise Killed

    def stop(self, seconds: float) -> None:
        """Stop it between two things that it does; it wakes after that time."""
        self.is_stopped = True
        self.loop.call_later(seconds, self._wake, context=Context())

    def sleep(self, seconds: float) -> None:
        """Stop it in the midst of what it does; all others go on meanwhile."""
        self._is_in_call = True
        self.stop(seconds)
        try:
            self.loop.run_others(lambda: not self.is_stopped)
        finally:
            self._is_in_call = False
        self.flush()

    def run(self, context: Context, callback: Callable[..., object], *args: object) -> None:
        """Call what the process has scheduled, unless it cannot run."""
        if (self.is_stopped or self._is_in_call or self.is_dead) and not self.loop.is_ending:
            self._backlog.append((callback, args, context))
            return
        try:
            callback(*args)
        except Killed:
            pass
        except Exception as error:
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        if not self.loop.is_ending:
            self.failed(error)

    def _wake(self) -> None:
        self.is_stopped = False
        if not (self.is_dead or self._is_in_call):
            self.flush()

    def flush(self) -> None:
        """Do what has waited."""
        waiting, self._backlog = self._backlog, []
        for callback, args, context in waiting:
            self.loop.call_soon(callback, *args, context=context)


class ProcessLoop(VirtualTimeLoop):
    """An event loop with processes. The mutable state is these, and whether it is ending: then the dead unwind what they were doing."""

    def __init__(self) -> None:
        super().__init__()
        self.processes: list[Process] = []
        self.is_ending = False

    def call_soon(self, callback: Callable[..., object], *args: Any, context: Context | None = None) -> asyncio.Handle:
        """Schedule a call, in the name of the process whose context it is."""
        context, guarded = self._guarded(callback, context)
        return super().call_soon(guarded, *args, context=context)

    def call_at(self, when: float, callback: Callable[..., object], *args: Any, context: Context | None = None) -> asyncio.TimerHandle:
        """Schedule a call at a time, in the name of the process whose context it is."""
        context, guarded = self._guarded(callback, context)
        return super().call_at(when, guarded, *args, context=context)

    def _guarded(self, callback: Callable[..., object], context: Context | None) -> tuple[Context, Callable[..., object]]:
        context = copy_context() if context is None else context
        process = context.get(_CURRENT)
        return context, callback if process is None else partial(process.run, context, callback)

    def run_in_executor(self, executor: Executor | None, func: Callable[..., T], *args: Any) -> asyncio.Future[T]:  # type: ignore[override]
        """Run the function in a thread, which holds the clock until it is done, even if its process is killed."""
        return Context().run(super().run_in_executor, executor, func, *args)

    def run_others(self, until: Callable[[], bool]) -> None:
        """Go on with everything else in the midst of a callback."""
        current, left = asyncio.current_task(self), len(self._ready)  # type: ignore[attr-defined]
        if current is not None:
            tasks._leave_task(self, current)  # type: ignore[attr-defined]
        try:
            while not until():
                if self._stopping:  # type: ignore[attr-defined]
                    raise Killed  # everything is over
                self._run_once()  # type: ignore[attr-defined]
        finally:
            if current is not None:
                tasks._enter_task(self, current)  # type: ignore[attr-defined]
            # The turn of the loop that this is part of goes on with as many callbacks as were ready at its beginning.
            for _ in range(left - len(self._ready)):  # type: ignore[attr-defined]
                super().call_soon(lambda: None)


def run_processes(main: Callable[[ProcessLoop], Coroutine[Any, Any, T]]) -> T:
    """Run a coroutine that starts processes, on a loop of its own, and return its result."""
    loop = ProcessLoop()
    loop.set_exception_handler(lambda _, context: None)  # of those that unwind what they were doing
    try:
        return loop.run_until_complete(main(loop))
    finally:
        loop.is_ending = True
        for process in loop.processes:
            process.flush()
        while left := asyncio.all_tasks(loop):  # some end in order when they are cancelled once
            for task in left:
                task.cancel()
            loop.run_until_complete(asyncio.sleep(0))
        loop.close()
