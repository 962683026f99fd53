"""How long work takes, and how long it takes after a failure, for the benchmarks."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from planner_bridge.model.plan import Plan
from planner_bridge.tasks.settings import TaskObserver
from pnm.core.execution.call_results import Failure
from pnm.core.machine.guards import Rule


def seconds(work: Callable[[], object], times: int = 3) -> float:
    """The shortest of a few runs."""
    found = []
    for _ in range(times):
        gc.collect()
        began = time.perf_counter()
        work()
        found.append(time.perf_counter() - began)
    return min(found)


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

    def fired(self, transition: str, rule: Rule, now: float) -> None:
        if transition == "begin" and self.failed_at is not None:
            if self.planner:
                self.found.append((time.perf_counter() - self.failed_at, self.planner))
            self.failed_at = None
