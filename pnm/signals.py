"""Signals that end a process: they cancel its work, which comes to its end in order."""

from __future__ import annotations

import asyncio
import signal
import threading
from collections.abc import Coroutine, Iterator
from contextlib import contextmanager
from math import inf
from time import monotonic
from typing import Any, Final, TypeVar

T = TypeVar("T")

_ENDING: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
"""Signals that end a process unless it handles them: Ctrl-C, `kill` and supervisors, a terminal that is closed, Ctrl-\\."""
_ONE_REQUEST: Final = 1.0
"""Seconds in which signals count as one: some supervisors send theirs to a process and to its group as well."""


class StoppableWork:
    """Work that signals cancel in place of killing the process, which could not cancel then what its robots do.

    The first signal cancels the work, which then comes to its end in order; the next one cancels it again. A signal during which the
    loop is too busy to hear even of the one before raises `KeyboardInterrupt`. Signals that the caller ignores or handles are left alone.

    Args:
        loop: runs the work.

    The mutable state is the task of the work, and when the last signal came, and whether the loop has yet to hear of it.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
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
        if self._is_pending:
            raise KeyboardInterrupt
        self._is_pending = True
        self._loop.call_soon_threadsafe(self._cancel)

    def _cancel(self) -> None:
        self._is_pending = False
        if self._task is not None:
            self._task.cancel()
