"""What happens by itself while a plan is carried out: processes and events, predicted on the clock of the event loop."""

from __future__ import annotations

import asyncio
from collections.abc import Collection
from typing import Final

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import Condition
from pnm.core.logic.expressions import Fluent
from pnm.core.nature import Nature

TICK: Final = 1.0
"""Seconds after which numbers that change by themselves are looked at again, if nothing has happened before."""


class Prediction:
    """What happens by itself, in a state that is kept up to date on the clock of the event loop.

    Reports correct it: what a sensor has just said is not predicted. What events change is assumed unless a sensor reports it; numbers that
    processes change are predicted between reports as well. The mutable state is the conditions that are watched, the time up to which it
    is right, and when it is looked at again.
    """

    def __init__(self, nature: Nature, state: KnowledgeBase, speed: float = 1.0) -> None:
        self._nature, self._state, self._speed = nature, state, speed
        self.watched: tuple[Condition, ...] = ()
        self._time = asyncio.get_running_loop().time()
        self._timer: asyncio.TimerHandle | asyncio.Handle | None = None
        self._is_own = False
        self._stop = state.listen(self._reported)
        self.look()

    def close(self) -> None:
        """Predict nothing more."""
        self._stop()
        if self._timer:
            self._timer.cancel()

    def look(self) -> None:
        """Bring the state up to date, and note when something happens next."""
        self.bring_up_to_date()
        turns = ((passed, changed) for passed, changed in self._nature.foresee(self._state, TICK, self.watched) if passed)
        passed, changed = next(turns)
        if self._timer:
            self._timer.cancel()
        later = passed / self._speed
        self._timer = asyncio.get_running_loop().call_later(later, self.look) if changed else None

    def bring_up_to_date(self, reported: Collection[Fluent] = ()) -> None:
        """Let the time pass that has passed since the last look."""
        now = asyncio.get_running_loop().time()
        passed, self._time = (now - self._time) * self._speed, now
        for _, changed in self._nature.foresee(self._state, passed):
            own = {
                fluent: value
                for fluent, value in changed.items()
                if fluent not in reported and (fluent[0] in self._nature.moved or not self._state.is_sensed(fluent))
            }
            self._is_own = True
            self._state.update(own)
            self._is_own = False

    def _reported(self, changes: Collection[Fluent]) -> None:
        if not self._is_own and changes:
            self.bring_up_to_date(changes)
            if self._timer:
                self._timer.cancel()
            self._timer = asyncio.get_running_loop().call_soon(self.look)
