"""State of a run besides its marking: the time, stop and pause, timers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from heapq import heappop, heappush
from math import inf

from pnm.core.execution.call_results import CallResults
from pnm.core.execution.events import Pause, Resume, SingleStep, Stop
from pnm.core.execution.handover import UnderWay
from pnm.core.execution.machine_index import MachineIndex
from pnm.core.machine.machine import OnFailure
from pnm.core.net.firing_engine import Engine
from pnm.errors import RunError


class Timers:
    """Times at which undecided places are asked again. The mutable state is the queue and, by place, the time set last."""

    def __init__(self) -> None:
        self._queue: list[tuple[float, int]] = []
        self._set: dict[int, float] = {}

    def set(self, place: int, time: float) -> None:
        """Set the time at which the place is asked again; earlier entries stay, for asking once too often does no harm."""
        if self._set.get(place) != time:
            self._set[place] = time
            heappush(self._queue, (time, place))

    @property
    def next(self) -> float:
        """The next of the times; infinite if there is none."""
        return self._queue[0][0] if self._queue else inf

    def due(self, now: float) -> Iterator[int]:
        """Yield, and forget, the places whose time has come."""
        while self._queue and self._queue[0][0] <= now:
            _, place = heappop(self._queue)
            self._set.pop(place, None)
            yield place


@dataclass
class RunState:
    """State of a run that guards read besides knowledge. The mutable state is what has a default."""

    engine: Engine
    index: MachineIndex
    results: CallResults
    origin: float | None = None
    """The time from which releases count."""
    has_begun: bool = False
    now: float = -inf
    stop: Stop | None = None
    """The request to stop, if there was one."""
    pause: Pause | None = None
    """The request to pause, until the run is resumed."""
    is_stepping: bool = False
    """Whether one call may send its request although the run is paused."""
    adopted: dict[int, UnderWay] = field(default_factory=dict)
    """Requests of another run that are still to be taken over, by call."""
    marked_at: dict[int, float] = field(default_factory=dict)
    """When places were marked last."""

    def begin(self) -> list[int]:
        """Begin the run; return the places that are marked at first, and at which something is decided."""
        if self.has_begun:
            raise RunError("the run has begun already")
        self.has_begun = True
        self.origin = self.now if self.origin is None else self.origin
        first = [place for place, tokens in enumerate(self.engine.tokens) if tokens and place not in self.index.records]
        self.marked_at.update(dict.fromkeys(first, self.now))
        return first

    def follow(self, asked: Stop | Pause | Resume | SingleStep) -> None:
        """Stop, pause or go on: a stop, and a pause, may become stricter, but never milder."""
        match asked:
            case Stop():
                self.stop = asked if self.stop is None or asked.cancel else self.stop
            case Pause(at_once):
                self.pause = Pause(at_once or self.suspends)
            case Resume():
                self.pause = None
            case SingleStep() if self.pause is not None:
                self.pause, self.is_stepping = Pause(), True
            case SingleStep():
                pass

    @property
    def passed(self) -> float:
        """The seconds since the plan's start."""
        return self.now - (self.origin or 0.0)

    @property
    def over(self) -> bool:
        """Whether the goal place or the failed place is marked."""
        return bool(self.engine.tokens[self.index.goal] or self.engine.tokens[self.index.failed])

    @property
    def failing(self) -> bool:
        """Whether the run can no longer succeed."""
        return bool(self.results.failures) or self.stop is not None

    @property
    def ending(self) -> bool:
        """Whether nothing more is started."""
        if self.results.failures or self.stop is not None:
            return True
        return bool(self.index.restarts) and any(self.engine.tokens[place] for place in self.index.restarts)

    @property
    def cancels(self) -> bool:
        """Whether running calls shall be cancelled."""
        cancelled = self.stop is not None and self.stop.cancel
        return cancelled or (self.ending and self.index.on_failure is OnFailure.CANCEL)

    @property
    def suspends(self) -> bool:
        """Whether running calls shall be cancelled, to begin anew later."""
        return self.pause is not None and self.pause.at_once

    @property
    def idle(self) -> bool:
        """Whether no call is under way."""
        return not any(self.engine.tokens[place] for place in self.index.alive)
