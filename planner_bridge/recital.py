"""A plan that is carried out as it is written, as a task among others."""

from __future__ import annotations

from planner_bridge.codes import code_of_run
from planner_bridge.footprints import Footprint, footprint
from planner_bridge.standing import Over, Standing
from planner_bridge.task import Task
from pnm.errors import InputError
from pnm.performing import Performance, Performer
from pnm.results import RunResult
from pnm.run import Run
from pnm.tasking import Code, TaskEnding, TaskState


class Recital:
    """One run of a hand-written plan.

    When it is paused at once, a plan that it calls is cancelled and begins anew later.

    Args:
        performer: carries out the plan.
        task: what is told how it goes.

    Raises:
        InputError: there is no such plan, or it has no such parameter.
    """

    def __init__(self, performer: Performer, task: Task) -> None:
        wanted = task.wanted
        self._performer = performer
        self._task = task
        self._performance: Performance = performer.perform(wanted.text, wanted.parameters, task, task=wanted.id, priority=wanted.priority)
        self._standing = Standing(task, TaskState.RUNNING)

    async def perform(self) -> TaskEnding:
        """Carry the plan out and return how it ended."""
        program = self._performance.program
        try:
            await self._performer.check(self._performance)
        except InputError as error:
            return TaskEnding(Code.INVALID_GOAL, str(error))
        self._task.generated(program.machine, program.proof)
        self._standing.enter(TaskState.RUNNING)
        return self._ending(await self._performer.execute(self._performance))

    @property
    def run(self) -> Run:
        """The run of the plan."""
        return self._performance.executor.run

    @property
    def running(self) -> tuple[str, ...]:
        """The calls that are under way, those in plans that it calls as well."""
        return self._performance.running

    @property
    def footprint(self) -> Footprint:
        """What the plan needs and changes: all that it may still reach."""
        plan = self._performance.program.plan.graph
        over = (
            {one.call.index for one in self.run.told().calls if one.ended is not None} if len(plan.every_step) == len(plan.calls) else set()
        )
        calls = [call for call in plan.calls if call.index not in over]
        return footprint(calls, plan.goal, self._performer.world)

    @property
    def is_paused(self) -> bool:
        """Whether it was told to pause."""
        return self._standing.is_paused

    @property
    def awaits_answers(self) -> bool:
        """Whether nothing goes on before a person has answered."""
        return self._performance.awaits_answers

    def stop(self, code: Code, reason: str) -> None:
        """End it; what is under way is cancelled, and confirms it or is given up after its limit."""
        if self._standing.stop(Over(code, reason)):
            self._standing.enter(TaskState.CANCELLING, reason)
            self._performance.executor.stop(reason=reason)

    async def pause(self, reason: str, *, at_once: bool) -> None:
        """Start nothing more; return when nothing is under way."""
        if not self._standing.stopped:
            self._performance.limit.pause()
        await self._standing.pause(reason, self._performance.executor, at_once=at_once)

    def resume(self) -> None:
        """Go on."""
        if self.is_paused:
            self._performance.limit.go_on()
            self._standing.go_on()
            self._performance.executor.resume()

    def _ending(self, result: RunResult) -> TaskEnding:
        over = self._standing.stopped or Over(Code.TIMED_OUT, result.reason)  # who else stops it is its own limit
        reason = over.reason if result.stopped and not result.goal else result.reason
        cause = "" if result.goal or result.stopped else result.failures[0].cause if result.failures else "goal_false"
        return TaskEnding(code_of_run(result, over.code), reason, results=self._performance.results, cause=cause)
