"""Search for a plan that does not conflict with other tasks: queue, wait, preempt."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, partial
from math import inf
from typing import Final, TypeAlias, TypeVar, cast
from uuid import UUID

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.guards import ANY, ForbiddenCall, calls_served_by, forbid
from planner_bridge.model.plan import CancelToken, Plan, PlanningResult, PlanningStatus, Policy
from planner_bridge.model.problem import Problem
from planner_bridge.model.progression import NotProjectable, calls_of, projected_state, stretch
from planner_bridge.ordering.interference import (
    Forecast,
    ReadWriteSets,
    avoid_interference,
    awaited,
    optimistic_state,
    read_write_sets,
    with_forecasts,
)
from planner_bridge.ordering.robot_time import ExpectedTimes
from planner_bridge.planning.kairos import REHEARSAL
from planner_bridge.planning.solve import WORTH_IT, Improvement, can_be_improved, improvement, solve
from planner_bridge.tasks.constraint_monitor import TaskMonitor
from planner_bridge.tasks.context import Conflict, TaskContext
from planner_bridge.tasks.control import TaskEnded
from planner_bridge.tasks.plan_execution import PlanExecution
from planner_bridge.tasks.replanning import History, Progress
from planner_bridge.tasks.result import PolicyNote, notes_of
from planner_bridge.tasks.task import Task
from pnm.clock import in_own_thread, is_virtual
from pnm.core.execution.run_view import RunView
from pnm.core.logic.conditions import TRUE
from pnm.core.logic.expressions import fluent_text
from pnm.core.machine.plan_graph import ActionCall, PlanGraph
from pnm.errors import InputError
from pnm.journal.replay import ReplayedTask
from pnm.tasks import Code, OnConflict, TaskState

_ELSEWHERE: Final = 60.0
"""Seconds for which a task without a plan waits for servers that are at work on goals of other programs, or on forgotten ones."""
_RETURN: Final = 15.0
"""Seconds for which a task without a plan waits for action servers that are missing, or for facts of which nothing is known: how long
a robot takes to start."""
_LOOK: Final = 1.0
"""Seconds between two looks whether they still are."""
_HINT: Final = 0.1
"""Of the planner's time, the share to find whom a task with a plan waits for best: other tasks wait for its turn meanwhile."""
_NO_PLAN: Final = frozenset({PlanningStatus.UNSOLVABLE, PlanningStatus.NO_PLAN})

P = TypeVar("P", Plan, PlanGraph)
T = TypeVar("T")
Footprint: TypeAlias = Callable[[], ReadWriteSets]
Attempt: TypeAlias = Callable[[], Awaitable[tuple[P | None, tuple[Conflict, ...]]]]
"""Returns a plan that can be carried out beside those of other tasks, or the tasks with which all plans are in conflict."""


class NoPlan(Exception):
    """The planner has found no plan without the forbidden calls, and would find none without the other tasks.

    Args:
        busy: action servers that are at work on what this process has not asked for: while a robot moves, it is nowhere.
        missing: action servers that are not there, and without which there may be no plan.
        hands: robots, and other objects and resources, that people have in their hands, in words: with them there is a plan.
    """

    def __init__(
        self,
        result: PlanningResult,
        forbidden: frozenset[ForbiddenCall],
        busy: tuple[str, ...] = (),
        missing: tuple[str, ...] = (),
        hands: tuple[str, ...] = (),
    ) -> None:
        failed = sorted(str(call) for call in forbidden if ANY not in call.arguments and not call.awaited)
        awaited = sorted(str(call) for call in forbidden if call.awaited)
        lacking = sorted(str(call) for call in forbidden if ANY in call.arguments)
        without = [
            *([f" without {', '.join(failed)}, not to be tried again"] if failed else []),
            *([f" without {', '.join(awaited)}, for which too little is known"] if awaited else []),
            *([f" without {' and '.join(hands)}"] if hands else []),
            *(
                [f" without {', '.join(lacking)}, whose servers or resources are not to be had"]
                if lacking and not (missing or hands)
                else []
            ),
            *([f" without the action server {' and '.join(missing)}, which is missing"] if missing else []),
        ]
        meanwhile = f", while {', '.join(busy)} {'are' if len(busy) > 1 else 'is'} at work on goals of other programs" if busy else ""
        said_once = result.status is PlanningStatus.NO_PLAN and result.message
        reason = "" if missing or hands else f": {said_once or result.reason}"  # which is that the servers are missing
        super().__init__(f"no plan{' and'.join(without)}{meanwhile}{reason}")
        self.status = result.status
        self.busy = busy
        self.missing = missing
        self.hands = hands
        self.awaits = bool(missing or awaited)


@dataclass(frozen=True, slots=True)
class _SearchAhead:
    """A search that is begun before it is decided that there is to be a new plan; its token ends it, as the end of the task does."""

    problem: Problem
    answer: asyncio.Future[PlanningResult]
    stop: threading.Event

    def is_for(self, problem: Problem) -> bool:
        """Return whether its answer is one to this problem as well."""
        return self.problem == problem and self.problem.unknown == problem.unknown


@dataclass(frozen=True, slots=True)
class _EitherToken:
    """Is set when one of two is."""

    first: CancelToken
    second: CancelToken

    def is_set(self) -> bool:
        return self.first.is_set() or self.second.is_set()


class PlanSearch:
    """Searches for plans of one task.

    The mutable state is when the last search began, whether one has found a plan, and whether it is proved to be the best; a
    search that is ahead; the search for a better rest, and what it has found.
    """

    def __init__(self, context: TaskContext, monitor: TaskMonitor, kept: ReplayedTask | None = None) -> None:
        self._context = context
        self._control = context.control
        self._monitor = monitor
        self.origin = 0.0
        """The time from which the times of the plan count."""
        notes = notes_of(kept, PolicyNote) if kept else []
        self._noted: Policy | None = notes[-1].policy(context.problem) if notes else None
        self._control.policy = self._noted
        self._has_found = False
        self._ahead: _SearchAhead | None = None
        self._is_best = False
        self._improving: tuple[PlanGraph, asyncio.Task[None], threading.Event] | None = None
        self._better: Improvement | None = None

    def begin_ahead(self, history: History) -> None:
        """Begin to search while reports are waited for: if they bring nothing new, the answer is there sooner.

        Whether there will be a new plan at all is decided when they have come; this search may have been for nothing.
        """
        context = self._context
        if not context.world.longest_lag or self._control.stopped or history.given_up(context.settings.limits):
            return
        now, stop = forbid(self._monitor.now(), context.forbidden(history)), threading.Event()
        if self._ahead is None or not self._ahead.is_for(now):
            self.end_ahead()
            answer = asyncio.ensure_future(in_own_thread(self._searching(now, _EitherToken(self._control.planner_stop, stop))))
            answer.add_done_callback(lambda done: done.cancelled() or done.exception())  # which nobody may ask for
            self._ahead = _SearchAhead(now, answer, stop)

    def end_ahead(self) -> None:
        """End the search that is ahead, if there is one."""
        if self._ahead is not None:
            self._ahead.stop.set()
            self._ahead = None

    def improve(self, execution: PlanExecution, history: History) -> None:
        """Look for a better rest of the plan while it is carried out, unless that has begun."""
        plan, context, settings = execution.run.machine.plan, self._context, self._context.settings
        if self._improving and self._improving[0] is plan:
            return
        self.end_improving()
        is_wanted = not is_virtual() if settings.improve is None else settings.improve > 0.0
        if self._is_best or not (is_wanted and settings.memory.improves and can_be_improved(context.problem, settings.planner)):
            return
        stop, rates = threading.Event(), ExpectedTimes(settings.bindings, settings.learned, context.problem.init)
        token = _EitherToken(self._control.planner_stop, stop)
        find = partial(solve, timeout=settings.planner_timeout, cancel=token, bindings=settings.bindings, learned=settings.learned)

        async def keep_improving() -> None:
            """Look again whenever half of the rest is over; attention is called for when there is a better one."""
            left = 2.0 * WORTH_IT
            with suppress(TaskEnded):
                while left >= WORTH_IT:
                    await self._control.unpaused()
                    async with context.scheduler.thinking:
                        with suppress(NotProjectable):
                            state = projected_state(context.world, (execution.run,), context.scheduler.runs())
                            now, progress = forbid(self._monitor.now(state), context.forbidden(history)), execution.progress
                            under_way = execution.left(progress, rates.expected)
                            told = (now, under_way, progress.plan.calls, progress.to_begin, rates, settings.improve, find)
                            left, self._better = await in_own_thread(partial(improvement, *told))
                    if self._better is not None:
                        execution.call_attention_at(asyncio.get_running_loop().time())
                    await asyncio.sleep(left / 2.0)

        self._improving = plan, asyncio.ensure_future(keep_improving()), stop

    def better_than(self, progress: Progress) -> Improvement | None:
        """Return a better rest of the plan that has been found, if nothing has begun of what it replaces."""
        better, its = self._better, self._improving and self._improving[0]
        if better is None or progress.plan is not its:
            return None
        replaced = (progress.calls[call] for call in better.replaced)
        return better if all(result.started is None and not result.is_done for result in replaced) else None

    def take_better(self, progress: Progress) -> Plan | None:
        """Return the plan from now on with the better rest, which is not offered again; None if it does not fit any more."""
        better = self.better_than(progress)
        self._better = None
        return better.rest(progress.to_begin) if better else None

    def end_improving(self) -> None:
        """End the search for a better rest; what it has found does not count any more."""
        self._better = None
        if self._improving is not None:
            _, task, stop = self._improving
            stop.set()
            task.cancel()
            self._improving = None

    async def in_turn(self, attempt: Attempt[P]) -> P:
        """Repeat an attempt whenever it is the turn of this task, until it finds a plan; tasks of lower priority are preempted.

        Raises `TaskEnded` if the task was stopped, or is not to wait for other tasks.
        """
        context, control, task = self._context, self._control, self._context.task
        control.enter(TaskState.QUEUED)
        while True:
            await control.unpaused()  # before the turn is asked for: a paused task would keep the others from planning
            await control.until(context.scheduler.begin_turn(task))
            blocking: tuple[Conflict, ...] = ()
            try:
                while not (blocking or control.is_paused):
                    plan, conflicts = await attempt()
                    if control.is_paused:
                        break  # the plan may not work any more when the task goes on
                    if plan is not None:
                        return plan
                    # Tried again at once after preempting them: they have stopped somewhere, and the world is another one now.
                    if all(conflict.yields for conflict in conflicts):
                        await control.until(context.scheduler.preempt(task, conflicts))
                    else:
                        blocking = conflicts
            finally:
                until = min((conflict.until for conflict in blocking), default=inf)
                context.scheduler.end_turn(task, failed=bool(blocking), again=until)
            if blocking:
                reason = "; ".join(map(str, blocking))
                if context.on_conflict is OnConflict.REFUSE:
                    raise TaskEnded(Code.CONFLICT, reason)
                control.enter(TaskState.QUEUED, f"waits for {reason}")

    async def patiently(self, search: Callable[[], Awaitable[T]], patience: float) -> T:
        """Search for a plan; while there is none, wait for facts to change and search again, for these seconds.

        While servers are at work on what this process has not asked for, it waits longer, for `_ELSEWHERE` seconds; for those that are
        missing, or for what is not known, `_RETURN` seconds; and until people give back what they have in their hands.

        Raises:
            NoPlan: there is none, and it has waited long enough.
            TaskEnded: the task was stopped meanwhile.
        """
        control, loop, backend = self._control, asyncio.get_running_loop(), self._context.runner.backend
        changed, began, told = asyncio.Event(), None, ""
        unsubscribe = self._context.world.listen(lambda changes: changed.set() if changes else None)
        stop_listening = self._context.runner.hands.listen(changed.set)
        try:
            while True:
                changed.clear()
                hands = self._context.runner.hands.changes
                try:
                    return await search()
                except NoPlan as no_plan:
                    if hands != self._context.runner.hands.changes:  # it was searched for without what has been given back
                        continue
                    began = loop.time() if began is None else began
                    longer = _ELSEWHERE if no_plan.busy else _RETURN if no_plan.awaits else 0.0
                    until = inf if no_plan.hands else began + max(patience, longer)
                    if no_plan.status not in _NO_PLAN or loop.time() >= until:
                        raise
                    for_what = f"for {', '.join(no_plan.missing)}" if no_plan.missing else "for facts to change"
                    limit = "" if until == inf else f" {until - loop.time():g} s at most"
                    reason = f"waits{limit} {'until people give them back' if no_plan.hands else for_what}: {no_plan}"
                    control.enter(TaskState.QUEUED, reason)
                    if told != str(no_plan):  # once, however often it is looked at again because facts change
                        told = str(no_plan)
                        self._context.observer.blocked(reason)
                    if no_plan.hands:
                        control.await_hands(no_plan.hands)
                        await control.until(changed.wait())
                        control.await_hands(())
                    while not changed.is_set() and backend.missing.issuperset(no_plan.missing):
                        if await control.until(backend.busy_elsewhere()) != no_plan.busy:
                            break
                        if loop.time() >= until:
                            raise no_plan from None
                        with suppress(TimeoutError):
                            async with asyncio.timeout_at(min(until, loop.time() + _LOOK) if longer else until):
                                await control.until(changed.wait())
                await control.wait(self._context.settings.limits.backoff)  # facts seldom change alone, and some all the time
        finally:
            unsubscribe()
            stop_listening()

    async def following(self, execution: PlanExecution, forbidden: frozenset[ForbiddenCall]) -> Plan | None:
        """Find a plan from the state after what is under way; None if it is in conflict with those of other tasks, or the run has to go on.

        If there is none, that may be because what has just happened has not been reported yet: the second attempt is the last one.
        """
        world = self._context.world
        for is_last in (False, True):
            facts = world.facts()
            try:
                if await execution.at_rest():
                    return (await self.plan(forbidden, execution.run))[0]
                if not execution.is_over:
                    return None
                return await self.in_turn(partial(self.plan, forbidden))
            except NoPlan:
                if is_last:  # nothing new has been reported between the attempts, or it has not helped
                    raise
                await self._control.wait(world.longest_lag)
                self._control.check()
                if world.facts() == facts:
                    raise
        raise AssertionError("the last attempt finds a plan or fails")

    def note_policy(self, policy: Policy | None, *, is_new: bool = False) -> None:
        """Note the policy that the next calls come from, unless it is the one that was noted last: a better one may have been found."""
        if self._control.policy is not None:
            self._control.policy.follow(policy)
        if is_new or policy not in (None, self._noted):
            self._noted = policy
            self._context.note(PolicyNote.of(policy))

    # --- attempts -------------------------------------------------------------------------------

    async def plan(self, forbidden: frozenset[ForbiddenCall], run: RunView | None = None) -> tuple[Plan | None, tuple[Conflict, ...]]:
        """Attempt to find a plan with the planner.

        Args:
            run: one that goes on meanwhile, and is succeeded by another; None if there is none.

        Raises:
            NoPlan: there is none.
            TaskEnded: the task was stopped.
            NotProjectable: the state after the calls that are under way is not known.
            InputError: the planner refuses the problem, and has never found a plan for the task before.
        """
        context = self._context
        self._control.check()
        self.end_improving()
        if run is None:
            self._begin()
        going_on = [request.call for request in run.under_way()] if run else []
        state = self._monitor.now(projected_state(context.world, (run,), context.scheduler.runs()) if run and going_on else None)
        now = forbid(state, forbidden)
        context.scheduler.release(context.task)  # while it plans anew, the last plan must not keep others away
        context.observer.planning(context.settings.planner)
        running = context.scheduler.running_calls(context.task)  # now, and not when the planner has answered
        weighs = context.on_conflict is OnConflict.PLAN_AROUND
        forecasts = context.scheduler.forecasts(context.task) if weighs and now.is_timed and run is None else {}
        result, conflicts, needed = await self._solve(now), tuple[Conflict, ...](), cast("Footprint", ReadWriteSets)
        if result.plan is None:
            context.observer.unplanned(result)
        else:
            self._has_found, self._is_best = True, result.plan.is_best
            if (result.policy or self._control.policy) is not None:
                self._control.policy = result.policy
                self.note_policy(next(iter(result.policy.policies), None) if result.policy else None, is_new=True)
            needed = _needed(now, result.plan, going_on)
            conflicts = context.scheduler.conflicts(context.task, needed)
            if weighs and any(not conflict.yields for conflict in conflicts):
                result, needed, conflicts = await self._around(now, going_on, result, needed, conflicts)
        if forecasts and not (conflicts and all(conflict.yields for conflict in conflicts)):
            can_begin = result.plan is not None and not conflicts
            latest = result.plan.makespan if result.plan and can_begin else inf
            conflicts = await self._sooner(now, forecasts, latest, share=1.0 if result.plan is None else _HINT) or conflicts
        if result.plan is None and not conflicts:
            conflicts = await self._too_early(now, running, result) or await self._claimed(now, result)
        self._control.check()
        if result.plan is None and not conflicts:
            with self._control.waiting():
                busy = await context.runner.backend.busy_elsewhere()
            if result.status is PlanningStatus.UNSOLVABLE and (busy or context.runner.resources.given_up):  # not in the world that will be
                result = replace(result, status=PlanningStatus.NO_PLAN)
            bindings, missing = context.settings.bindings, sorted(context.runner.backend.missing)
            gone = [name for name in missing if not forbidden.isdisjoint(calls_served_by(context.problem, bindings, [name]))]
            raise NoPlan(result, forbidden, busy, tuple(gone), await self._from_people(state, forbidden, result))
        return self._reserved(result.plan, needed, conflicts or context.scheduler.conflicts(context.task, needed))

    async def given(self, plan: Plan) -> tuple[Plan | None, tuple[Conflict, ...]]:
        """Attempt to carry out a plan that is given."""
        self._control.check()
        self._begin()
        needed = _needed(self._monitor.now(), plan, [])
        return self._reserved(plan, needed, self._context.scheduler.conflicts(self._context.task, needed))

    async def rest(self, rest: PlanGraph) -> tuple[PlanGraph | None, tuple[Conflict, ...]]:
        """Attempt to carry out the rest of a plan."""
        context = self._context
        needed = cache(partial(read_write_sets, rest.calls, rest.goal, context.world))
        return self._reserved(rest, needed, context.scheduler.new_conflicts(context.task, needed))

    def _begin(self) -> None:
        self.origin = asyncio.get_running_loop().time()
        self._control.enter(TaskState.PLANNING)

    def _reserved(self, plan: P | None, needed: Footprint, conflicts: tuple[Conflict, ...]) -> tuple[P | None, tuple[Conflict, ...]]:
        """Reserve what a plan needs, unless it is in conflict. No await since these were looked for: of two tasks one sees the other."""
        found = conflicts or self._context.scheduler.claims.take(self._context.task, needed)
        if found != ():
            return None, found or ()
        self._control.reserve(needed)
        return plan, ()

    async def _too_early(
        self, now: Problem, running: Mapping[Task, tuple[ActionCall, ...]], result: PlanningResult
    ) -> tuple[Conflict, ...]:
        """Return the tasks after whose running calls there may be a plan: while a robot moves, it is nowhere."""
        if not running or result.status not in _NO_PLAN:
            return ()
        optimistic = optimistic_state(now, [call for calls in running.values() for call in calls])
        other = await self._solve(optimistic)
        if other.plan is None:
            return ()
        needed, world = read_write_sets(calls_of(optimistic, other.plan), now.goal, initial_knowledge(optimistic)), initial_knowledge(now)
        conflicts: list[Conflict] = []
        for task, calls in sorted(running.items(), key=lambda one: one[0].order):
            why = f"it has begun {', '.join(str(call.action) for call in calls)}"
            yields = task.yields_to(self._context.task)
            conflicts.append(Conflict(task.id, task.name, read_write_sets(calls, TRUE, world), why, yields))
        return tuple(conflict for conflict in conflicts if needed.disturbed_by(conflict.footprint)) or tuple(conflicts)

    async def _claimed(self, now: Problem, result: PlanningResult) -> tuple[Conflict, ...]:
        """Return the tasks in other processes after which there may be a plan: what they have claimed may be true then."""
        others = self._context.scheduler.claims.others() if result.status in _NO_PLAN else ()
        hoped = {fluent: True for other in others for fluent in other.footprint.writes if fluent[0] in now.domain.predicates}
        if not hoped or (await self._solve(replace(now, init={**now.init, **hoped}))).plan is None:
            return ()
        return others

    async def _from_people(self, now: Problem, forbidden: frozenset[ForbiddenCall], result: PlanningResult) -> tuple[str, ...]:
        """Return what people have in their hands, in words, if there is a plan with it."""
        hands = self._context.in_hands
        if not hands or result.status not in _NO_PLAN or (await self._solve(forbid(now, forbidden - hands.keys()))).plan is None:
            return ()
        return tuple(dict.fromkeys(why.removeprefix("needs ") for why in hands.values()))

    async def _sooner(self, now: Problem, forecasts: Mapping[Task, Forecast], latest: float, share: float) -> tuple[Conflict, ...]:
        """Return the tasks to wait for because the goal is reached before the latest time then; in seconds from now.

        The planner has a share of its time: all of it where there is no plan but one that waits.
        """
        at = asyncio.get_running_loop().time()
        if min((forecast.first for forecast in forecasts.values()), default=inf) - at >= latest:
            return ()
        expected = await in_own_thread(partial(with_forecasts, now, [*forecasts.values()], at))  # all of them take a while
        try:
            result = await self._solve(expected, share)
        except InputError:  # of a planner that knows no facts that change by themselves
            return ()
        if result.plan is None or result.plan.makespan >= latest:
            return ()
        needed, conflicts = read_write_sets(calls_of(expected, result.plan), now.goal, initial_knowledge(expected)), list[Conflict]()
        for task, forecast in forecasts.items():
            if needs := awaited(needed, forecast):
                why = f"it is expected to be done with {fluent_text(needs[0])} in {needs[1] - at:.0f} s"
                conflicts.append(Conflict(task.id, task.name, forecast.needed, why, until=needs[1] - at))
        return tuple(conflicts)

    async def _around(
        self, now: Problem, under_way: list[ActionCall], result: PlanningResult, needed: Footprint, conflicts: tuple[Conflict, ...]
    ) -> tuple[PlanningResult, Footprint, tuple[Conflict, ...]]:
        """Search for a plan that avoids the conflicts with tasks that do not yield, and those that it would bring itself."""
        avoided: dict[UUID, Conflict] = {}
        while new := {conflict.task: conflict for conflict in conflicts if conflict.task not in avoided and not conflict.yields}:
            avoided |= new
            other = await self._solve(avoid_interference(now, [conflict.footprint for conflict in avoided.values()]))
            if other.plan is None:
                return result, needed, tuple(avoided.values())
            its = _needed(now, other.plan, under_way)
            conflicts = self._context.scheduler.conflicts(self._context.task, its)
            if all(conflict.yields for conflict in conflicts):
                return other, its, conflicts
        return result, needed, conflicts

    async def _solve(self, problem: Problem, share: float = 1.0) -> PlanningResult:
        """Ask the planner, in a thread, for this share of the time that it has."""
        stop, ahead = self._control.planner_stop, self._ahead
        try:
            with self._context.task.stopwatch.of("plan"), self._control.waiting():
                if ahead is not None and ahead.is_for(problem):
                    self._ahead = None
                    return await ahead.answer
                self.end_ahead()
                return await in_own_thread(self._searching(problem, stop, share))
        except asyncio.CancelledError:
            stop.set()
            if cast("asyncio.Task[object]", asyncio.current_task()).cancelling():
                raise
            return PlanningResult(PlanningStatus.CANCELLED, message="the search was cancelled")  # itself, and not the task
        except InputError as error:
            if not self._has_found:
                raise
            return PlanningResult(PlanningStatus.INVALID, message=str(error))

    def _searching(self, problem: Problem, stop: CancelToken, share: float = 1.0) -> Callable[[], PlanningResult]:
        settings = self._context.settings
        # The planner may not take longer than the task has left.
        timeout = max(0.01, min(settings.planner_timeout * share, self._monitor.limit.left))
        planner, improve, executor = settings.planner, settings.improve, settings.executor
        if improve is None and is_virtual() and not (problem.domain.uncertain or problem.has_preferences):
            improve = REHEARSAL
        told = partial(solve, problem, bindings=settings.bindings, learned=settings.learned, before=self._control.policy)

        def search(limit: float) -> PlanningResult:
            found = told(planner=planner, timeout=limit, improve=improve, cancel=stop, executor=executor)
            return found if found.plan is None else replace(found, plan=stretch(problem, found.plan))

        return partial(settings.memory.plan, problem, timeout, search)


def _needed(now: Problem, plan: Plan, under_way: list[ActionCall]) -> Footprint:
    """Return the needs and changes of a plan, beside running calls."""
    return cache(lambda: read_write_sets((*under_way, *calls_of(now, plan)), now.goal, initial_knowledge(now)))
