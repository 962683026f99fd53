"""Notices that something has not been heard of for too long."""

from __future__ import annotations

import asyncio
from collections.abc import Callable


class Silence:
    """Calls a function once nothing was heard for so many seconds, and again after every later silence.

    The mutable state is when something was heard last, and the one timer.

    Args:
        limit: seconds on the clock of the event loop; None for ever.
        fallen: what is called.
    """

    def __init__(self, limit: float | None, fallen: Callable[[], object]) -> None:
        self._loop = asyncio.get_running_loop()
        self._limit = limit
        self._fallen = fallen
        self._timer: asyncio.TimerHandle | None = None
        self.heard()

    def heard(self) -> None:
        """Note that something was heard, and begin to wait for more."""
        if self._limit is not None:
            self._until = self._loop.time() + self._limit
            self._timer = self._timer or self._loop.call_at(self._until, self._look)

    def close(self) -> None:
        """Wait no longer."""
        self._limit = None
        if self._timer is not None:
            self._timer.cancel()

    def _look(self) -> None:
        if self._loop.time() < self._until:  # one timer a silence, not one a message
            self._timer = self._loop.call_at(self._until, self._look)
        else:
            self._timer = None
            self._fallen()
