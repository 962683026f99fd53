"""One goal, pursued with as many plans as it takes: planning, execution, replanning, pauses.

What has become of a pursuit so far: its plans, its runs, and what they teach.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from dataclasses import replace
from typing import cast

from planner_bridge.model.forbidden_actions import ForbiddenCall
from planner_bridge.model.plan import Plan
from planner_bridge.ordering.interference import ReadWriteSets
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.tasks.constraint_monitor import Supervision
from planner_bridge.tasks.context import Mission
from planner_bridge.tasks.control import Over, Standing
from planner_bridge.tasks.plan_execution import Relay
from planner_bridge.tasks.plan_search import Finding
from planner_bridge.tasks.replanning import GiveUp, History, PlanAgain, Progress, Resume, decide
from planner_bridge.tasks.result import TaskResult, code_of_failures
from planner_bridge.tasks.settings import OnChange
from planner_bridge.tasks.task_history import Chronicle, Way, sentence, tries_again
from pnm.core.execution.call_results import RunResult
from pnm.core.execution.run import Run
from pnm.core.logic.evaluation import evaluate
from pnm.core.logic.expressions import Fluent, Unknown, Value
from pnm.core.machine.plan_graph import PlanGraph, PlanGraphError
from pnm.core.machine.verification.explore import Unsound
from pnm.tasks import Code, TaskState


class Pursuit:
    """A goal with its episodes.

    The mutable state is the relay of runs, the last run before it, whether that has ended for want of room beside others, and
    what the parts say of themselves.

    Args:
        mission: what is pursued.
        history: what has failed before.
        given: a plan to begin with, in place of one that would have to be found; the task ends with it.
    """

    def __init__(self, mission: Mission, *, history: History | None = None, given: Plan | None = None) -> None:
        self._mission = mission
        self._given = given
        self._standing = Standing(mission.observer)
        self._chronicle = Chronicle(history or History())
        self._supervision = Supervision(mission.problem, mission.knowledge, mission.observer, self.stop, mission.settings.limits.allowed())
        self._finding = Finding(mission, self._standing, self._supervision, self._chronicle, given)
        self._relay: Relay | None = None
        self._last: Run | None = None
        self._lacks_room = False

    async def pursue(self, *, opens: bool = False) -> TaskResult:
        """Go on until the goal holds or the task is over for another reason; nothing happens between that and the return.

        Args:
            opens: whether the site is still to be opened.

        Raises:
            InputError: the planner refuses the problem; nothing was started.
        """
        with ExitStack() as at_the_end:
            try:
                if opens:
                    await self._standing.until(self._mission.site.open(self._mission.world))
                self._supervision.begin(at_the_end)
                at_the_end.callback(self._mission.world.listen(self._changed))
                await self._pursue()
            except Over as over:
                return self._ended(over.code, over.reason)
            except (PlanGraphError, Unsound) as error:  # a plan that is valid, but not by causes alone
                return self._ended(Code.PLANNER_ERROR, f"the plan cannot be executed: {error}")
        raise AssertionError("a pursuit ends with a reason")

    # --- from outside ---------------------------------------------------------------------------

    @property
    def run(self) -> Run | None:
        """The current run, or the last one."""
        return self._relay.run if self._relay else self._last

    @property
    def is_paused(self) -> bool:
        """Whether it was told to pause."""
        return self._standing.is_paused

    @property
    def awaits_answers(self) -> bool:
        """Whether nothing goes on before a person has answered."""
        return self._relay is not None and self._relay.run.awaits_answers

    @property
    def footprint(self) -> ReadWriteSets | None:
        """What the rest of the plan needs and changes; None while there is no plan."""
        if self._relay is None:
            return self._finding.reserved
        return self._relay.footprint

    def stop(self, code: Code, reason: str) -> None:
        """End whatever is going on; what is under way is cancelled, and confirms it or is given up after its limit."""
        if self._standing.stop(Over(code, reason)):
            self._finding.stop()
            self._standing.enter(TaskState.CANCELLING, reason)
            if self._relay:
                self._relay.stop(reason)

    async def pause(self, reason: str, *, at_once: bool) -> None:
        """Start nothing more; return when nothing is under way."""
        if not self._standing.stopped:
            self._supervision.limit.pause()
        await self._standing.pause(reason, self._relay.executor if self._relay else None, at_once=at_once)

    def resume(self) -> None:
        """Go on where the task was if the rest of its plan still works, and else find another way."""
        if self.is_paused:
            self._supervision.limit.go_on()
            self._standing.go_on()
            if self._relay:
                self._relay.go_on()

    @property
    def running(self) -> tuple[str, ...]:
        """The calls that are under way."""
        return tuple(str(call.action) for call in self.run.open_calls.values()) if self.run else ()

    # --- the story ------------------------------------------------------------------------------

    async def _pursue(self) -> None:
        """Go on until `Over` is raised."""
        await self._settle()
        graph = await self._planned(self._mission.forbidden(self._chronicle.history))
        while True:
            result, way = await self._carry_out(graph)
            graph = await self._next(result, way)

    async def _planned(self, forbidden: frozenset[ForbiddenCall]) -> PlanGraph:
        plan = await self._finding.find(forbidden)
        with self._mission.seconds.of("translate"):
            return plan_graph(self._supervision.now(), plan)

    async def _carry_out(self, graph: PlanGraph) -> tuple[RunResult, Way | None]:
        with suppress(Over):  # the run tells then that nothing of the plan was begun
            await self._standing.until(self._mission.site.prepare({call.action: None for call in graph.calls}))
        relay = self._relay = Relay(graph, self._mission, self._standing, self._supervision, self._finding, self._chronicle)
        self._standing.enter(TaskState.RUNNING)
        try:
            with self._mission.seconds.of("execute"):
                return await relay.carry_out()
        finally:
            self._last, self._lacks_room, self._relay = relay.run, relay.lacks_room, None

    async def _next(self, result: RunResult, way: Way | None) -> PlanGraph:
        """Return what follows a run that is over.

        Raises:
            Over: nothing does.
        """
        await self._catch_up(result)
        machine = cast("Run", self._last).machine
        if verdict := self._verdict(result):
            self._chronicle.end(machine, result)
            raise verdict
        if way and (graph := self._still_possible(way)):
            self._chronicle.follow(way, machine, result)
            return graph
        return await self._decided(result)

    async def _catch_up(self, result: RunResult) -> None:
        """Wait for reports that may still be under way."""
        is_patient = self._mission.settings.on_change is OnChange.LAZY
        if (is_patient and not result.goal) or not self._supervision.monitor.idle:
            await asyncio.sleep(self._mission.world.longest_lag)
        await self._settle()

    async def _settle(self) -> None:
        """Wait until it is known whether that is violated which looks violated now."""
        if self._supervision.doubtful > 0:
            await self._standing.wait(self._supervision.doubtful)
            self._supervision.look()

    def _still_possible(self, way: Way) -> PlanGraph | None:
        """Return the plan that was found while the run went on, if it still works."""
        if way.plan is None:
            return None
        try:
            graph = plan_graph(self._supervision.now(), way.plan)
        except PlanGraphError:
            return None
        return None if self._supervision.why_not(Progress.beginning(graph), self._mission.forbidden(way.history)) else graph

    async def _decided(self, result: RunResult) -> PlanGraph:
        limits, world, machine = self._mission.settings.limits, self._mission.world, cast("Run", self._last).machine
        history = self._chronicle.history.after(result.calls, result.failures)
        if self._lacks_room and not result.failures:  # which speaks against nothing but the moment
            history = replace(self._chronicle.history, failed=history.failed)
        progress, kept = Progress(machine.plan, result.calls), self._mission.kept(history)
        decision = decide(self._supervision.now(), progress, world, history, limits, kept)
        if isinstance(decision, GiveUp):
            self._chronicle.end(machine, result, decision)
            unfulfilled = self._chronicle.unfulfilled(self._supervision.missing)
            raise Over(Code.REPLAN_LIMIT, sentence(decision.reason, self._chronicle.last_failure, unfulfilled))
        self._chronicle.follow(Way(decision, history), machine, result)
        self._mission.observer.replanning(decision, result)
        if pause := history.pause(limits):
            self._standing.enter(TaskState.REPLANNING, tries_again(pause, result))
            await self._standing.wait(pause)
        if isinstance(decision, Resume) and not self._lacks_room:
            return decision.rest
        if self._given is None:
            return await self._planned_patiently(self._mission.forbidden(history))
        if isinstance(decision, PlanAgain):
            raise Over(Code.CONDITION_LOST, decision.why)
        return await self._finding.room_for(decision.rest)

    async def _planned_patiently(self, forbidden: frozenset[ForbiddenCall]) -> PlanGraph:
        """Plan, and plan once more if there is no plan only because what has just happened has not been reported yet."""
        facts = self._mission.world.facts()
        try:
            return await self._planned(forbidden)
        except Over as over:
            await asyncio.sleep(self._mission.world.longest_lag)
            if self._standing.stopped or over.code is Code.CONFLICT or self._mission.world.facts() == facts:
                raise
            return await self._planned(forbidden)

    # --- the end --------------------------------------------------------------------------------

    def _verdict(self, result: RunResult) -> Over | None:
        """Return how the task ends if it ends with this run."""
        stopped = self._standing.stopped
        if stopped and stopped.code is Code.CONSTRAINT_VIOLATED:
            return stopped
        if self._is_carried_out(result) and self._holds() and not self._supervision.missing:
            return Over(Code.GOAL_REACHED, "the goal holds")
        if stopped is None and self._given and (result.failures or not self._lacks_room):
            return Over(code_of_failures(result.failures), result.reason)
        return stopped

    def _is_carried_out(self, result: RunResult) -> bool:
        """Tell whether the run has done all that was asked for; a network of tasks, or a plan, is more than its goal."""
        return result.goal or not (self._mission.problem.network or self._given)

    def _holds(self) -> bool:
        return evaluate(self._mission.problem.goal, self._mission.knowledge) is True

    def _changed(self, changes: Mapping[Fluent, Value | Unknown]) -> None:
        if self._relay:
            self._relay.changed(changes)

    def _ended(self, code: Code, reason: str) -> TaskResult:
        self._finding.forget()
        self._standing.enter(TaskState.OVER, reason)
        monitor, now = self._supervision.monitor, self._supervision.elapsed
        return TaskResult(
            code,
            reason,
            self._chronicle.plans,
            tuple(self._chronicle.episodes),
            self._mission.seconds.seconds,
            self._supervision.began,
            monitor.constraint_results(now),
            monitor.preference_results(now),
        )
