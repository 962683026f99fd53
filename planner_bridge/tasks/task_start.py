"""The text of a task: a goal, a plan that is sent, or the name of a plan that is loaded; and tasks that are such plans."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from math import inf
from pathlib import Path
from typing import Final, TypeAlias

from planner_bridge.model.grounding import problem_now
from planner_bridge.model.plan import Plan, read_plan
from planner_bridge.model.problem import Problem
from planner_bridge.ordering.interference import Forecast, ReadWriteSets, read_write_sets
from planner_bridge.tasks.context import TaskContext
from planner_bridge.tasks.goal_loop import GoalLoop
from planner_bridge.tasks.replanning import History
from planner_bridge.tasks.result import Episode, PlanResult, code_of_failures
from planner_bridge.tasks.settings import OnChange
from planner_bridge.tasks.task import StartTask, Task
from planner_bridge.yaml.reader import read
from pnm.actions.backend import schedule
from pnm.actions.prediction import Prediction
from pnm.core.logic.conditions import TRUE, Condition
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.plan_graph import ActionCall
from pnm.core.machine.requests import CallOutcome
from pnm.core.nature import Nature
from pnm.errors import InputError
from pnm.executor import Executor
from pnm.journal.replay import ReplayedTask
from pnm.language.runner import PlanRun
from pnm.tasks import Code, TaskState, Wanted

MAX_CALLS: Final = 1000
"""Calls of a plan that is sent as a text."""

TaskText: TypeAlias = Condition | Plan | None
"""A goal, a plan, or None for a plan that is loaded."""


def read_text(wanted: Wanted, read_goal: Callable[[str], Condition], loaded: Collection[str], now: Problem) -> TaskText:
    """Read the text of a task; raise an `InputError` if it is no goal, or no plan.

    Args:
        loaded: the names of the plans that are loaded.
        now: has the actions and objects of a plan as a text.
    """
    if not wanted.is_plan:
        return read_goal(wanted.text)
    if wanted.text in loaded or (loaded and "(" not in wanted.text):
        return None
    if not now.domain.actions:
        raise InputError("a plan that is sent as a text needs a domain with actions, and none is loaded")
    if wanted.parameters:
        raise InputError(f"a plan that is sent as a text has no parameters; found {', '.join(wanted.parameters)}")
    plan = read_plan(wanted.text, now)
    if len(plan.steps) > MAX_CALLS:
        raise InputError(f"the plan has {len(plan.steps)} calls; expected {MAX_CALLS} at most")
    return plan


def start_of(
    task: Task, text: TaskText, context: Callable[[Condition, ReplayedTask | None, OnChange | None], TaskContext], kept: ReplayedTask | None
) -> StartTask:
    """Return the executor of a task with this text; raise an `InputError` if there is no such plan, or it has no such parameter.

    Args:
        context: of the task, with a goal, as another process has left it, and with a time at which plans are looked at again.
    """
    match text:
        case None:
            return PlanTask(context(TRUE, None, None), kept).carry_out
        case Plan() as plan:
            return lambda: GoalLoop(context(TRUE, kept, OnChange.LAZY), given=plan, kept=kept).pursue()
        case goal:
            task.goal = str(goal)
            return lambda: GoalLoop(context(goal, kept, None), kept=kept).pursue()


# --- hand-written plans ---------------------------------------------------------------------------
# A hand-written plan carried out as a task.
#
# A recovery of the plan may end with `replan`: the plan has failed then, and a planner searches for another way to its goal.


class PlanTask:
    """The execution of a hand-written plan, as another process left it if there is `kept`, and of the plans of a planner that follow it.

    When it is paused at once, a plan that it calls is cancelled and begins anew later. An `InputError` says that there is no such plan,
    or that it has no such parameter.
    """

    def __init__(self, context: TaskContext, kept: ReplayedTask | None = None) -> None:
        wanted, observer, runner = context.task.wanted, context.observer, context.runner
        self._context = context
        self._kept = kept
        self._plan_run: PlanRun
        begun = [replayed for replayed in kept.runs if replayed.run.begun] if kept else []
        if begun:
            runner.kept |= {replayed.made.caller: replayed for replayed in begun if replayed.made.caller is not None}
            self._plan_run = runner.go_on_with(begun[0], wanted.text, observer)
        else:
            self._plan_run = runner.prepare_run(wanted.text, wanted.parameters, observer, task=wanted.id, priority=wanted.priority)

    async def carry_out(self) -> PlanResult:
        """Carry the plan out and return how it ended; raise an `InputError`, with nothing started, if a parameter has no value."""
        context, plan_run = self._context, self._plan_run
        program = plan_run.program
        with ExitStack() as cleanup:
            context.control.begin_execution(self)
            cleanup.callback(context.control.end_execution)
            context.control.limit_time(plan_run.limit)
            with context.control.waiting():
                await context.runner.check(plan_run)
                await context.runner.backend.refresh()
            context.observer.generated(program.machine, program.proof)
            context.control.enter(TaskState.RUNNING)
            self.look_again()
            origin = plan_run.executor.run.origin  # of a run with which another process has begun
            began = asyncio.get_running_loop().time() if origin is None else origin
            context.observer.began(began)
            reached = -inf if self._kept is None else self._kept.replay.now
            cleanup.callback(schedule(context.world, program.plan.timed, began, reached))
            if (declared := program.plan.declared).domain.nature:
                cleanup.callback(Prediction(Nature(declared), context.world).close)
            with context.task.stopwatch.of("execute"):
                run = await context.runner.execute(plan_run)
        stopped = context.control.stopped
        code = Code.GOAL_REACHED if run.goal else code_of_failures(run.failures)
        if run.stopped and not run.goal:
            code = stopped.code if stopped else Code.TIMED_OUT  # what else stops it is its own limit
        reason = stopped.reason if stopped and run.stopped and not run.goal else run.reason
        cause = "" if run.goal or run.stopped else run.failures[0].cause if run.failures else Cause.GOAL_FALSE
        episode, seconds = Episode(program.machine, run, called=plan_run.client.called), context.task.stopwatch.seconds
        results, variables = plan_run.results, plan_run.variables
        result = PlanResult(code, reason, 0, (episode,), seconds, began, results=results, variables=variables, cause=cause)
        if context.control.stopped or not any(failure.replan for failure in run.failures):
            return result
        return await self._replanned(result)

    # --- while it is carried out ------------------------------------------------------------------

    @property
    def executor(self) -> Executor:
        """The executor of the plan."""
        return self._plan_run.executor

    @property
    def needed(self) -> ReadWriteSets:
        """The needs and changes of all calls that the plan may still reach."""
        run = self.executor.run
        plan, calls = run.machine.plan, run.interim_result().calls
        is_flat = len(plan.every_step) == len(plan.calls)
        ended = {result.call.index for result in calls if result.ended is not None} if is_flat else set()
        return read_write_sets([call for call in plan.calls if call.index not in ended], plan.goal, self._context.world)

    @property
    def whole(self) -> ReadWriteSets | None:
        """None: the calls of the plan have arguments that only its run knows."""
        return None

    @property
    def forecast(self) -> Forecast | None:
        """None: the end of the needs of the plan depends on loops, choices and people."""
        return None

    def resume(self) -> None:
        """Go on after a pause."""
        self.executor.resume()

    def look_again(self) -> None:
        """Use what people have given back; what they have taken, the run knows already."""
        self.executor.heed_hands()
        self._context.control.await_hands(self.executor.needs_from_people)

    def why_no_step(self) -> str:
        """Return why nothing of the plan may begin now: others are at work with what it needs."""
        others = self._context.scheduler.conflicts(self._context.task, lambda: self.needed)
        return f"the plan is in conflict with {', '.join(other.name for other in others)}" if others else ""

    async def _replanned(self, result: PlanResult) -> PlanResult:
        """Have a planner find another way to the goal of the plan, from the world as it is now."""
        context = self._context
        context.observer.resigned(result.reason)
        asking = (failure.call for failure in result.failures if failure.replan)  # for another plan: they are given up
        given_up = (call.action for call in asking if isinstance(call, ActionCall))
        unconfirmed = (call_result.call.action for call_result in result.calls if call_result.kind is CallOutcome.UNCONFIRMED)
        history = History.of_plan(given_up, unconfirmed, context.settings.limits)
        try:
            plan = self._plan_run.program.plan
            if plan.goal == TRUE:
                raise InputError(f"the plan {plan.name} has no goal")
            if not plan.domain_file:
                raise InputError(f"the plan {plan.name} has no domain")
            contents = await context.control.in_thread(partial(read, Path(plan.domain_file)))
            described = replace(contents.problem or Problem(plan.name, contents.domain), timed=plan.timed)  # those still to come
            elapsed = asyncio.get_running_loop().time() - result.began
            problem = replace(problem_now(described, context.world, elapsed), goal=plan.goal)
            later = [replayed for replayed in self._kept.runs[1:] if replayed.made.caller is None] if self._kept else []
            is_kept = self._kept and (later or self._kept.notes)  # decided after it failed
            kept = replace(self._kept, runs=later) if self._kept and is_kept else None
            loop = GoalLoop(replace(context, problem=problem, since=None), history=history, kept=kept)
            rest = await loop.pursue()
        except InputError as error:
            return replace(result, reason=f"{result.reason}; no planner can be asked: {error}")
        return replace(
            result,
            code=rest.code,
            reason=rest.reason,
            plans=rest.plans,
            episodes=(*result.episodes, *rest.episodes),
            constraints=rest.constraints,
            preferences=rest.preferences,
        )
