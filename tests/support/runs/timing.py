"""How long work takes, how many functions it calls, and how long it takes after a failure."""

from __future__ import annotations

import gc
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import FrameType

from planner_bridge.model.plan import Plan
from planner_bridge.tasks.settings import TaskObserver
from pnm.core.execution.call_results import Failure
from pnm.core.execution.events import Fired


def seconds(work: Callable[[], object], times: int = 3) -> float:
    """The shortest of a few runs."""
    found = []
    for _ in range(times):
        gc.collect()
        began = time.perf_counter()
        work()
        found.append(time.perf_counter() - began)
    return min(found)


@contextmanager
def functions_called() -> Iterator[Callable[[], int]]:
    """Count the calls of Python functions; how many there were is told on demand."""
    called = 0

    def count(_frame: FrameType, event: str, _argument: object) -> None:
        nonlocal called
        called += event == "call"

    before = sys.getprofile()
    sys.setprofile(count)
    try:
        yield lambda: called
    finally:
        sys.setprofile(before)


@dataclass
class FailureClock(TaskObserver):
    """Seconds from failures to the begin of what follows, and how many of them the planner took."""

    found: list[tuple[float, float]] = field(default_factory=list)
    failed_at: float | None = None
    asked_at: float = 0.0
    planner: float = 0.0

    def failed(self, failure: Failure, now: float) -> None:
        if self.failed_at is None:
            self.failed_at, self.planner = time.perf_counter(), 0.0

    def planning(self, planner: str) -> None:
        self.asked_at = time.perf_counter()

    def planned(self, plan: Plan) -> None:
        self.planner = time.perf_counter() - self.asked_at

    def fired(self, fired: Fired, now: float) -> None:
        if fired.name == "begin" and self.failed_at is not None:
            if self.planner:
                self.found.append((time.perf_counter() - self.failed_at, self.planner))
            self.failed_at = None
