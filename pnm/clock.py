"""Real and virtual time for asyncio.

Under virtual time a coroutine that sleeps for an hour returns at once: whenever nothing else
can happen, the clock jumps to the next timer. Work in a thread holds the clock still.
"""

from __future__ import annotations

import asyncio
import selectors
from collections.abc import Callable, Coroutine
from concurrent.futures import Executor
from contextlib import nullcontext
from typing import Any, TypeVar

from pnm.pauses import short_pauses

T = TypeVar("T")


class _Jumping(selectors.DefaultSelector):
    """Waits for file descriptors, but jumps ahead in place of waiting for a timer."""

    def __init__(self) -> None:
        super().__init__()
        self.now = 0.0
        self.held = 0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        if timeout is None or self.held:
            return super().select(None if timeout is None or timeout > 0 else timeout)
        ready = super().select(0)
        if not ready and timeout > 0:
            self.now += timeout
        return ready


class VirtualTimeLoop(asyncio.SelectorEventLoop):
    """An event loop whose clock starts at zero and jumps."""

    def __init__(self) -> None:
        self._jumping = _Jumping()
        super().__init__(self._jumping)

    def time(self) -> float:
        """Return the virtual time in seconds."""
        return self._jumping.now

    def run_in_executor(self, executor: Executor | None, func: Callable[..., T], *args: Any) -> asyncio.Future[T]:  # type: ignore[override]
        """Run the function in a thread; the clock stands still until it is done."""
        self._jumping.held += 1
        future = super().run_in_executor(executor, func, *args)
        future.add_done_callback(self._release)
        return future

    def _release(self, _: asyncio.Future[Any]) -> None:
        self._jumping.held -= 1


def run_async(main: Coroutine[Any, Any, T], *, virtual: bool) -> T:
    """Run a coroutine to its end under virtual time, or under real time, in which robots wait: pauses are short then."""
    with nullcontext() if virtual else short_pauses(), asyncio.Runner(loop_factory=VirtualTimeLoop if virtual else None) as runner:
        return runner.run(main)
