"""Tells things soon, but none of them more often than so: what changes meanwhile is told in one go."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

K = TypeVar("K", bound=Hashable)


class Throttle(Generic[K]):
    """Calls a function for every key that was noted, the next time round the loop or when its last call is old enough.

    The mutable state is, by key, the timer of what is due and the time of the last call.

    Args:
        period: the seconds between two calls for the same key.
        tell: called with the key.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, period: float, tell: Callable[[K], None]) -> None:
        self._loop = loop
        self._period = period
        self._tell = tell
        self._due: dict[K, asyncio.TimerHandle] = {}
        self._told: dict[K, float] = {}

    def __repr__(self) -> str:
        return f"<Throttle {len(self._due)} due>"

    def note(self, key: K) -> None:
        """Have it told, unless that is due already."""
        if key not in self._due:
            at = self._told[key] + self._period if key in self._told else self._loop.time()
            self._due[key] = self._loop.call_at(at, self.at_once, key)

    def at_once(self, key: K) -> None:
        """Tell it now, whenever it was told last; what was due is told with it."""
        if key in self._due:
            self._due.pop(key).cancel()
        self._told[key] = self._loop.time()
        self._tell(key)

    def forget(self, key: K) -> None:
        """Tell nothing more of it, and do not remember it."""
        self._told.pop(key, None)
        if key in self._due:
            self._due.pop(key).cancel()

    def close(self) -> None:
        """Tell nothing more."""
        for key in (*self._due, *self._told):
            self.forget(key)
