"""A time that may be used up, but for pauses."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from math import isfinite


class TimeLimit:
    """Calls a function once so many seconds have been used up, on the clock of the event loop.

    Args:
        seconds: how many; infinitely many are never used up.
        over: what is called then, with that number.

    The mutable state is what the constructor sets under "state".
    """

    def __init__(self, seconds: float, over: Callable[[float], None]) -> None:
        self._over = over
        # state
        self._seconds = seconds
        self._used = 0.0
        """Until the time began to count last."""
        self._since: float | None = None
        """When that was, while it counts."""
        self._has_begun = False
        self._is_paused = False
        self._timer: asyncio.TimerHandle | None = None
        self.is_used_up = False
        """Whether the function was called."""

    def begin(self) -> None:
        """Have time count from now on, or from the end of the pause."""
        self._has_begun = True
        self._count()

    def pause(self) -> None:
        """Have time not count."""
        self._stop()
        self._is_paused = True

    def go_on(self) -> None:
        """Have time count again after a pause."""
        self._is_paused = False
        self._count()

    def close(self) -> None:
        """Call nobody any more."""
        self._stop()
        self._has_begun = False

    @property
    def left(self) -> float:
        """How many seconds are left."""
        passing = 0.0 if self._since is None else asyncio.get_running_loop().time() - self._since
        return max(0.0, self._seconds - self._used - passing)

    def allow(self, seconds: float) -> None:
        """Have it be so many seconds in all, or as many as were said before if those are more."""
        self._stop()
        self._seconds = max(self._seconds, seconds)
        self._count()

    def _count(self) -> None:
        if self._since is None and self._has_begun and not (self._is_paused or self.is_used_up):
            loop = asyncio.get_running_loop()
            self._since = loop.time()
            if isfinite(self._seconds):
                self._timer = loop.call_later(self.left, self._end)

    def _end(self) -> None:
        self.is_used_up = True
        self._over(self._seconds)

    def _stop(self) -> None:
        if self._since is not None:
            self._used += asyncio.get_running_loop().time() - self._since
            self._since = None
        if self._timer:
            self._timer.cancel()
            self._timer = None
