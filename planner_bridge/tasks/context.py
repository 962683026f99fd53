"""The context of a task: its problem, where its actions are carried out, what it shares with other tasks, and who makes way for whom."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from math import inf
from typing import Final, Generic, TypeVar
from uuid import UUID

from planner_bridge.model.guards import ForbiddenCall, calls_acquiring, calls_needing, calls_served_by
from planner_bridge.model.problem import Problem
from planner_bridge.model.progression import present_state, snapshot
from planner_bridge.ordering.interference import FootprintIndex, Forecast, ReadWriteSets, interference
from planner_bridge.tasks.control import TaskControl
from planner_bridge.tasks.replanning import History
from planner_bridge.tasks.settings import Settings, TaskObserver
from planner_bridge.tasks.task import Task
from pnm.core.execution.questions import EvaluationContext
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.conditions import conjuncts, evaluate, fluents, observed
from pnm.core.logic.expressions import UNKNOWN
from pnm.core.machine.bindings import Bindings, goal_data, with_parts
from pnm.core.machine.plan_graph import ActionCall
from pnm.core.resources import Hand, Resources, who_keeps
from pnm.errors import suggestion
from pnm.knowledge.source import Source
from pnm.language.runner import PlanRunner
from pnm.tasks import EVENTS, OnConflict, TaskListener, TaskRefused, TaskState, TraceEvent, TraceKind


@dataclass(frozen=True, slots=True)
class Conflict:
    """A task beside which a plan cannot be carried out.

    Args:
        footprint: what its plan still needs and changes.
        why: the fact or function in the way.
        yields: whether it has a lower priority, so that it can be preempted.
        until: the seconds from now after which it is expected to be out of the way.
    """

    task: UUID
    name: str
    footprint: ReadWriteSets
    why: str
    yields: bool = False
    until: float = inf

    def __str__(self) -> str:
        return f"{self.name}: {self.why}"


@dataclass(frozen=True)
class TaskContext:
    """A goal, and everything that is there to reach it.

    Args:
        problem: its goal, and all that does not change with the world; its initial state is not looked at.
        knowledge: of the runs of the task, over the world that all tasks share.
        runner: carries out plans that are loaded; its backend, resources, source and journal are those of all tasks.
        helper: the person who is asked for help when the task cannot go on; None for none.
        on_conflict: what to do about a goal that is in conflict with those of other tasks.
    """

    task: Task
    problem: Problem
    knowledge: Layered
    runner: PlanRunner
    settings: Settings
    helper: Source | None
    scheduler: Preemption
    on_conflict: OnConflict
    since: float | None = None
    """The time of the world in the problem, on the clock of the event loop, if the task does not begin here."""

    @property
    def control(self) -> TaskControl:
        """The control of the task."""
        return self.task.control

    @property
    def observer(self) -> TaskObserver:
        """All who listen to the task."""
        return self.task.observer

    @property
    def world(self) -> KnowledgeBase:
        """The knowledge that all tasks share."""
        return self.knowledge.world

    @property
    def present(self) -> KnowledgeBase:
        """The knowledge of the world, with the unreported start effects of running calls: the base for judging plans."""
        return present_state(self.world, self.scheduler.runs())

    def note(self, note: object) -> None:
        """Keep a note of the task in the journal, for a process that goes on with it."""
        self.runner.journal.noted(self.task.id, note)

    def unusable(self, history: History) -> Mapping[ForbiddenCall, str]:
        """Return the calls that would fail, and why: they need an action server, a resource or a value that is not to be had."""
        bindings = self.settings.bindings
        names = self.runner.resources.withheld_from(history.lacking)
        gone = history.absent_servers(self.settings.limits) | self.runner.backend.missing
        found = dict(self.in_hands)
        found |= {
            call: f"needs the action server {one}, which is missing"
            for one in gone
            for call in calls_served_by(self.problem, bindings, [one])
        }
        found |= {call: f"needs {one}, which is withheld" for one in names for call in calls_acquiring(self.problem, bindings, [one])}
        # With a source outside, something new may be known without a trace here.
        for action in history.uninformed if self.runner.source is None else ():
            binding, fields = bindings.of(action.name), self.runner.backend.client.goal_fields(action)
            if goal_data(action, binding, fields, EvaluationContext(self.knowledge, action, binding))[1]:  # fields without a value
                found[ForbiddenCall.of(action)] = "needs a value that is missing"
        state = self.present
        for action in history.refused:
            for part in (part for part in conjuncts(action.precondition) if evaluate(part, state) is UNKNOWN):
                counted = snapshot(state)
                counted.update({fluent: False for fluent in fluents(part, state) if state.value(fluent) is UNKNOWN})
                if evaluate(part, counted) is True:  # as planners count
                    found[ForbiddenCall.of(action, awaited=True)] = f"needs {part}, but {observed(part, state)}"
        return found

    @property
    def in_hands(self) -> Mapping[ForbiddenCall, str]:
        """The calls that need what people have in their hands, and the words for that."""
        taken, bindings = self.runner.hands.taken, self.settings.bindings
        return {
            call: f"needs {name}, which is {hand.words}"
            for name, hand in taken.items()
            for call in calls_needing(self.problem, bindings, [name])
        }

    def forbidden(self, history: History) -> frozenset[ForbiddenCall]:
        """Return the calls that no plan may use now."""
        return history.forbidden(self.settings.limits) | self.unusable(history).keys()


# --- preemption -----------------------------------------------------------------------------------
# Preemption: a task is paused while one of higher priority, with which it is in conflict, goes on.
#
# It goes on by itself as soon as none of those goes on (they are over, are paused by an operator, or only wait for answers) and nothing
# of them is under way any more.


_NAMED: Final = 10
"""So many names are listed in place of one that there is not."""
_SHORTEST: Final = 1.0
"""Seconds after which a task tries again at the earliest when others are expected to be out of its way."""


class Claims:
    """The claims of tasks in other processes of a fleet to what they share; here there is no other process."""

    def take(self, task: Task, needed: Callable[[], ReadWriteSets]) -> tuple[Conflict, ...] | None:
        """Claim for a task what its plan needs, besides what it has; return the conflicts if there are any: it has no more than before.

        None says that what it needs has changed just now, so that its plan may not work any more.
        """
        return ()

    def give(self, task: UUID) -> None:
        """Give back what a task has."""

    def others(self) -> tuple[Conflict, ...]:
        """Return the tasks in other processes that have claims."""
        return ()


class Preemption(TaskListener):
    """Finds the tasks that are in conflict with each other, and pauses and resumes those of lower priority.

    The mutable state is which tasks are being paused, whether one looks for a better plan, and what is known of the tasks without a look
    at all of them: an index of their plans, their running calls, their forecasts, and those of which it may be something else by now.

    Args:
        tasks: all that are not over.
        queue: where they wait for their turn to plan.
    """

    def __init__(self, tasks: Mapping[UUID, Task], resources: Resources, queue: PlanningQueue[Task]) -> None:
        self._tasks = tasks
        self._resources = resources
        self._queue = queue
        self._pausing: dict[UUID, asyncio.Task[None]] = {}
        self.thinking = asyncio.Lock()
        """Held by the one task that looks for a better plan while robots work."""
        self.claims = Claims()
        """Those of other processes; another one has to be there before the first task."""
        self._plans: FootprintIndex[Task] = FootprintIndex()
        self._running: dict[Task, tuple[ActionCall, ...]] = {}
        self._forecasts: dict[Task, Forecast] = {}
        self._moved: set[UUID] = set()

    # --- conflicts ------------------------------------------------------------------------------

    def conflicts(self, task: Task, footprint: Callable[[], ReadWriteSets]) -> tuple[Conflict, ...]:
        """Return the tasks that conflict with a plan of the task, because they are active or their pause has yet to take effect.

        `footprint` is called only if there are any.
        """
        self._look()
        if not self._plans.has_other(task):  # the footprint is computed only when needed: it walks through the whole plan
            return ()
        conflicts, needed = list[Conflict](), footprint()
        for other in self._others(task, sorted(self._plans.near(needed), key=lambda near: near.order)):
            its = other.control.footprint
            if its is not None and (why := interference(needed, its)):
                conflicts.append(Conflict(other.id, other.name, its, why, other.yields_to(task)))
        return tuple(conflicts)

    def new_conflicts(self, task: Task, footprint: Callable[[], ReadWriteSets]) -> tuple[Conflict, ...]:
        """Return the conflicts in which neither task has been preempted for the other yet."""
        # Between these the order is decided already; asking again would preempt them in a circle.
        settled = {other.id for other in _opponents(task)}
        return tuple(conflict for conflict in self.conflicts(task, footprint) if conflict.task not in settled)

    def forecasts(self, task: Task) -> Mapping[Task, Forecast]:
        """Return the forecasts of the plans of other active tasks that do not yield to this one."""
        self._look()
        now, found = asyncio.get_running_loop().time(), dict[Task, Forecast]()
        for other in (other for other in self._others(task, self._tasks.values()) if not other.yields_to(task)):
            known = self._forecasts.get(other)
            if known is None or known.until <= now:
                known = other.control.forecast
            if known is not None:
                found[other] = self._forecasts[other] = known
        return found

    def runs(self) -> Iterator[Run]:
        """Yield the current runs of all tasks."""
        return (run for task in self._tasks.values() if (run := task.control.run) is not None)

    def running_calls(self, task: Task) -> Mapping[Task, tuple[ActionCall, ...]]:
        """Return the calls of other tasks that have begun and not ended, also while such a task is stopped."""
        self._look()
        return {other: calls for other, calls in self._running.items() if other is not task}

    def _others(self, task: Task, among: Iterable[Task]) -> list[Task]:
        begun = (other for other in among if other is not task and other.control.has_begun and other.ending is None)
        return [other for other in begun if other.control.state is not TaskState.PAUSED]

    def join(self, task: Task) -> None:
        """Take a task in, which others may be in conflict with from now on, until it leaves."""
        task.control.replanned = partial(self._moved.add, task.id)

    def moved(self, task: UUID, moment: Callable[[], TraceEvent]) -> None:
        """Note that calls of a task may have begun or ended."""
        self._moved.add(task)

    def _look(self) -> None:
        moved, settling = [task for id in self._moved if (task := self._tasks.get(id))], set[UUID]()
        for task in moved:
            run = task.control.run
            if task.control.has_plan:
                self._plans.note(task, task.control.whole)
            else:
                self._plans.forget(task)
            self._running.pop(task, None)
            self._forecasts.pop(task, None)
            if run is not None and (calls := run.unsettled):
                self._running[task] = calls
            if run is not None and run.settling:  # which may be over without a firing
                settling.add(task.id)
        self._moved.clear()
        self._moved |= settling

    def release(self, task: Task) -> None:
        """Note that the task has no plan in mind any more: those that waited for it may try again.

        Nothing else tells them where its run has ended without a change of facts, and it may wait for its next turn behind them.
        """
        if task.control.execution is None:
            self.claims.give(task.id)
        if task.control.reserved is not None:
            task.control.reserve(None)
            asyncio.get_running_loop().call_soon(self._queue.changed)  # when it is in the queue itself, which goes by rank

    async def begin_turn(self, task: Task) -> None:
        """Wait for the turn of the task to plan, with no plan in mind; one whose attempt failed waits for a change first."""
        self.release(task)
        await self._queue.enter(task)

    def end_turn(self, task: Task, *, failed: bool, again: float = inf) -> None:
        """End the turn of the task to plan. After so many seconds it may try again though nothing is known to have changed."""
        self._queue.leave(task, failed=failed)
        if again < inf:
            asyncio.get_running_loop().call_later(max(again, _SHORTEST), self._queue.changed)

    # --- preempting -----------------------------------------------------------------------------

    async def preempt(self, task: Task, conflicts: tuple[Conflict, ...]) -> None:
        """Have the tasks of lower priority pause until this task is over; return when nothing of theirs is under way."""

        async def pause(other: Task) -> None:
            if other.control.state is TaskState.CANCELLING:  # it cannot be paused any more, but ends soon, which has the same effect
                await other.control.over.wait()
            self._set_preempted(other, task)
            if pausing := self._pausing.get(other.id):
                # Shielded: this task may be cancelled while the other one is being paused, which must be completed.
                await asyncio.shield(pausing)

        yielding = {conflict.task for conflict in conflicts if conflict.yields}
        await asyncio.gather(*(pause(other) for other in self._others(task, self._tasks.values()) if other.id in yielding))

    def preempt_holders(self) -> None:
        """Preempt the tasks that have what a claim of higher priority waits for."""
        # Only holders of something that this very claim needs: others of lower priority stay undisturbed.
        for higher, lower in dict.fromkeys((claim.task, held.task) for claim, held in self._resources.outranking()):
            if {higher, lower} <= self._tasks.keys():
                self._set_preempted(self._tasks[lower], self._tasks[higher])

    def _set_preempted(self, task: Task, other: Task) -> None:
        if other not in task.preempted_by and {task.id, other.id} <= self._tasks.keys():
            task.preempted_by.add(other)
            other.preempts.add(task)
            task.note(TraceKind.CONFLICT, "", f"makes way for {other.name}")
        self._update(task)

    def leave(self, task: Task) -> Iterable[Task]:
        """Return the opponents of a task that is over; they make way for it no longer, which `update` shows."""
        self._plans.forget(task)
        self._running.pop(task, None)
        self._forecasts.pop(task, None)
        opponents = task.preempted_by | task.preempts
        for other in opponents:
            other.preempted_by.discard(task)
            other.preempts.discard(task)
        return opponents

    def changed(self, task: UUID) -> None:
        """Decide again which tasks go on: this one may have ceased to, or have begun again."""
        self._moved.add(task)
        changed = self._tasks.get(task)
        if changed and (changed.control.is_paused or changed.preempted_by or changed.preempts):
            self.update([changed])

    def update(self, tasks: Iterable[Task]) -> None:
        """Pause and resume these tasks and their opponents, and theirs in turn, as they are preempted; those served first come first."""
        concerned, found = set[Task](), [*tasks]
        while found:
            if (task := found.pop()) not in concerned:
                concerned.add(task)
                found += (*task.preempted_by, *task.preempts)
        for task in _in_order(concerned):
            self._update(task)

    def _update(self, task: Task) -> None:
        # An operator's pause is stronger than preemption, and a task that is being cancelled is past both.
        if task.is_held or task.id not in self._tasks or task.control.state is TaskState.CANCELLING:
            return
        if not (why := self._why_paused(task)):
            task.control.resume()
        elif (task.is_active or task.control.reason != why) and task.id not in self._pausing:
            self._pausing[task.id] = asyncio.get_running_loop().create_task(self._pause(task))

    def _goes_on(self, task: Task) -> bool:
        """Return whether the task goes on, or is about to: it wants to, and makes way for none that does."""
        return task.wants_to_go_on and not any(map(self._goes_on, _in_order(task.preempted_by)))

    def _why_paused(self, task: Task) -> str:
        """Return why the task is not to go on now; empty when it is.

        Of two opponents one goes on. The other one is at rest before: a robot that is still at work for one gets no command of the other.
        """
        if preempting := [other.name for other in _in_order(task.preempted_by) if self._goes_on(other)]:
            return f"makes way for {', '.join(preempting)}"
        if not task.wants_to_go_on:
            ahead = [other.name for other in _opponents(task) if self._goes_on(other)]
            return f"waits for an answer, and {', '.join(ahead)} goes on meanwhile" if ahead else ""
        opponents = _opponents(task) if task.control.is_paused else ()
        working = [other.name for other in opponents if other.control.state is not TaskState.PAUSED]
        return f"waits until {', '.join(working)} has stopped" if working else ""

    async def _pause(self, task: Task) -> None:
        try:
            if (why := self._why_paused(task)) and not task.is_held:  # still
                self._queue.leave(task)
                await task.control.pause(why, at_once=any(map(self._goes_on, _in_order(task.preempted_by))))
        finally:
            del self._pausing[task.id]
        self._queue.changed()  # what the paused task kept from others is free now, so those that failed may try again
        self.update([task])  # another task may have preempted it meanwhile, or have waited for it


def _in_order(tasks: Iterable[Task]) -> list[Task]:
    return sorted(tasks, key=lambda task: task.rank)


def _opponents(task: Task) -> list[Task]:
    """Return the tasks that do not go on together with this one: one of the two is preempted for the other."""
    return _in_order(task.preempted_by | task.preempts)


# --- the planning queue ---------------------------------------------------------------------------
# One task plans after the other, and again after a change if it failed.
#
# A task in the queue keeps nothing from others, and has nothing under way. So tasks in the queue never wait for each other: each waits
# for one outside, and whatever ends that one's hold on things, its return to the queue included, is a change. After a change every task
# of the queue has its turn, however many before it have failed: the one behind them may be the one for which they all wait.


SLOW: Final = 1.0
"""Seconds after which the next task may plan beside one that is still planning."""

T = TypeVar("T")


class PlanningQueue(Generic[T]):
    """The tasks that want to plan, and those whose attempt failed, which wait for a change.

    The mutable state is both; the tasks that are planning, and which of them are slow or have been outdated by a change; and which of
    them were planning beside each attempt that failed.

    Args:
        rank: the task of the lowest rank plans first.
    """

    def __init__(self, rank: Callable[[T], tuple[int, int]]) -> None:
        self._rank = rank
        self._waiting: dict[T, asyncio.Future[None]] = {}
        self._waiting_for_change: set[T] = set()
        self._planning: dict[T, asyncio.TimerHandle] = {}
        self._slow: set[T] = set()
        self._outdated: set[T] = set()
        self._beside: dict[T, set[T]] = {}

    async def enter(self, task: T) -> None:
        """Wait for the turn of the task; one whose attempt failed waits for a change first."""
        turn: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._waiting[task] = turn
        # all tasks that come at this moment are in the queue before the first is admitted
        asyncio.get_running_loop().call_soon(self._admit)
        try:
            await turn
        finally:
            self._waiting.pop(task, None)

    def leave(self, task: T, *, failed: bool = False) -> None:
        """End the turn of the task, if it has the turn.

        If the world changed during the attempt, its failure does not count and the task may try again at once.
        """
        if task in self._planning:
            self._planning.pop(task).cancel()
            self._slow.discard(task)
            if failed and task not in self._outdated:
                self._waiting_for_change.add(task)
                self._beside[task] = {*self._planning}
            self._outdated.discard(task)
            # What this one had in mind may have been in the way of those that failed meanwhile, and is not any more.
            for other in [other for other, beside in self._beside.items() if task in beside]:
                self._waiting_for_change.discard(other)
                del self._beside[other]
            self._admit()

    def changed(self) -> None:
        """Let the tasks whose attempts failed try again."""
        self._waiting_for_change.clear()
        self._beside.clear()
        self._outdated = {*self._planning}  # they plan from a world that is no longer so; if they fail, that says nothing about the new one
        self._admit()

    def _admit(self) -> None:
        # One at a time, because each plan must respect those found before; a slow planner holds up the others only for a moment.
        if self._planning.keys() - self._slow:
            return
        ready = (task for task, turn in self._waiting.items() if task not in self._waiting_for_change and not turn.done())
        first = min(ready, key=self._rank, default=None)
        if first is not None:

            def admit_beside(slow: T = first) -> None:
                self._slow.add(slow)
                self._admit()

            self._planning[first] = asyncio.get_running_loop().call_later(SLOW, admit_beside)
            self._waiting[first].set_result(None)


# --- people who take robots over ------------------------------------------------------------------


class HandOver:
    """Has people take robots over, or other objects and resources, and give them back: nothing is sent to them meanwhile.

    Args:
        tasks: all that are not over.
    """

    def __init__(self, runner: PlanRunner, bindings: Bindings, tasks: Mapping[UUID, Task], queue: PlanningQueue[Task]) -> None:
        self._runner, self._bindings, self._tasks, self._queue = runner, bindings, tasks, queue

    async def take(self, problem: Problem, hand: Hand) -> str:
        """Leave something to a person; return what may still be at work, if it has not confirmed its end."""
        runner, name = self._runner, hand.name
        taken = runner.hands.taken
        if name in taken:
            raise TaskRefused(f"{taken[name]}; it has to be given back first")
        if wrong := self._unknown(problem, name):
            raise TaskRefused(wrong)
        self._put(hand, is_taken=True)
        going_on = [(executor, executor.run) for executor in runner.going_on]
        for executor, _ in going_on:
            executor.heed_hands()
        self._look_again()

        def needing(run: Run, calls: Iterable[ActionCall]) -> list[str]:
            return [str(call.action) for call in calls if run.bindings.named(call.action, (name,))]

        for executor, run in going_on:  # its requests pass to no other run
            while name in taken and executor.run is run and not executor.ended and needing(run, run.open_calls.values()):
                await executor.happens()
        self._look_again()  # what was cancelled waits from now on, which is to be said
        calls = [(run, one.call) for _, run in going_on for one in run.result_so_far().failures if one.unconfirmed]
        at_work = [one for run, call in calls if isinstance(call, ActionCall) for one in needing(run, [call])]
        withheld = {one: by for one, by in runner.resources.withheld.items() if name in (one, *one.split("/"))}
        unconfirmed = f"{', '.join(at_work)} may still be at work: the cancellation is not confirmed" if at_work else ""
        return "; ".join(filter(None, (unconfirmed, who_keeps(withheld))))

    async def give(self, problem: Problem, name: str) -> None:
        """Use again what a person has had; what sensors are asked for is asked for before."""
        runner = self._runner
        if (hand := runner.hands.taken.get(name)) is None:
            raise TaskRefused(self._unknown(problem, name) or f"{name} is in nobody's hands")
        await runner.backend.refresh()
        if name in runner.hands.taken:  # else somebody has given it back meanwhile
            self._put(hand, is_taken=False)
            own = [task.control.execution.executor for task in self._tasks.values() if task.control.execution]
            for executor in runner.going_on:
                if executor not in own:  # of a plan that a call has begun
                    executor.heed_hands()
            self._look_again()

    def _unknown(self, problem: Problem, name: str) -> str:
        """Return why nothing of this name can be in anybody's hands; empty if it can."""
        programs = self._runner.programs.values()
        objects = (one for names in self._runner.world.objects_by_type().values() for one in names)
        resources = with_parts(one for binding in self._bindings.actions.values() for one in binding.resources)
        known = dict.fromkeys((*problem.objects, *objects, *(one for one in resources if "{" not in one)))
        plans = ((program.plan.bindings, call.action) for program in programs for call in program.plan.graph.calls)
        if name in known or calls_needing(problem, self._bindings, [name]) or any(own.named(action, (name,)) for own, action in plans):
            return ""
        hint = suggestion(name, known) or f"expected one of {', '.join(list(known)[:_NAMED]) or 'none, for there are none'}"
        return f"there is no robot, object or resource {name!r}; {hint}"

    def _put(self, hand: Hand, *, is_taken: bool) -> None:
        self._runner.hands.put(hand, is_taken=is_taken)
        self._runner.journal.put(hand, is_taken=is_taken)
        EVENTS.warning("%s", hand if is_taken else f"{hand.name} is given back")

    def _look_again(self) -> None:
        for task in tuple(self._tasks.values()):
            if task.control.execution is not None:
                task.control.execution.look_again()
        self._queue.changed()
