"""Work that takes virtual time: what threads do, and what the backend is asked, so that things happen meanwhile."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

from planner_bridge.model.problem import Problem
from planner_bridge.model.world import robots_of
from pnm.actions.backend import SimulatedBackend
from pnm.actions.faults import Faults
from pnm.clock import VirtualTimeLoop
from pnm.core.machine.bindings import Bindings

T = TypeVar("T")


class SlowLoop(VirtualTimeLoop):
    """An event loop on which work in a thread takes some virtual time, after it has been done.

    Args:
        seconds: how long the next work takes.
    """

    def __init__(self, seconds: Callable[[], float]) -> None:
        super().__init__()
        self._seconds = seconds

    def run_in_executor(self, executor: Executor | None, func: Callable[..., T], *args: Any) -> asyncio.Future[T]:  # type: ignore[override]
        """Run the function in a thread, and deliver its result later."""
        late: asyncio.Future[T] = self.create_future()
        work = super().run_in_executor(executor, func, *args)
        work.add_done_callback(lambda _: self.call_later(self._seconds(), _deliver, work, late))
        return late


def _deliver(work: asyncio.Future[T], late: asyncio.Future[T]) -> None:
    error = work.exception()
    if late.done():  # nobody waits for it any more
        return
    if error is not None:
        late.set_exception(error)
    else:
        late.set_result(work.result())


class SlowBackend(SimulatedBackend):
    """Simulated robots that are slow, and whose world is not asked in no time."""

    def __init__(self, seconds: Callable[[], float], problem: Problem, bindings: Bindings, faults: Faults) -> None:
        robots = robots_of(problem, bindings, faults)
        super().__init__(replace(robots, untimed=4.0), bindings.assumed)
        self._seconds = seconds

    async def refresh(self) -> None:
        """Take some time."""
        await asyncio.sleep(self._seconds())


def seconds_of(rng: random.Random) -> Callable[[], float]:
    """Return what draws how long work takes: often no time at all, now and then longer than most actions."""
    return lambda: rng.choice([0.0, 0.0, 0.2, rng.uniform(0.0, 1.0), rng.uniform(0.0, 5.0)])


def slow_backend(seconds: Callable[[], float]) -> Callable[[Problem, Bindings, Faults], SimulatedBackend]:
    """Return what makes the robots of a problem."""
    return partial(SlowBackend, seconds)
