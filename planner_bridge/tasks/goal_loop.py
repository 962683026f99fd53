"""The loop of one goal: plan, execute, and replan until the goal holds or the task ends for another reason."""

from __future__ import annotations

import asyncio
from contextlib import ExitStack, suppress
from dataclasses import replace
from functools import partial

from planner_bridge.model.plan import Plan
from planner_bridge.model.plan_simulation import NotProjectable, snapshot
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.tasks.constraint_monitor import TaskMonitor
from planner_bridge.tasks.context import TaskContext
from planner_bridge.tasks.control import TaskEnded
from planner_bridge.tasks.plan_execution import PlanExecution, proved_machine
from planner_bridge.tasks.plan_search import NoPlan, PlanSearch
from planner_bridge.tasks.replanning import Decision, GiveUp, History, PlanAgain, Progress, ResumePlan, decide, shortened, times_that_matter
from planner_bridge.tasks.result import TaskLog, TaskResult, code_of_failures, code_of_planning, join_reasons, retry_reason
from pnm.core.execution.handover import UnderWay
from pnm.core.execution.resources import who_keeps
from pnm.core.logic.evaluation import evaluate
from pnm.core.machine.machine import OnFailure
from pnm.core.machine.plan_graph import PlanGraph, PlanGraphError
from pnm.core.machine.verification.part import Unsound
from pnm.tasks import Code, TaskState


class GoalLoop:
    """Pursues the goal of a task with as many plans as it takes.

    Whether a run is over or goes on, one method decides what follows it (`_replan`): a run that is over is a run with nothing under
    way. The mutable state is the log, when the back-off ends before the current run is replaced, and that of the other parts.

    Args:
        context: of the task.
        history: what has failed before.
        given: a plan to begin with, in place of one that would have to be found; the task ends with it.
    """

    def __init__(self, context: TaskContext, *, history: History | None = None, given: Plan | None = None) -> None:
        self._context = context
        self._control = context.control
        self._given = given
        self._monitor = TaskMonitor(context)
        self._search = PlanSearch(context, self._monitor)
        self._log = TaskLog(history or History())
        self._retry_at: float | None = None

    async def pursue(self) -> TaskResult:
        """Plan, execute and replan until the task has come to its end.

        Raises:
            InputError: the planner refuses the problem; nothing was started.
        """
        with ExitStack() as cleanup:
            try:
                self._monitor.begin(cleanup)
                await self._control.until(self._context.backend.refresh())
                await self._monitor.settle()  # before anything is planned: a constraint may only look violated because a report is late
                if self._given is None:
                    search = partial(self._search.plan, self._context.forbidden(self._log.history))
                    plan = await self._search.patiently(lambda: self._search.in_turn(search))
                else:
                    plan = await self._search.in_turn(partial(self._search.given, self._given))
                graph = await self._accepted(plan)
                while True:
                    graph = await self._execute(graph)
            except NoPlan as no_plan:
                withheld = who_keeps(self._context.resources.withheld)  # nobody knows what their servers have made of the world
                unfulfilled = self._log.unfulfilled(self._monitor.missing)
                reason = join_reasons(self._log.last_failure, str(no_plan), unfulfilled, withheld)
                ended = TaskEnded(code_of_planning(no_plan.status, self._log.failures), reason)
            except TaskEnded as error:
                ended = error
            except (PlanGraphError, Unsound) as error:  # a plan that is valid, but not by causes alone
                ended = TaskEnded(Code.PLANNER_ERROR, f"the plan cannot be executed: {error}")
            return self._result(ended)

    async def _execute(self, graph: PlanGraph) -> PlanGraph:
        """Execute a plan, and those that succeed it while calls are under way; return the one that follows when the run is over."""
        context = self._context
        with suppress(TaskEnded):  # the run reports then that nothing of the plan was begun
            await self._control.until(context.backend.prepare({call.action: None for call in graph.calls}))
        self._retry_at = None
        making = proved_machine(context, graph)  # also of a plan that is not begun any more: the result says what would have been called
        machine = await (making if self._control.stopped else self._control.until(making))
        async with PlanExecution(context, self._monitor, self._log, machine, self._search.origin) as execution:
            while True:
                with context.task.stopwatch.of("execute"):
                    await execution.attention()
                if (follower := await self._replan(execution)) is not None:
                    return follower
                execution.release()

    # --- replanning -----------------------------------------------------------------------------

    async def _replan(self, execution: PlanExecution) -> PlanGraph | None:
        """Replace the run by that of another plan, or return that plan if the run is over; None if the run goes on."""
        if execution.is_over:  # reports about the last calls may still be on their way; the decision below should know them
            await self._catch_up(execution)
        while True:
            if execution.is_over:
                self._check_end(execution)
            elif not await self._is_to_be_replaced(execution) or execution.is_over:
                return None
            if (delay := self._backoff(execution)) > 0.0:
                if not execution.is_over:
                    # The run goes on during the back-off: what is under way may still succeed.
                    execution.call_attention_at(asyncio.get_running_loop().time() + delay)
                    return None
                # Decided anew afterwards: the task may have been stopped, or the goal reached, in the meantime.
                await self._control.wait(delay)
                continue
            if not execution.is_over:
                execution.hold()
                await self._context.backend.refresh()
                # Only requests that are settled can be handed over; the run has come to its end while it was waited for.
                if not await execution.at_rest():
                    await self._catch_up(execution)
                    continue
            was_over, under_way, history = execution.is_over, execution.under_way, self._next_history(execution)
            decision = await self._decide(execution, history)
            if execution.is_over is not was_over:
                continue
            if isinstance(decision, GiveUp):
                if not execution.is_over:
                    return None
                self._log.end(execution.run.machine, execution.result, decision)
                unfulfilled = self._log.unfulfilled(self._monitor.missing)
                raise TaskEnded(Code.REPLAN_LIMIT, join_reasons(decision.reason, self._log.last_failure, unfulfilled))
            self._context.observer.replanning(decision, execution.result)
            if execution.is_over:
                self._log.follow(execution.run.machine, execution.result, decision, history)
                return await self._follower(execution, decision)
            graph = await self._successor(execution, decision, history, under_way)
            if graph is None or not execution.is_over:
                return None
            await self._catch_up(execution)  # it came to its end while its successor was planned
            self._check_end(execution)
            if not self._monitor.why_not(Progress.beginning(graph), self._context.forbidden(history)):
                self._log.follow(execution.run.machine, execution.result, decision, history)
                return graph

    async def _catch_up(self, execution: PlanExecution) -> None:
        await self._context.backend.refresh()
        if not (execution.is_eager or execution.result.goal) or not self._monitor.constraints.idle:
            await asyncio.sleep(self._context.world.longest_lag)
        await self._monitor.settle()

    def _check_end(self, execution: PlanExecution) -> None:
        """Raise `TaskEnded` if the task ends with this run."""
        result, stopped, problem = execution.result, self._control.stopped, self._context.problem
        ended, is_violated = stopped, stopped is not None and stopped.code is Code.CONSTRAINT_VIOLATED
        # Order and number of the steps matter there, so the goal alone does not show that all is done.
        is_complete = result.goal or not (problem.network or self._given)  # a network of tasks, or a plan, is more than its goal
        if not is_violated and is_complete and self._goal_holds() and not self._monitor.missing:
            ended = TaskEnded(Code.GOAL_REACHED, "the goal holds")
        elif stopped is None and self._given and (result.failures or not execution.is_blocked):
            ended = TaskEnded(code_of_failures(result.failures), result.reason)
        if ended:
            self._log.end(execution.run.machine, execution.result)
            raise ended

    def _goal_holds(self) -> bool:
        return evaluate(self._context.problem.goal, self._context.knowledge) is True

    async def _is_to_be_replaced(self, execution: PlanExecution) -> bool:
        """Return whether to replan while the run goes on. If it has nothing more to do, it is finished."""
        context = self._context
        if self._control.stopped or self._control.is_paused or execution.is_finishing:
            return False
        if execution.is_blocked:
            execution.finish("others have begun with what it is in conflict with")
            return False
        # For these the plan cannot be cut short or replaced in the middle: its steps or its times are part of the task.
        if self._given or context.problem.network or times_that_matter(context.problem):
            return False
        if execution.result.failures:
            return context.settings.on_failure is OnFailure.CONTINUE_OTHERS
        if self._goal_holds() and not execution.waits_for_more():
            execution.finish("the goal holds already")
            return False
        progress, world = execution.progress, snapshot(context.world)
        return bool(execution.obstacle()) or await asyncio.to_thread(lambda: shortened(progress, world) != progress)

    def _next_history(self, execution: PlanExecution) -> History:
        """Return the history with this run, if another is to follow it."""
        result, history = execution.result, self._log.history
        if not (result.failures or execution.is_over):
            return history.changed()
        after = history.after(result.calls, result.failures, self._context.settings.bindings)
        if execution.is_blocked and not result.failures:  # which says nothing about the plan
            return replace(history, failed=after.failed)
        return after

    def _backoff(self, execution: PlanExecution) -> float:
        """Return the seconds until the run may be replaced; they begin when that is first considered."""
        history, limits = self._next_history(execution), self._context.settings.limits
        if not (execution.is_over or execution.result.failures) or history.given_up(limits):
            return 0.0
        now, backoff = asyncio.get_running_loop().time(), history.backoff(limits)
        if self._retry_at is None:  # fixed once per run: each further change would otherwise push the attempt further away
            is_patient = not (execution.is_over or execution.is_eager)  # reports about the failure may still be under way
            self._retry_at = now + max(backoff, self._context.world.longest_lag if is_patient else 0.0)
        if backoff and now < self._retry_at:
            state = TaskState.REPLANNING if execution.is_over else TaskState.RUNNING
            self._control.enter(state, retry_reason(backoff, execution.result))
        return self._retry_at - now

    async def _decide(self, execution: PlanExecution, history: History) -> Decision:
        """Decide what follows the run. A failure makes nothing needless, but facts that have changed may."""
        context, progress, now, world = self._context, execution.progress, self._monitor.now(), snapshot(self._context.world)
        has_failed, limits, unusable = execution.is_over or execution.result.failures, context.settings.limits, context.unusable(history)

        def decision() -> Decision:
            left = progress if has_failed else shortened(progress, world)
            return decide(now, left, world, history, limits, unusable)

        return await asyncio.to_thread(decision)

    async def _follower(self, execution: PlanExecution, decision: ResumePlan | PlanAgain) -> PlanGraph:
        if isinstance(decision, ResumePlan) and not execution.is_blocked:
            return decision.rest
        if self._given is None:
            # What is forbidden is looked at anew each time: a value that a call lacked may be known by then.
            plan = await self._search.patiently(lambda: self._search.following(execution, self._context.forbidden(self._log.history)))
            assert plan is not None, "a plan that is searched for in turn is in no conflict"
            return await self._accepted(plan)
        if isinstance(decision, PlanAgain):
            raise TaskEnded(Code.CONDITION_LOST, decision.why)
        return await self._search.in_turn(partial(self._search.rest, decision.rest))

    async def _successor(
        self, execution: PlanExecution, decision: ResumePlan | PlanAgain, history: History, under_way: tuple[UnderWay, ...]
    ) -> PlanGraph | None:
        """Replace a run that goes on by that of another plan. Return the plan; None if the run has to come to its end first.

        If it does so while a plan is searched for, the plan is returned all the same. What is under way was so when the decision was made.
        """
        try:
            if isinstance(decision, ResumePlan):
                graph = decision.rest
            else:
                self._control.enter(TaskState.REPLANNING, decision.why)
                plan = await self._search.following(execution, decision.forbidden)
                if plan is None:
                    return None
                under_way = execution.under_way if await execution.at_rest() else ()
                graph = await self._accepted(plan, under_way)
                if self._monitor.why_not(Progress.beginning(graph), self._context.forbidden(history)):
                    return None
            successor = None if execution.is_over else await proved_machine(self._context, graph)
            reserved = self._control.reserved if successor and isinstance(decision, PlanAgain) else None
            goes_on = await execution.at_rest()
            # Nothing waits from here on: what others have begun, and what has ended, while the machine was made is all that there is.
            if execution.under_way != under_way or (reserved and self._context.scheduler.conflicts(self._context.task, reserved)):
                execution.call_attention_at(asyncio.get_running_loop().time())
                return None
            if goes_on and successor:
                self._control.check()
                machine, result = execution.run.machine, execution.result
                execution.succeed(successor)
                self._log.follow(machine, result, decision, history)
                self._retry_at = None
        except (NoPlan, TaskEnded, NotProjectable, PlanGraphError, Unsound):  # what is under way may not fit into any plan
            return None
        finally:
            self._control.enter(TaskState.RUNNING)
        return graph

    async def _accepted(self, plan: Plan, under_way: tuple[UnderWay, ...] = ()) -> PlanGraph:
        """Note that a plan will be executed, and return its graph, with calls that are under way."""
        limits = self._context.settings.limits
        self._log.plans += 1
        self._monitor.limit.allow(limits.allowed(plan.makespan if plan.temporal else 0.0))
        self._context.observer.planned(plan)
        with self._context.task.stopwatch.of("translate"):
            calls = [running.call for running in under_way]
            return await self._control.until(asyncio.to_thread(plan_graph, self._monitor.now(), plan, calls))

    # --- the end --------------------------------------------------------------------------------

    def _result(self, ended: TaskEnded) -> TaskResult:
        self._control.reserved = None
        monitor, now = self._monitor.constraints, self._monitor.elapsed
        return TaskResult(
            ended.code,
            ended.reason,
            self._log.plans,
            tuple(self._log.episodes),
            self._context.task.stopwatch.seconds,
            self._monitor.began,
            monitor.constraint_results(now),
            monitor.preference_results(now),
        )
