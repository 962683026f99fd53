"""Rate limit: a call per key and period, at once after a pause; calls in between are merged into one."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

K = TypeVar("K", bound=Hashable)


class Throttle(Generic[K]):
    """Calls a function for every key that was noted: in the next turn of the loop, or a period (seconds) after its last call.

    The mutable state is, by key, the timer of the call that is due and the time of the last call.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, period: float, function: Callable[[K], None]) -> None:
        self._loop = loop
        self._period = period
        self._function = function
        self._due: dict[K, asyncio.TimerHandle] = {}
        self._called: dict[K, float] = {}

    def __repr__(self) -> str:
        return f"<Throttle {len(self._due)} due>"

    def note(self, key: K) -> None:
        """Make a call due, unless there is one."""
        if key not in self._due:
            at = self._called[key] + self._period if key in self._called else self._loop.time()
            self._due[key] = self._loop.call_at(at, self.at_once, key)

    def at_once(self, key: K) -> None:
        """Call now, however long the last call is ago, instead of a call that is due."""
        if key in self._due:
            self._due.pop(key).cancel()
        self._called[key] = self._loop.time()
        self._function(key)

    def forget(self, key: K) -> None:
        """Drop the call that is due for a key, and the time of its last call."""
        self._called.pop(key, None)
        if key in self._due:
            self._due.pop(key).cancel()

    def close(self) -> None:
        """Drop all calls that are due."""
        for key in (*self._due, *self._called):
            self.forget(key)
