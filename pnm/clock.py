"""Real, virtual and simulation time for asyncio.

Under virtual time a coroutine that sleeps for an hour returns at once: whenever nothing else
can happen, the clock jumps to the next timer. Work in a thread holds the clock still.

Time limits that stand still during pauses; cancellation in two steps; threads for long work; and short pauses for garbage collection:
what was allocated at start-up is frozen, and the threshold of generation 0 is raised.
"""

from __future__ import annotations

import asyncio
import gc
import selectors
import sys
from collections.abc import Awaitable, Callable, Coroutine, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from math import inf, isfinite, ulp
from time import monotonic
from typing import Any, Final, TypeVar, cast

from pnm.files.signals import StoppableWork

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class TimeUsed:
    """The used part of a limit."""

    limit: float
    """Its seconds."""
    used: float = 0.0
    """The seconds that were used when it last began to count, or stopped."""
    since: float | None = None
    """The time at which it last began to count, on the clock of the event loop; None while it does not."""

    def until(self, now: float) -> float:
        """Return the seconds that are used at a time."""
        return self.used + (0.0 if self.since is None else now - self.since)


class TimeLimit:
    """Time limit that stands still during pauses: calls `over` with its seconds once they are used up, on the clock of the event loop.

    Infinitely many are never used up. `note` is called with what is used whenever it begins to count, or stops: another process can go
    on with it. The mutable state is what the constructor sets under "state".
    """

    def __init__(self, seconds: float, over: Callable[[float], None], note: Callable[[TimeUsed], None] = lambda _: None) -> None:
        self._over = over
        self.note = note
        # state
        self._time = TimeUsed(seconds)
        self._has_begun = False
        self._is_paused = False
        self._timer: asyncio.TimerHandle | None = None
        self.is_used_up = False
        """Whether the function was called."""

    def continue_from(self, left: TimeUsed, at: float) -> None:
        """Begin later with what another process had used when it died, at that time."""
        self._time = TimeUsed(max(self._time.limit, left.limit), left.until(at))

    def begin(self) -> None:
        """Start the clock, now or at the end of a pause."""
        self._has_begun = True
        self._count()

    def pause(self) -> None:
        """Stop the clock for a pause."""
        self._stop()
        self._is_paused = True

    def go_on(self) -> None:
        """Start the clock again after a pause."""
        self._is_paused = False
        self._count()

    def close(self) -> None:
        """Stop the clock for good, and forget whom it has told."""
        self.note, self._over = lambda _: None, lambda _: None
        self._stop()
        self._has_begun = False

    @property
    def left(self) -> float:
        """The seconds left."""
        return max(0.0, self._time.limit - self._time.until(asyncio.get_running_loop().time()))

    def allow(self, seconds: float) -> None:
        """Extend the limit to a total of `seconds`; it is never shortened."""
        self._stop()
        self._time = replace(self._time, limit=max(self._time.limit, seconds))
        self._count()

    def _count(self) -> None:
        def end() -> None:
            self.is_used_up = True
            self._over(self._time.limit)

        if self._time.since is None and self._has_begun and not (self._is_paused or self.is_used_up):
            loop = asyncio.get_running_loop()
            self._time = replace(self._time, since=loop.time())
            self.note(self._time)
            if isfinite(self._time.limit):
                self._timer = loop.call_later(self.left, end)

    def _stop(self) -> None:
        if self._time.since is not None:
            self._time = TimeUsed(self._time.limit, self._time.until(asyncio.get_running_loop().time()))
            self.note(self._time)
        if self._timer:
            self._timer.cancel()
            self._timer = None


async def stop_then_cancel(work: Awaitable[T], stop: Callable[[], object]) -> T:
    """Await work that can be ended in order, in a task of its own, and return its result.

    Cancelling the caller once calls `stop`, which asks the work to come to its end, and goes on waiting for that; cancelling
    it again cancels the work.
    """
    task = asyncio.ensure_future(work)
    try:
        await asyncio.wait((task,))
    except asyncio.CancelledError:
        cast("asyncio.Task[object]", asyncio.current_task()).uncancel()
        stop()
    return await task


async def in_own_thread(function: Callable[[], T]) -> T:
    """Run a function that may take long in a thread of its own. The few threads that all share stay free for what is short."""
    thread = ThreadPoolExecutor(1)
    try:
        return await asyncio.get_running_loop().run_in_executor(thread, function)
    finally:
        thread.shutdown(wait=False)


_SELDOM: Final = 100_000
"""New objects after which garbage is looked for among them whatever goes on, in place of 700."""
_DUE: Final = 20_000
"""The same at moments in which nothing else is at hand."""


_SOON: Final = 0.0005
"""Seconds after which a thread that works gives way to one that waits, in place of 0.005."""


@contextmanager
def short_pauses() -> Iterator[None]:
    """Keep pauses short: robots wait.

    Garbage: freeze what is loaded, and collect seldom. Machines are thousands of objects, none of them garbage. Threads: what has happened
    is handled at once while another one thinks.
    """
    usual, switches = gc.get_threshold(), sys.getswitchinterval()
    sys.setswitchinterval(_SOON)
    gc.collect()
    gc.freeze()
    gc.set_threshold(_SELDOM, *usual[1:])
    try:
        yield
    finally:
        gc.set_threshold(*usual)
        gc.unfreeze()
        sys.setswitchinterval(switches)


def collect_if_due() -> None:
    """Collect the garbage that would be looked for before long, unless none is to be: for moments in which nothing else is at hand.

    So it seldom falls into those that robots wait for, such as when a failure is followed by a new plan and its machine.
    """
    (new, *counts), (_, *limits) = gc.get_count(), gc.get_threshold()
    if new > _DUE and gc.isenabled():
        gc.collect(max((age for age, (count, limit) in enumerate(zip(counts, limits, strict=True), 1) if count > limit), default=0))


_TOGETHER: Final = 1e-9
"""Seconds that virtual time does not tell apart: sums of the same durations differ by how they were rounded."""


class _PunctualLoop(asyncio.SelectorEventLoop):
    """An event loop in which no timer goes off before its time, to the last bit of a float.

    asyncio takes those of the next nanosecond for due. What looks at the clock then, and waits on, would do so for ever where a clock
    stands still.
    """

    _clock_resolution: float

    def _shown(self, now: float) -> float:
        """Return the time that is shown; the next one that a float can tell apart from it is not due yet."""
        self._clock_resolution = ulp(now)
        return now


class _Jumping(selectors.DefaultSelector):
    """Waits for file descriptors, but jumps ahead to the next timer in place of waiting for it."""

    def __init__(self, next_timer: Callable[[], float]) -> None:
        super().__init__()
        self._next_timer = next_timer
        self.now = 0.0
        self.held = 0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        if timeout is None or self.held:
            return super().select(None if timeout is None or timeout > 0 else timeout)
        ready = super().select(0)
        if not ready and timeout > 0:
            self.now = self._next_timer()  # not by the timeout: asyncio waits for a day at most, and sums are rounded
        return ready


class VirtualTimeLoop(_PunctualLoop):
    """An event loop whose clock starts at zero and jumps."""

    _scheduled: list[asyncio.TimerHandle]

    def __init__(self) -> None:
        self._jumping = _Jumping(self.next_timer)
        super().__init__(self._jumping)

    def continue_from(self, time: float) -> None:
        """Go on from a time, at which another process was."""
        self._jumping.now = time

    def time(self) -> float:
        """Return the virtual time in seconds."""
        return self._shown(self._jumping.now)

    def next_timer(self) -> float:
        """Return the time to which the clock jumps: of the next timer, or of the last one that goes off together with it."""
        return self._latest(0, self._scheduled[0].when() + _TOGETHER)

    def _latest(self, index: int, bound: float) -> float:
        """Return the latest time until `bound` in a part of asyncio's heap of timers; 0 if there is none."""
        if index >= len(self._scheduled) or (when := self._scheduled[index].when()) > bound:
            return 0.0
        return max(when, self._latest(2 * index + 1, bound), self._latest(2 * index + 2, bound))

    def run_in_executor(self, executor: Executor | None, func: Callable[..., T], *args: Any) -> asyncio.Future[T]:  # type: ignore[override]
        """Run the function in a thread; the clock stands still until it is done."""

        def release(_: asyncio.Future[Any]) -> None:
            self._jumping.held -= 1

        self._jumping.held += 1
        future = super().run_in_executor(executor, func, *args)
        future.add_done_callback(release)
        return future


_STANDSTILL: Final = 0.5
"""Seconds by which waiting takes too long when the process was stopped, or got no processor."""


class _Waiting(selectors.DefaultSelector):
    """Waits for file descriptors, and tells how long it has stood still meanwhile. The mutable state is whether it just did."""

    def __init__(self, stood_still: Callable[[float], None], clock: Callable[[], float]) -> None:
        super().__init__()
        self._stood_still = stood_still
        self._clock = clock
        self._has_stood_still = False

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        began = self._clock()
        ready = super().select(timeout)
        took, limit = self._clock() - began, max(0.0, timeout or 0.0)
        stood_still, self._has_stood_still = self._has_stood_still, timeout is not None and took - limit > _STANDSTILL
        if self._has_stood_still:  # as if it had not waited, so that there is time to hear; only once in a row, or it would never go on
            self._stood_still(took - limit if stood_still else took)
        return ready


class FollowingLoop(_PunctualLoop):
    """An event loop on real time that may follow another clock, such as that of a simulation.

    What moves that clock calls something on the loop, so that it looks at its timers. Its time never goes back, and goes on at once
    after a clock that is followed was set back. It does not go on while the process is stopped: what has been reported meanwhile is
    heard before the limits for it are over.

    The mutable state is the clock that it follows, what that has shown last, and how much later it is here.
    """

    def __init__(self, real: Callable[[], float] = monotonic) -> None:
        def stand_still(seconds: float) -> None:
            if not self.is_following:  # a clock that is followed may have gone on meanwhile, or not
                self._offset -= seconds

        self._real = self._clock = real
        self._seen = real()
        self._offset = 0.0
        self._latest = -inf
        super().__init__(_Waiting(stand_still, real))

    def continue_from(self, time: float) -> None:
        """Go on from a time, at which another process was: what it had still to wait for is waited for here."""
        self._seen = self._clock()
        self._offset, self._latest = time - self._seen, time

    @property
    def is_following(self) -> bool:
        """Whether it follows another clock than real time."""
        return self._clock is not self._real

    def follow(self, clock: Callable[[], float] | None) -> None:
        """Go on from now with the pace of a clock; with real time if it is None."""
        now = self.time()
        self._clock = clock or self._real
        self.continue_from(now)

    def time(self) -> float:
        """Return the time in seconds."""
        seen = self._clock()
        if seen < self._seen:  # set back: what it shows from now on is later here than what it has shown
            self._offset += self._seen - seen
        self._seen = seen
        self._latest = max(self._latest, self._offset + seen)  # sums are rounded
        return self._shown(self._latest)


def follow_real_time() -> None:
    """Have the running event loop follow no clock but real time from now on: what ends waits for no simulation, which may be gone."""
    loop = asyncio.get_running_loop()
    if isinstance(loop, FollowingLoop):
        loop.follow(None)


def is_virtual() -> bool:
    """Return whether the running event loop jumps: its time stands still while this process works."""
    return isinstance(asyncio.get_running_loop(), VirtualTimeLoop)


def continue_from(time: float) -> None:
    """Have the running event loop go on from a time, at which another process was; only if it is one of `run_async`."""
    loop = asyncio.get_running_loop()
    if isinstance(loop, VirtualTimeLoop | FollowingLoop):
        loop.continue_from(time)


def run_async(main: Coroutine[Any, Any, T], *, virtual: bool = False) -> T:
    """Run a coroutine to its end under virtual time, or under real time, in which robots wait: pauses are short then.

    Real time may become that of another clock, see `FollowingLoop`.

    Signals that would end the process cancel the coroutine, whose time is real from then on; a second one ends the process. See
    `StoppableWork`. `KeyboardInterrupt` is raised if the coroutine ends without a result.
    """
    with nullcontext() if virtual else short_pauses(), asyncio.Runner(loop_factory=VirtualTimeLoop if virtual else FollowingLoop) as runner:
        work = StoppableWork(runner.get_loop(), follow_real_time)
        with work.handled():
            try:
                return runner.run(work.run(main))
            except asyncio.CancelledError as error:
                raise KeyboardInterrupt from error
