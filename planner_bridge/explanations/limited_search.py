"""Searches for plans, and looks at what can be reached, that answer one question: they share a time limit."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Final

from planner_bridge.model.plan import PlanningResult, PlanningStatus
from planner_bridge.model.problem import Problem
from planner_bridge.planning.reachability import Reachability, TooLarge
from planner_bridge.planning.solve import solve

SECONDS: Final = 0.8
"""For one question, if nothing else is said: it is answered within a second."""
_LEAST: Final = 0.02
"""Seconds for a search, at least."""


@dataclass(frozen=True)
class AnswerLimit:
    """The moment at which a question has to be answered, on the clock of this process."""

    end: float
    _reached: dict[int, tuple[Problem, Reachability | None]] = field(default_factory=dict, repr=False)
    """What was looked at already, by the identity of the problem: mutable state."""

    @staticmethod
    def of(seconds: float) -> AnswerLimit:
        """Return the limit that ends in so many seconds."""
        return AnswerLimit(time.monotonic() + seconds)

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

    def reached(self, problem: Problem) -> Reachability | None:
        """Return what can be reached of a problem, and what its goal lacks; None if there is not enough time to say."""
        if id(problem) not in self._reached:
            reachability = Reachability(problem, problem.unknown)
            try:
                reachability.settle(problem.goal, self.end)
                self._reached[id(problem)] = problem, reachability
            except TooLarge:
                self._reached[id(problem)] = problem, None
        return self._reached[id(problem)][1]

    def first_plan(self, problem: Problem, *, improve: float = 0.0) -> PlanningResult:
        """Search for the plan that is to be explained; what cannot be reached at all is not searched for, which might take long."""
        if (reachability := self.reached(problem)) and reachability.of(problem.goal):
            return PlanningResult(PlanningStatus.UNSOLVABLE, message="the goal cannot be reached")
        return self.solve(problem, share=0.5, improve=improve)
