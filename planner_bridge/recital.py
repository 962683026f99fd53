"""A plan that somebody has written, carried out as a task: as it is, and not beside a planner."""

from __future__ import annotations

import asyncio
from typing import Final

from planner_bridge.codes import code_of_failures
from planner_bridge.footprints import Footprint
from planner_bridge.tasks import TaskObserver
from pnm.performing import Performance, Performer
from pnm.run import Run
from pnm.tasking import Code, TaskEnding, TaskState

_LOOK: Final = 0.02
"""Seconds between two looks at whether a run has come to rest."""


class Recital:
    """Has a performance carried out. The mutable state is whether it is paused, and why it ends early.

    Args:
        performer: carries it out.
        performance: what is carried out.
        observer: is told in which state the task is; the performance tells it all else.
    """

    def __init__(self, performer: Performer, performance: Performance, observer: TaskObserver) -> None:
        self._performer = performer
        self._performance = performance
        self._observer = observer
        self._is_paused = False
        self._stopped: tuple[Code, str] | None = None

    async def pursue(self) -> TaskEnding:
        """Carry it out, and return how it ended."""
        program = self._performance.program
        self._observer.generated(program.machine, program.proof)
        self._observer.entered(TaskState.RUNNING, "")
        result = await self._performer.execute(self._performance)
        if result.goal:
            return TaskEnding(Code.GOAL_REACHED, result.reason, results=self._performance.results)
        if result.stopped:
            code, reason = self._stopped or (Code.TIMED_OUT, result.reason)
        else:
            code, reason = code_of_failures(result.failures), result.reason
        return TaskEnding(code, reason, results=self._performance.results)

    @property
    def run(self) -> Run:
        """The run that goes on."""
        return self._performance.executor.run

    @property
    def footprint(self) -> Footprint | None:
        """Nothing: what a plan with loops and choices will change is not known."""
        return None

    @property
    def is_paused(self) -> bool:
        """Whether it was told to pause."""
        return self._is_paused

    def stop(self, code: Code, reason: str) -> None:
        """End it."""
        if self._stopped is None:
            self._stopped = code, reason
            self._observer.entered(TaskState.CANCELLING, reason)
            self._performance.executor.stop(reason=reason)

    async def pause(self, reason: str, *, at_once: bool) -> None:
        """Start nothing more; return when nothing is under way."""
        self._is_paused = True
        self._observer.entered(TaskState.PAUSING, reason)
        self._performance.executor.pause(at_once=at_once)
        while self._is_paused and not (self.run.paused or self.run.over):  # noqa: ASYNC110 - a run tells nobody that it is at rest
            await asyncio.sleep(_LOOK)
        if self._is_paused:
            self._observer.entered(TaskState.PAUSED, reason)

    def resume(self) -> None:
        """Go on."""
        if self._is_paused:
            self._is_paused = False
            self._observer.entered(TaskState.RUNNING, "")
            self._performance.executor.resume()
