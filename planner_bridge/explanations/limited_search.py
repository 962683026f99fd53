"""Searches for plans that answer one question: they share a time limit."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Final

from planner_bridge.model.plan import PlanningResult, PlanningStatus
from planner_bridge.model.problem import Problem
from planner_bridge.planning.solve import solve
from planner_bridge.planning.unreachable import why_unreachable

_LEAST: Final = 0.02
"""Seconds for a search, at least."""


@dataclass(frozen=True)
class TimeLimit:
    """The moment at which a question has to be answered, on the clock of this process."""

    end: float

    @staticmethod
    def of(seconds: float) -> TimeLimit:
        """Return the limit that ends in so many seconds."""
        return TimeLimit(time.monotonic() + seconds)

    @property
    def left(self) -> float:
        """Seconds that are left."""
        return max(0.0, self.end - time.monotonic())

    @property
    def is_over(self) -> bool:
        """Whether no search is worth its beginning."""
        return self.left < _LEAST

    def solve(self, problem: Problem, *, share: float = 1.0, improve: float = 0.0) -> PlanningResult:
        """Search for a plan for this share of the time that is left, at most, and for a better one for so long."""
        if self.is_over:
            return PlanningResult(PlanningStatus.TIMED_OUT, message="there was no time left")
        return solve(problem, timeout=max(_LEAST, self.left * share), improve=min(improve, self.left * share))

    def first_plan(self, problem: Problem, *, improve: float = 0.0) -> PlanningResult:
        """Search for the plan that is to be explained; what cannot be reached at all is not searched for, which might take long."""
        if reason := why_unreachable(problem):
            return PlanningResult(PlanningStatus.UNSOLVABLE, message=reason)
        return self.solve(problem, share=0.5, improve=improve)
