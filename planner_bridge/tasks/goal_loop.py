"""The loop of one goal: plan, execute, and replan until the goal holds or the task ends for another reason."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable
from contextlib import ExitStack, suppress
from dataclasses import replace
from enum import Enum
from functools import partial
from uuid import uuid5

from planner_bridge.model.plan import Plan, Policy
from planner_bridge.model.progression import NotProjectable, snapshot
from planner_bridge.ordering.plan_to_graph import plan_graph, stretch_graph
from planner_bridge.tasks.constraint_monitor import TaskMonitor
from planner_bridge.tasks.context import Conflict, TaskContext
from planner_bridge.tasks.control import TaskEnded
from planner_bridge.tasks.plan_execution import PlanExecution, proved_machine
from planner_bridge.tasks.plan_search import NoPlan, PlanSearch
from planner_bridge.tasks.replanning import (
    BetterRest,
    Decision,
    GiveUp,
    History,
    NextStretch,
    PlanAgain,
    Progress,
    Reached,
    ResumePlan,
    decide,
    decision_words,
    followed,
    needless,
    next_stretch,
    shortened,
    times_that_matter,
)
from planner_bridge.tasks.result import (
    GoalNote,
    TaskLog,
    TaskResult,
    code_of_failures,
    code_of_planning,
    join_reasons,
    notes_of,
    restored_log,
    retry_reason,
)
from planner_bridge.tasks.settings import ProvedMachine
from pnm.core.execution.call_results import RunResult
from pnm.core.execution.handover import UnderWay
from pnm.core.logic.conditions import TRUE, evaluate
from pnm.core.logic.expressions import fluent_text
from pnm.core.machine.machine import OnFailure, PetriNetMachine
from pnm.core.machine.plan_graph import PlanGraph, PlanGraphError
from pnm.core.machine.verification.part import Unsound
from pnm.core.resources import who_keeps
from pnm.journal.replay import ReplayedRun, ReplayedTask
from pnm.knowledge.people import Advice, HelpEnded, ask_for_help, is_approved
from pnm.knowledge.source import Asker, Source, SourceError
from pnm.tasks import Code, TaskState


class Outstanding(Enum):
    """The work that is due after a look at a run that goes on."""

    NOTHING = "nothing"
    """It was replaced, it need not be, or it is to come to its end first."""
    REPLACEMENT = "replacement"
    """It is still to be replaced, which what is under way does not allow now, or not yet."""


class GoalLoop:
    """Pursues the goal of a task with as many plans as it takes.

    Whether a run is over or goes on, one method decides what follows it (`_replan`): a run that is over is a run with nothing under
    way. The mutable state is the log, when the back-off ends before the current run is replaced, how often people had taken
    something in hand or given it back when a run was replaced last, whether facts have changed since the
    last attempt began, the question to a person that is open, and that of the other parts.

    Args:
        history: what has failed before.
        given: a plan to begin with, in place of one that would have to be found; the task ends with it.
        kept: the task as another process left it, if it goes on here.
    """

    def __init__(
        self, context: TaskContext, *, history: History | None = None, given: Plan | None = None, kept: ReplayedTask | None = None
    ) -> None:
        self._context = context
        self._control = context.control
        self._given = given
        self._monitor = TaskMonitor(context, kept)
        self._search = PlanSearch(context, self._monitor, kept)
        self._log, self._kept_run = restored_log(kept) if kept else (TaskLog(history or History()), None)
        has_set_out = kept is not None and bool(kept.runs or notes_of(kept, GoalNote))
        self._is_approved = has_set_out or not context.task.wanted.needs_yes
        self._retry_at: float | None = None
        self._hands_changes = context.runner.hands.changes
        self._facts_changed = asyncio.Event()
        self._question: asyncio.Future[Advice] | None = None

    async def pursue(self) -> TaskResult:
        """Plan, execute and replan until the task ends; raise an `InputError`, with nothing started, if the planner refuses the problem."""
        with ExitStack() as cleanup:
            cleanup.callback(self._withdraw)
            cleanup.callback(self._search.end_ahead)
            cleanup.callback(self._search.end_improving)
            if self._context.helper is not None:  # else nobody asks: all that listen hear of every change
                cleanup.callback(self._context.world.listen(lambda changes: self._facts_changed.set() if changes else None))
            self._monitor.begin(cleanup)
            ended = None if self._is_approved else await self._unapproved()
            while ended is None:
                self._facts_changed.clear()
                ended = await self._attempt()
                if ended.can_be_helped and self._context.helper is not None:
                    ended = await self._helped(ended, self._context.helper)
            self._context.scheduler.release(self._context.task)
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

    async def _unapproved(self) -> TaskEnded | None:
        """Ask a person whether a goal that is only proposed is pursued. Return how the task ends without a yes; None with one."""
        context, control, task = self._context, self._control, self._context.task
        goal = str(context.problem.goal)
        control.awaits_help = True
        control.enter(TaskState.QUEUED, "waits for a person's yes")
        said = "it is not asked any more"
        try:
            if (person := context.runner.source) is None:
                raise SourceError("there is nobody to be asked")
            if await control.until(is_approved(person, Asker(task.id, goal, uuid5(task.id, "approval")), goal, context.note)):
                said = "a person says yes"
                self._note_goal()  # also in the next process it need not be asked again
                return None
            said = "a person was asked, and does not say yes"
        except SourceError as error:
            said = f"nobody says yes: {error}"
        except TaskEnded as stopped:
            return stopped
        finally:
            control.awaits_help = False
            context.note(HelpEnded(said))
        return TaskEnded(Code.CANCELLED, said)

    async def _attempt(self) -> TaskEnded:
        """Plan, execute and replan; return how the task ends if nothing helps."""
        try:
            kept_run, self._kept_run = self._kept_run, None
            with suppress(*(TaskEnded for _ in (kept_run,) if kept_run)):  # it is carried on even to be stopped: robots are at work
                await self._control.until(self._context.runner.backend.refresh())
                await self._monitor.settle()  # before anything is planned: a constraint may only look violated because a report is late
            if kept_run is not None:
                graph = await self._carry_on(kept_run)
            elif self._given is None:

                def search() -> Awaitable[tuple[Plan | None, tuple[Conflict, ...]]]:  # what is missing now may be there when it is repeated
                    return self._search.plan(self._context.forbidden(self._log.history))

                plan = await self._search.patiently(lambda: self._search.in_turn(search), self._patience)
                graph = await self._accepted(plan)
            else:
                graph = await self._accepted(await self._search.in_turn(partial(self._search.given, self._given)))
            while True:
                with suppress(TaskEnded):  # the run reports then that nothing of the plan was begun
                    await self._control.until(self._context.runner.backend.prepare({call.action: None for call in graph.calls}))
                making = proved_machine(self._context, graph)  # also if it is not begun: the result says what would have been called
                graph = await self._carry_on(await (making if self._control.stopped else self._control.until(making)))
        except NoPlan as no_plan:
            withheld = who_keeps(self._context.runner.resources.withheld)  # nobody knows what their servers have made of the world
            unfulfilled, why = self._log.unfulfilled(self._monitor.missing), str(no_plan)
            silent = dict.fromkeys(said for fluent, said in self._context.world.why_unknown().items() if fluent_text(fluent) in why)
            reason = join_reasons(self._log.last_failure, why, *silent, unfulfilled, withheld)
            return TaskEnded(code_of_planning(no_plan.status, self._log.failures), reason, can_be_helped=True)
        except TaskEnded as error:
            return error.with_traceback(None)  # which would keep all that is known here
        except (PlanGraphError, Unsound) as error:  # a plan that is valid, but not by causes alone
            return TaskEnded(Code.PLANNER_ERROR, f"the plan cannot be executed: {error}")

    async def _helped(self, ended: TaskEnded, helper: Source) -> TaskEnded | None:
        """Ask a person for help. Return how the task ends; None if it begins again because of the answer, or because facts change."""
        context, control, task, history = self._context, self._control, self._context.task, self._log.history
        reason = f"asks for help: {join_reasons(ended.reason, history.remedy(context.settings.limits, context.runner.backend.missing))}"
        if self._question is None:
            trouble = f"This goal cannot be reached: {reason.removeprefix('asks for help: ')}"
            asker = Asker(task.id, task.wanted.text or str(context.problem.goal), uuid5(task.id, f"help {self._log.helped}"), task.id)
            self._question = asyncio.ensure_future(ask_for_help(helper, asker, trouble, context.note))
            context.observer.blocked(reason)
        # What was replaced too often is not replaced once more because facts keep changing.
        news = self._facts_changed if ended.by_facts else asyncio.Event()
        self._question.add_done_callback(lambda _: news.set())
        context.scheduler.release(task)
        control.awaits_help = True
        control.enter(TaskState.QUEUED, reason)
        try:
            await control.until(news.wait())
        except TaskEnded as stopped:
            return stopped
        finally:
            control.awaits_help = False
        if not self._question.done():
            await control.wait(context.settings.limits.backoff)  # facts seldom change alone, and some all the time
            return None
        advice, self._question = self._question.result(), None
        context.note(HelpEnded(advice.why))
        if advice.try_again:
            self._log.history = History()  # what has failed may work again
            self._log.helped += 1
            self._note_goal()
            return None
        return TaskEnded(ended.code, join_reasons(ended.reason, advice.why))

    def _withdraw(self) -> None:
        if self._question is not None:
            self._question.cancel()
            self._question = None
            self._context.note(HelpEnded("a person need not help any more"))

    async def _carry_on(self, begin_with: ProvedMachine | ReplayedRun) -> PlanGraph:
        """Carry a run on to its end, and those that succeed it; return the plan that follows then."""
        context, self._retry_at = self._context, None
        self._search.end_ahead()
        async with PlanExecution(context, self._monitor, self._log, begin_with, self._search.origin) as execution:
            while True:
                if not (self._given or execution.result.failures):
                    self._search.improve(execution, self._log.history)
                with context.task.stopwatch.of("execute"):
                    await execution.attention()
                follows = await self._replan(execution)
                if isinstance(follows, PlanGraph):
                    return follows
                execution.note(is_due=follows is Outstanding.REPLACEMENT)
                execution.release()

    @property
    def _patience(self) -> float:
        """The seconds for which facts may change while there is no plan; while a person is asked, that is waited for besides."""
        return 0.0 if self._question else self._context.settings.limits.patience

    # --- replanning -----------------------------------------------------------------------------

    async def _replan(self, execution: PlanExecution) -> PlanGraph | Outstanding:
        """Replace the run by that of another plan, or return that plan if the run is over; if the run goes on, what is still due."""
        if execution.is_over:  # reports about the last calls may still be on their way; the decision below should know them
            self._search.end_improving()
            await self._catch_up(execution)
        while True:
            if execution.is_over:
                self._check_end(execution)
            elif not await self._is_to_be_replaced(execution) or execution.is_over:
                return Outstanding.NOTHING
            if (delay := self._backoff(execution)) > 0.0:
                if not execution.is_over:
                    # The run goes on during the back-off: what is under way may still succeed.
                    execution.call_attention_at(asyncio.get_running_loop().time() + delay)
                    return Outstanding.REPLACEMENT
                # Decided anew afterwards: the task may have been stopped, or the goal reached, in the meantime.
                await self._control.wait(delay)
                continue
            if not execution.is_over:
                execution.hold()
                with self._control.waiting():
                    await self._context.runner.backend.refresh()
                if not await execution.at_rest():  # only what is settled can be handed over
                    if not execution.is_over:  # it goes on, for a call that has ended waits for others, which have to begin
                        return Outstanding.REPLACEMENT
                    await self._catch_up(execution)  # it has come to its end while that was waited for
                    continue
            was_over, under_way, history = execution.is_over, execution.under_way, self._next_history(execution)
            decision: Decision | None = None
            with suppress(*(() if was_over else (PlanGraphError,))):  # what is under way may not fit into the rest: the run has to go on
                decision, history = await self._decide(execution, history)
            if execution.is_over is not was_over:
                continue
            if decision is None:
                return Outstanding.REPLACEMENT
            if isinstance(decision, GiveUp):
                if not execution.is_over:
                    return Outstanding.NOTHING
                self._log.end(execution.run.machine, execution.result, decision)
                unfulfilled = self._log.unfulfilled(self._monitor.missing)
                reason = join_reasons(decision.reason, self._log.last_failure, unfulfilled)
                raise TaskEnded(decision.code, reason, can_be_helped=self._given is None, by_facts=False)
            if not isinstance(decision, BetterRest):  # which is told when it is taken
                self._context.observer.replanning(decision, execution.result)
                if execution.is_over:
                    self._follow(execution.run.machine, execution.result, decision, history)
                    return await self._follower(execution, decision)
            assert not isinstance(decision, NextStretch), "a stretch has come to its end when another one follows"
            graph = await self._successor(execution, decision, history, under_way)
            if isinstance(graph, Outstanding):
                return graph
            if not execution.is_over:
                return Outstanding.NOTHING
            await self._catch_up(execution)  # it came to its end while its successor was planned
            self._check_end(execution)
            if not self._monitor.why_not(Progress.beginning(graph), self._context.forbidden(history)):
                self._follow(execution.run.machine, execution.result, decision, history)
                return graph

    def _follow(self, machine: PetriNetMachine, result: RunResult, decision: Decision, history: History) -> None:
        self._hands_changes = self._context.runner.hands.changes
        self._log.end(machine, result, decision)
        self._log.history = history
        self._note_goal(decision)

    def _note_goal(self, decision: Decision | None = None) -> None:
        self._context.note(GoalNote(self._log.history, self._log.plans, decision, self._log.helped))

    async def _catch_up(self, execution: PlanExecution) -> None:
        with self._control.waiting():
            await self._context.runner.backend.refresh()
        if not (execution.is_eager or execution.result.goal) or not self._monitor.constraints.idle:
            if execution.result.failures and self._given is None:
                self._search.begin_ahead(self._next_history(execution))
            with self._control.waiting():
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
            execution.finish("it is in conflict with calls that others have begun")
            return False
        # For these the plan cannot be cut short or replaced in the middle: its steps or its times are part of the task.
        if self._given or context.problem.network or times_that_matter(context.problem):
            return False
        if execution.result.failures:
            return context.settings.on_failure is OnFailure.CONTINUE_OTHERS
        if self._goal_holds() and not execution.waits_for_more():
            execution.finish("the goal holds already")
            return False
        progress, world = execution.progress, snapshot(context.present)
        if execution.obstacle() or self._search.better_than(progress):
            return True
        return await self._control.in_thread(lambda: shortened(progress, world) != progress)

    def _next_history(self, execution: PlanExecution) -> History:
        """Return the history with this run, if another is to follow it."""
        result, history = execution.result, self._log.history
        if self._hands_changes != self._context.runner.hands.changes:  # what people do to a plan says nothing about it
            history = replace(history, replans=history.replans - 1, reached=Reached())
        if not (result.failures or execution.is_over):
            return replace(history, replans=history.replans + 1)
        missing = self._context.runner.backend.missing
        after = history.after(result.calls, result.failures, self._context.settings.bindings, missing)
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

    async def _decide(self, execution: PlanExecution, history: History) -> tuple[Decision, History]:
        """Decide what follows the run. A failure makes nothing needless, but facts that have changed may."""
        context, progress, now, world = self._context, execution.progress, self._monitor.now(), snapshot(self._context.present)
        has_failed, limits, unusable = execution.is_over or execution.result.failures, context.settings.limits, context.unusable(history)
        set_off_by, better = execution.set_off_by, self._search.better_than(progress)
        policies = self._control.policy.policies if self._control.policy else ()
        is_stretch = execution.is_over and execution.result.goal and progress.plan.goal == TRUE != now.goal

        policy: Policy | None = None

        def decision() -> tuple[Decision, History]:
            nonlocal policy
            if is_stretch:
                policy, plan = followed(policies, now, world)
                return next_stretch(now, progress, world, replace(history, replans=self._log.history.replans), limits, unusable, plan)
            left = progress if has_failed else shortened(progress, world)
            decided, known = decide(now, left, world, history, limits, unusable)
            if has_failed or isinstance(decided, GiveUp):
                return decided, known
            if better and left is progress and isinstance(decided, ResumePlan):
                return BetterRest(better.why), self._log.history
            because = "; ".join(filter(None, (set_off_by, needless(progress, left, world))))
            return replace(decided, because=because), known

        decided, known = await self._control.in_thread(decision)
        if isinstance(decided, NextStretch) and decided.rest is not None:
            self._search.note_policy(policy)
        return decided, known

    async def _follower(self, execution: PlanExecution, decision: ResumePlan | PlanAgain | NextStretch) -> PlanGraph:
        if isinstance(decision, ResumePlan) and not execution.is_blocked:
            return decision.rest
        if isinstance(decision, NextStretch) and (rest := decision.rest) is not None:
            return await self._search.in_turn(partial(self._search.rest, rest))
        if self._given is None:

            def search() -> Awaitable[Plan | None]:  # what is forbidden is looked at anew: a value that a call lacked may be known by then
                return self._search.following(execution, self._context.forbidden(self._log.history))

            plan = await self._search.patiently(search, self._patience)
            assert plan is not None, "a plan that is searched for in turn is in no conflict"
            return await self._accepted(plan)
        if isinstance(decision, PlanAgain):
            raise TaskEnded(Code.CONDITION_LOST, decision.why)
        assert isinstance(decision, ResumePlan), "a plan that is given has no stretches"
        return await self._search.in_turn(partial(self._search.rest, decision.rest))

    async def _successor(
        self, execution: PlanExecution, decision: ResumePlan | PlanAgain | BetterRest, history: History, under_way: tuple[UnderWay, ...]
    ) -> PlanGraph | Outstanding:
        """Replace a run that goes on by that of another plan. Return the plan; what is still due if the run has to go on.

        If it does so while a plan is searched for, the plan is returned all the same. What is under way was so when the decision was made.
        """
        plan: Plan | None = None
        better = decision if isinstance(decision, BetterRest) else None
        try:
            if isinstance(decision, ResumePlan):
                graph = decision.rest
            else:
                if isinstance(decision, BetterRest):
                    plan = self._search.take_better(execution.progress)
                else:
                    self._control.enter(TaskState.REPLANNING, decision_words(decision))
                    plan = await self._search.following(execution, decision.forbidden)
                if plan is None:
                    return Outstanding.REPLACEMENT
                if not await execution.at_rest() and not execution.is_over:
                    return Outstanding.REPLACEMENT
                under_way = execution.under_way
                if not better:
                    self._note_plan(plan)
                graph = await self._graph(plan, under_way)
                if self._monitor.why_not(Progress.beginning(graph), self._context.forbidden(history)):
                    return Outstanding.REPLACEMENT
            successor = None if execution.is_over else await proved_machine(self._context, graph)
            if better and (execution.is_over or (await self._search.rest(graph))[0] is None):
                return Outstanding.NOTHING  # it is not needed any more, or in conflict with other tasks
            reserved = self._control.reserved if successor and not isinstance(decision, ResumePlan) else None
            goes_on = await execution.at_rest()
            # Nothing waits from here on: what others have begun, and what has ended, while the machine was made is all that there is.
            if execution.under_way != under_way or (reserved and self._context.scheduler.conflicts(self._context.task, reserved)):
                execution.call_attention_at(asyncio.get_running_loop().time())
                return Outstanding.REPLACEMENT
            if goes_on and successor:
                self._control.check()
                machine, result = execution.run.machine, execution.result
                if better and plan is not None:
                    self._context.observer.replanning(better, result)
                    self._note_plan(plan)
                execution.succeed(successor)
                self._follow(machine, result, decision, history)
                self._retry_at = None
        except (NoPlan, TaskEnded) as error:  # without what people have there may be a plan later, when others have come further
            return Outstanding.REPLACEMENT if isinstance(error, NoPlan) and error.hands else Outstanding.NOTHING
        except (NotProjectable, PlanGraphError, Unsound):  # what is under way may not fit into any plan
            return Outstanding.REPLACEMENT
        finally:
            self._control.enter(TaskState.RUNNING)
        return graph

    async def _accepted(self, plan: Plan) -> PlanGraph:
        """Note that a plan will be executed, and return its graph."""
        self._note_plan(plan)
        return await self._graph(plan)

    def _note_plan(self, plan: Plan) -> None:
        limits = self._context.settings.limits
        self._withdraw()
        self._log.plans += 1
        self._note_goal()
        self._monitor.limit.allow(limits.allowed(plan.makespan if plan.temporal else 0.0))
        self._context.observer.planned(plan)

    async def _graph(self, plan: Plan, under_way: tuple[UnderWay, ...] = ()) -> PlanGraph:
        now, made = self._monitor.now(), stretch_graph if self._given is None else plan_graph
        with self._context.task.stopwatch.of("translate"):
            return await self._control.until(asyncio.to_thread(made, now, plan, [one.call for one in under_way]))
