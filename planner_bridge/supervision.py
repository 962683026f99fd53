"""What is watched while a goal is pursued: how long it takes, what time itself changes, and the constraints of the problem."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import ExitStack
from math import inf

from planner_bridge.forbidding import ForbiddenCall
from planner_bridge.model import Problem
from planner_bridge.monitoring import Monitor
from planner_bridge.replanning import Progress, why_not
from planner_bridge.state import problem_now
from planner_bridge.tasks import TaskObserver
from pnm.knowledge import KnowledgeBase, Layered
from pnm.sites import schedule
from pnm.tasking import Code
from pnm.time_limit import TimeLimit
from pnm.trajectory import Constraint


class Supervision:
    """The clock and the monitor of one task.

    The mutable state is what stands below "state".

    Args:
        problem: what is pursued.
        knowledge: what is known.
        observer: is told when a constraint is violated.
        stop: ends the task.
        allowed: seconds that it may take, pauses left out.
    """

    def __init__(
        self, problem: Problem, knowledge: Layered, observer: TaskObserver, stop: Callable[[Code, str], None], allowed: float
    ) -> None:
        self._problem = problem
        self._knowledge = knowledge
        self._observer = observer
        self._stop = stop
        self.monitor = Monitor(problem, knowledge)
        # state
        self.began = 0.0
        self.limit = TimeLimit(allowed, self._exceeded)
        """The seconds that the task may take; those of pauses are not its own."""
        self._next_look: asyncio.TimerHandle | None = None

    def begin(self, at_the_end: ExitStack) -> None:
        """Begin; let those timed facts come true by themselves that nobody reports; look whenever something changes or a time comes."""
        self.began = asyncio.get_running_loop().time()
        world = self._knowledge.world
        at_the_end.callback(schedule(world, self._problem.timed, self.began))
        at_the_end.callback(self._end_looking)
        at_the_end.callback(world.listen(self.look))
        at_the_end.callback(self.limit.close)
        self.limit.begin()
        self.look()

    @property
    def elapsed(self) -> float:
        """How many seconds the task has taken so far."""
        return asyncio.get_running_loop().time() - self.began

    def look(self, _changes: object = None) -> None:
        """Look for violated constraints, and note when to look again."""
        now = self.elapsed
        for violation in self.monitor.look(now):
            self._observer.violated(violation, asyncio.get_running_loop().time())
            self._stop(Code.CONSTRAINT_VIOLATED, str(violation))
        if self._next_look:
            self._next_look.cancel()
        time = self.monitor.next_look(now)
        self._next_look = None if time == inf else asyncio.get_running_loop().call_at(self.began + time, self.look)

    @property
    def doubtful(self) -> float:
        """How many seconds it will take until it is known whether that is violated which looks violated now."""
        return self.monitor.doubtful_until() - self.elapsed

    def now(self, world: KnowledgeBase | None = None) -> Problem:
        """Return the problem that is left, from this world, or the one that is known."""
        elapsed = self.elapsed
        return self.monitor.rest_of(problem_now(self._problem, world or self._knowledge.world, elapsed), elapsed)

    @property
    def missing(self) -> tuple[Constraint, ...]:
        """The constraints that are not fulfilled yet."""
        return self.monitor.missing(self.elapsed)

    def why_not(self, progress: Progress, forbidden: frozenset[ForbiddenCall]) -> str:
        """Say why the rest of a plan does not lead from here to its goal; empty when it does."""
        left = self.monitor.rest_of(self._problem, self.elapsed)
        return why_not(progress, self._knowledge.world, forbidden, (*left.domain.constraints, *left.constraints))

    def _exceeded(self, seconds: float) -> None:
        self._stop(Code.TIMED_OUT, f"the limit of {seconds:g} s is reached")

    def _end_looking(self) -> None:
        if self._next_look:
            self._next_look.cancel()
