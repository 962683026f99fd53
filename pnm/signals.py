"""Signals that end a process: the first cancels its work, which comes to its end in order; the second has it leave in any case."""

from __future__ import annotations

import asyncio
import os
import signal
import threading
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager
from math import inf
from time import monotonic
from typing import Any, Final, TypeVar

T = TypeVar("T")

_ENDING: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
"""Signals that end a process unless it handles them: Ctrl-C, `kill` and supervisors, a terminal that is closed, Ctrl-\\."""
_ONE_REQUEST: Final = 1.0
"""Seconds in which signals count as one: some supervisors send theirs to a process and to its group as well."""
LEAVING: Final = 2.0
"""Seconds of real time that a process has to leave in order after a second signal; then it leaves at once."""
_SPEAKING: Final = 0.5
"""Seconds for its last words."""
CANCELLED: Final = 1
"""The exit status of a process that leaves at once."""


class LastWords:
    """Says what is said last by a process that leaves at once. The mutable state is that; it is set by the program that it is."""

    def __init__(self) -> None:
        self.say: Callable[[], object] = lambda: None


LAST_WORDS: Final = LastWords()


class StoppableWork:
    """Work that signals cancel in place of killing the process, which could not cancel then what its robots do.

    The first signal cancels the work, which then comes to its end in order; the next one cancels it again, and the process leaves
    within `LEAVING` seconds, whatever still goes on. A signal during which the loop is too busy to hear even of the one before raises
    `KeyboardInterrupt`. Signals that the caller ignores or handles are left alone.

    Args:
        loop: runs the work.
        cancelled: called on it whenever the work is cancelled, before that.

    The mutable state is the task of the work, and when the last signal came, and whether the loop has yet to hear of it.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, cancelled: Callable[[], object]) -> None:
        self._loop = loop
        self._cancelled = cancelled
        self._task: asyncio.Task[Any] | None = None
        self._last = -inf
        self._is_pending = False

    async def run(self, main: Coroutine[Any, Any, T]) -> T:
        """Await the coroutine that is the work, and return its result."""
        self._task = asyncio.current_task()
        return await main

    @contextmanager
    def handled(self) -> Iterator[None]:
        """Handle the signals; only the main thread can."""
        is_main = threading.current_thread() is threading.main_thread()
        usual = {number: signal.getsignal(number) for number in _ENDING if is_main}
        ours = [number for number, handler in usual.items() if handler in (signal.SIG_DFL, signal.default_int_handler)]
        try:
            for number in ours:
                signal.signal(number, self._receive)
            yield
        finally:
            for number in ours:
                signal.signal(number, usual[number])

    def _receive(self, number: int, frame: object) -> None:
        before, self._last = self._last, monotonic()
        if self._last - before < _ONE_REQUEST:
            return
        if before > -inf:
            leave_within(LEAVING)
        if self._is_pending:
            raise KeyboardInterrupt
        self._is_pending = True
        self._loop.call_soon_threadsafe(self._cancel)

    def _cancel(self) -> None:
        self._is_pending = False
        self._cancelled()
        if self._task is not None:
            self._task.cancel()


def leave_within(seconds: float) -> None:
    """Have the process leave at once when it has not ended after these seconds: by a thread, since its own work may be what hangs."""
    timer = threading.Timer(seconds, leave)
    timer.daemon = True
    timer.start()


def leave(status: int = CANCELLED) -> None:
    """End the process at once. Nothing is closed: what is kept, such as a journal, is as after a crash."""
    words = threading.Thread(target=LAST_WORDS.say, daemon=True)
    words.start()
    words.join(_SPEAKING)  # who should read them may have stopped reading
    os._exit(status)
