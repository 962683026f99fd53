"""Several tasks at once, in one world with shared robots: goals with priorities; pause, resume, preempt, cancel.

A task makes way for one of higher priority that needs what it has, or whose plan is in conflict with its own: it is paused, and
goes on by itself when that one is over. Among equals the first one is served first.
"""

from __future__ import annotations

import asyncio
import logging
from bisect import insort
from collections.abc import Callable, Collection, Coroutine, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from operator import attrgetter
from time import time
from typing import Final
from uuid import UUID

from planner_bridge.model.grounding import later, problem_now
from planner_bridge.model.problem import Problem
from planner_bridge.tasks.context import HandOver, PlanningQueue, Preemption, TaskContext
from planner_bridge.tasks.control import TaskControl, Watchdog
from planner_bridge.tasks.result import Stopwatch, TaskResult, join_reasons
from planner_bridge.tasks.settings import OnChange, Settings, TaskObserver
from planner_bridge.tasks.task import StartTask, Task
from planner_bridge.tasks.task_start import TaskText, read_text, start_of
from pnm.clock import stop_then_cancel
from pnm.core.execution.events import broadcast
from pnm.core.knowledge_base import Layered
from pnm.core.logic.conditions import Condition
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.requests import NOT_REATTACHED, Ended, OutcomeKind, ReattachingClient, Report, Request
from pnm.core.net.net import Marking
from pnm.core.resources import Hand, who_keeps
from pnm.errors import InputError
from pnm.journal.kept import JournalError
from pnm.journal.replay import Replay, ReplayedTask
from pnm.knowledge.source import Source
from pnm.knowledge.sources import Sources
from pnm.language.runner import PlanRunner
from pnm.tasks import (
    REMEMBERED,
    SHORT,
    Code,
    OnConflict,
    TaskEnding,
    TaskListener,
    TaskOdds,
    TaskRefused,
    TaskState,
    TaskStatus,
    TaskStep,
    TraceKind,
    Wanted,
)

_log = logging.getLogger(__name__)


class TaskManager:
    """Carries out tasks in one world, as `pnm.tasks.Tasks`.

    The mutable state is what the constructor sets under "state".

    Args:
        problem: the domain and the objects of goals; its initial state is not looked at.
        runner: carries out the plans that are loaded; all tasks share its world, backend, which is open, resources, source and journal.
        read_goal: reads a goal; raises InputError.
        helper: the person who is asked for help when a task cannot go on; None for none.
    """

    def __init__(
        self,
        problem: Problem,
        runner: PlanRunner,
        settings: Settings,
        read_goal: Callable[[str], Condition],
        *,
        helper: Source | None = None,
        limits: TaskLimits | None = None,
    ) -> None:
        self._runner = runner
        self.settings: Final = settings
        self._read_goal = read_goal
        self._helper = helper
        self._limits = limits or TaskLimits()
        self._resources = runner.resources
        self._journal = runner.journal
        self._people = [source for source in (runner.source, helper) if isinstance(source, Sources)]
        self._loop = asyncio.get_running_loop()
        # state
        self._problem = problem
        self._began = self._loop.time()
        """The time at which the initial state of the problem was."""
        self._tasks: dict[UUID, Task] = {}
        """Those that are not over."""
        self._queued: list[Task] = []
        """Those of them that have not begun, in the order in which they are served."""
        self._past: list[Task] = []
        """Those that ended last."""
        self._work: dict[UUID, asyncio.Task[None]] = {}
        self._ending: set[UUID] = set()
        """Tasks that have ended, which is not kept yet."""
        self._beside: set[asyncio.Task[None]] = set()
        self._order = 0
        self._is_held = False
        self._queue: PlanningQueue[Task] = PlanningQueue(attrgetter("rank"))
        self._preemption = Preemption(self._tasks, self._resources, self._queue)
        self._hand_over = HandOver(runner, settings.bindings, self._tasks, self._queue)
        self._listeners: list[TaskListener] = [self._preemption]
        self._listener = broadcast(TaskListener, self._listeners)
        self._stop_listening = self._resources.listen(self._preemption.preempt_holders)
        for source in self._people:
            source.listeners.append(self._note_questions)

    def __repr__(self) -> str:
        return f"<TaskManager {len(self._tasks)} tasks>"

    def begin(self, wanted: Wanted, /) -> None:
        """Begin a task. Whatever is wrong with it ends it, with a code and a reason."""
        self._begin(self._new(wanted))

    def restore(self, replay: Replay, observers: tuple[TaskObserver, ...] = (), stopwatch: Stopwatch | None = None) -> None:
        """Go on with the tasks of another process, which has died: its knowledge and its resources are those of this task manager.

        The observers listen to all of them, and the stopwatch measures where their time goes.
        """
        self._began, self._is_held = replay.began, replay.is_held
        unreadable: list[tuple[Task, ReplayedTask, TaskEnding]] = []  # the problem, or the plans, are not those with which it was accepted
        for kept in replay.tasks.values():
            task = self._new(kept.accepted.wanted, kept.accepted.order, observers, stopwatch)
            task.restore(kept)
            if task.ending:
                self._remember(task)
            elif wrong := self._understand(task, self._reader(task), kept):
                unreadable.append((task, kept, wrong))
            else:
                task.is_held = kept.is_held
                self._list(task, time() - kept.accepted.wall)
                if task.start and any(replayed.run.begun for replayed in kept.runs):  # what it has begun may still go on
                    if task.is_held:
                        self._hold(task)
                    self._set_out(task, task.start)
        for task, kept, wrong in unreadable:  # when the others are there, for ends let those that wait begin
            for replayed in (one for one in kept.runs if not one.is_over):  # requests that are out are given up, and recalled
                self._journal.retired(replayed.run)
                replayed.run.retire()
            self._list(task, time() - kept.accepted.wall)
            self._end(task, wrong)
        self._recall(replay.withheld)
        self._admit()

    async def run(self, wanted: Wanted, observer: TaskObserver, stopwatch: Stopwatch, replay: Replay | None = None) -> TaskResult:
        """Carry out a task, or the one task of another process in its place, and return its result; raise an `InputError` if it is wrong.

        Cancelling this stops the task; cancelling it again leaves it alone.
        """
        observer.managed(self)
        if replay is None:
            task = self._new(wanted, None, (observer,), stopwatch)
            self._begin(task)
        else:
            self.restore(replay, (observer,), stopwatch)
            (id,) = (kept.accepted.wanted.id for kept in replay.unfinished)
            task = self._tasks.get(id) or next(past for past in self._past if past.id == id)  # it may have ended just now
            observer.restored()
        if work := self._work.get(task.id):
            await stop_then_cancel(work, lambda: self._stop(task, Code.CANCELLED, "cancelled"))
        if task.result is None:
            raise task.error or InputError(task.control.reason)
        return task.result

    async def pause(self, task: UUID | None, /, *, at_once: bool, why: str = "paused on request", is_kept: bool = True) -> None:
        """Start nothing more of a task, or of all; return when nothing of it is under way."""
        if task is None:  # tasks that come later begin paused as well
            self._is_held = True
        chosen = self._chosen(task)
        # A task that is paused already keeps its reason: it is not this request that stops it.
        reasons = [active_task.control.reason if active_task.is_held else why for active_task in chosen]
        for active_task in chosen:
            active_task.is_held = True
            self._queue.leave(active_task)
        for held in (*([None] if task is None else []), *(active_task.id for active_task in chosen)) if is_kept else ():
            self._journal.held(held, is_held=True)
        await asyncio.gather(*(one.control.pause(reason, at_once=at_once) for one, reason in zip(chosen, reasons, strict=True)))
        self._queue.changed()

    async def resume(self, task: UUID | None, /, *, but: Collection[UUID] = ()) -> None:
        """Let a task that was paused go on, or all but these."""
        chosen = [active_task for active_task in self._chosen(task) if active_task.id not in but]
        if task is None:
            self._is_held = False
            self._journal.held(None, is_held=False)
        elif not chosen[0].is_held:
            control = chosen[0].control
            why = f", {control.reason}" if control.reason else ""
            raise TaskRefused(f"the task {task} is not paused: it is {control.state.word}{why}")
        for active_task in chosen:
            active_task.is_held = False
            self._journal.held(active_task.id, is_held=False)
        self._preemption.update(chosen)  # not resumed directly, nor one after the other: which of them go on is decided for all at once
        self._admit()

    async def cancel(self, task: UUID | None, /, *, why: str = "cancelled on request") -> None:
        """End a task, or all; return when what was under way has confirmed it, or the limit for that has passed."""
        chosen = self._chosen(task)
        for active_task in chosen:  # all are asked to end before the first is waited for, so that they end side by side
            self._stop(active_task, Code.CANCELLED, why)
        for active_task in chosen:
            await active_task.control.over.wait()

    # --- people who take robots over --------------------------------------------------------------

    async def take(self, name: str, /, *, reason: str = "", by: str = "") -> str:
        """Leave a robot, or another object or resource, to a person; see `HandOver`."""
        return await self._hand_over.take(self._problem, Hand(name, time(), reason, by))

    async def give(self, name: str, /) -> None:
        """Use again what a person has had."""
        await self._hand_over.give(self._problem, name)

    def hands(self) -> tuple[Hand, ...]:
        """Return what people have in their hands."""
        return tuple(self._runner.hands.taken.values())

    def plans(self) -> Mapping[str, Mapping[str, object]]:
        """Return the hand-written plans that are loaded, with their parameters and the values that these have at first; None for none."""
        plans = {name: program.plan for name, program in self._runner.programs.items()}
        return {name: {known: plan.variables.get(known) for known in plan.parameters or ()} for name, plan in plans.items()}

    async def step(self, task: UUID, /) -> None:
        """Let one request of a task leave that an operator has paused; return when nothing is under way any more."""
        (chosen,) = self._chosen(task)
        if not chosen.is_held:
            raise TaskRefused(f"the task {task} is not paused on request")
        await chosen.control.step()
        self._queue.changed()

    def settle(self, request: UUID, /, *, is_done: bool) -> None:
        """Have a request that is under way count as succeeded or failed, because a person says so, once its server is done with it."""
        for task in self._tasks.values():
            if (execution := task.control.execution) and (call := execution.executor.run.open_calls.get(request)):
                if call.action.operation is not None:
                    raise TaskRefused(f"{call.action.operation} is about knowledge: no server does it")
                return execution.executor.settle(request, OutcomeKind.SUCCEEDED if is_done else OutcomeKind.ABORTED)
        raise TaskRefused("no call of a task has that request under way")

    def answer(self, question: UUID, text: str, /) -> None:
        """Answer a question to a person; raise a `SourceError` for a text that is no answer to it."""
        if not any(source.answer(question, text) for source in self._people):
            raise TaskRefused("this question is no longer open")

    def _note_questions(self) -> None:
        opened = [question for source in self._people for question in source.open_questions]
        for task in tuple(self._tasks.values()):
            task.asking(tuple(question for question in opened if question.asker.task == task.id))

    def answer_of(self, task: UUID, name: str, text: str, /) -> None:
        """Answer the question of a task, of this name unless it is empty; raise `TaskRefused` if not just one is open."""
        (asking,) = self._chosen(task)
        fitting = [one for one in asking.questions if name in ("", one.question.name)]
        if len(fitting) != 1:
            known = ", ".join(f"{one.question.name} ({one})" for one in asking.questions)
            expected = f"expected the name of one question: {known}" if known else "it asks nothing"
            raise TaskRefused(f"{expected}, in the task {asking.name}")
        (id,) = (one.asker.question for one in fitting)
        assert id is not None
        self.answer(id, text)

    def status(self) -> tuple[TaskStatus, ...]:
        """Return the status of all tasks that are not over, in the order in which they are served, and of those that ended last."""
        return tuple(task.status for task in (*sorted(self._tasks.values(), key=lambda task: task.rank), *self._past))

    def plan(self, task: UUID, /) -> tuple[int, tuple[TaskStep, ...]]:
        """Return the number of plans that the task has had before, and the steps of its plan; none when it has none."""
        active_task = self._tasks.get(task)
        return (max(0, active_task.plans - 1), active_task.steps) if active_task else (0, ())

    def net(self, task: UUID, /) -> tuple[int, PetriNetMachine, Marking] | None:
        """Return the number of nets that the task has had before, the net that it has now, and its marking."""
        return self._tasks[task].net if task in self._tasks else None

    def control_of(self, task: UUID) -> TaskControl | None:
        """Return the control of a task; None if it is over."""
        return self._tasks[task].control if task in self._tasks else None

    def foretell(self, task: UUID, odds: TaskOdds | None, at: float) -> None:
        """Note the odds of what is left of the plan of a task, and the time at which they are so."""
        if task in self._tasks:
            self._tasks[task].odds = (odds, at) if odds else None
            self._listener.changed(task)

    def listen(self, listener: TaskListener, /) -> Callable[[], None]:
        """Have a listener listen from now on; return what stops that."""
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener)

    def begin_anew(self, problem: Problem) -> None:
        """Pursue goals in another problem from now on; raise an `InputError` if there are tasks or withheld requests, or it is not kept."""
        if self._journal.blocked:
            raise InputError(self._journal.blocked)
        if busy := f"there are {number} tasks" if (number := len(self._tasks)) else who_keeps(self._resources.withheld):
            raise InputError(f"{busy}; that must be over before another problem is loaded")
        self._problem, self._began = problem, self._loop.time()

    async def close(self) -> None:
        """Cancel all tasks, and wait until they are over; leave them alone when this is cancelled."""
        tasks = tuple(self._tasks.values())
        for reading in self._beside:
            reading.cancel()
        for task in tasks:
            self._stop(task, Code.CANCELLED, "the task manager is being shut down")
        try:
            for task in tasks:
                if task.id not in self._ending:  # if that cannot be kept, the next process comes to the same end
                    await task.control.over.wait()
        except asyncio.CancelledError:
            for work in self._work.values():
                work.cancel()
            raise
        finally:
            self._stop_listening()

    def _chosen(self, task: UUID | None) -> list[Task]:
        """Return one task, or all that are not over; raise `TaskRefused` if there is no such task."""
        if task is None:
            return list(self._tasks.values())
        if task not in self._tasks:
            over = any(past.id == task for past in self._past)
            raise TaskRefused(f"the task {task} is over" if over else f"there is no task {task}")
        return [self._tasks[task]]

    def _remember(self, task: Task) -> None:
        self._past = [*self._past[1 - REMEMBERED :], task]

    # --- beginning ------------------------------------------------------------------------------

    def _new(
        self, wanted: Wanted, order: int | None = None, observers: tuple[TaskObserver, ...] = (), stopwatch: Stopwatch | None = None
    ) -> Task:
        order = self._order + 1 if order is None else order
        self._order = max(self._order, order)
        return Task(wanted, order, self._listener, self._loop.time, self._journal, observers, stopwatch or Stopwatch())

    def _begin(self, task: Task) -> None:
        task.note(TraceKind.GOAL, "", task.status.title)
        if task.id in self._tasks:
            self._end(task, TaskEnding(Code.ERROR, "there is a task of this id already"))
            return
        if (waiting := len(self._queued)) >= self._limits.queue and self._is_full:
            self._end(task, TaskEnding(Code.QUEUE_FULL, f"{waiting} tasks are waiting already"))
            return
        read = self._reader(task)
        if not (is_long := len(task.wanted.text) > SHORT) and (wrong := self._understand(task, read)):
            self._end(task, wrong)
            return
        try:
            self._journal.accepted(task.wanted, task.order)
        except JournalError as error:
            self._end(task, TaskEnding(Code.ERROR, str(error)))
            return
        task.is_held = self._is_held
        self._list(task, 0.0)
        if task.is_held:
            self._hold(task)
        if is_long:
            self._go_beside(self._understand_beside(task, read))
        self._admit()

    def _go_beside(self, work: Coroutine[None, None, None]) -> None:
        going = self._loop.create_task(work)
        self._beside.add(going)
        going.add_done_callback(self._beside.discard)

    def _list(self, task: Task, passed: float) -> None:
        """List a task, some seconds after it was accepted: from here on its deadline can end it, even before it is admitted."""
        self._tasks[task.id] = task
        self._preemption.join(task)
        insort(self._queued, task, key=lambda queued: queued.rank)
        if task.wanted.deadline is not None:
            reason = f"the goal was not reached within {task.wanted.deadline:g} s"
            left = max(0.0, task.wanted.deadline - passed)
            task.deadline = self._loop.call_later(left, self._stop, task, Code.DEADLINE_MISSED, reason)
        task.entered(TaskState.QUEUED, "")

    def _hold(self, task: Task) -> None:
        """Have a task be paused from the beginning."""
        task.control.hold()
        self._go_beside(task.control.pause("paused on request", at_once=False))

    async def _understand_beside(self, task: Task, read: Callable[[], TaskText]) -> None:
        """Read a long text in a thread; the task may be over meanwhile."""
        reading = asyncio.ensure_future(asyncio.to_thread(read))
        try:
            await asyncio.wait((reading,))
        finally:
            reading.cancel()
        if task.ending is None:
            if wrong := self._understand(task, reading.result):
                self._end(task, wrong)
            self._admit()

    def _understand(self, task: Task, read: Callable[[], TaskText], kept: ReplayedTask | None = None) -> TaskEnding | None:
        """Note the executor of the task, by its text; return its ending if that is wrong."""
        try:
            task.start = start_of(task, read(), partial(self._context, task), kept)
        except InputError as error:
            task.error = error
            return TaskEnding(Code.INVALID_GOAL, str(error))
        except Exception as error:
            _log.exception("%s cannot begin", task.name)
            task.error = error
            return TaskEnding(Code.ERROR, f"{type(error).__name__}: {error}")
        return None

    @property
    def _is_full(self) -> bool:
        return len(self._tasks) - len(self._queued) >= self._limits.active

    def _admit(self) -> None:
        for task in () if self._is_full else tuple(self._queued):
            if task.start and not task.is_held and not self._is_full:
                self._set_out(task, task.start)

    def _set_out(self, task: Task, start: StartTask) -> None:
        self._queued.remove(task)
        task.control.begin(TaskState.RUNNING if task.wanted.is_plan else TaskState.PLANNING)

        def end() -> None:  # in order; if that does not end it either, it is left alone
            _log.error("%s: %s", task.name, task.why_still)
            if task.control.stopped:
                task.is_abandoned = True
                self._work[task.id].cancel()
            else:
                self._stop(task, Code.ERROR, task.why_still)

        task.watchdog = Watchdog(task.control, end)
        self._work[task.id] = self._loop.create_task(self._carry_out(task, start))

    async def _carry_out(self, task: Task, start: StartTask) -> None:
        ending = TaskEnding(Code.ERROR, "an internal error; the log says more")
        try:
            task.result = await start()
            ending = task.result.ending()
        except InputError as error:
            task.error = error
            ending = TaskEnding(Code.INVALID_GOAL if task.wanted.is_plan else Code.PLANNER_ERROR, str(error))
        except Exception as error:
            task.error = error
            if not task.observers:  # which get the error themselves
                _log.exception("%s cannot be done", task.name)
        except asyncio.CancelledError:
            stopped = task.control.stopped
            reasons = join_reasons(stopped.reason if stopped else "", "its calls are left alone")
            ending = TaskEnding(stopped.code if stopped else Code.CANCELLED, reasons)
            if not task.is_abandoned:
                raise
        finally:
            del self._work[task.id]
            self._end(task, ending)

    # --- their contexts ---------------------------------------------------------------------------

    def _reader(self, task: Task) -> Callable[[], TaskText]:
        now = problem_now(self._problem, self._runner.world, self._elapsed()) if task.wanted.is_plan else self._problem
        return partial(read_text, task.wanted, self._read_goal, self._runner.programs, now)

    def _elapsed(self, at: float | None = None) -> float:
        return (self._loop.time() if at is None else at) - self._began

    def _context(self, task: Task, goal: Condition, kept: ReplayedTask | None, on_change: OnChange | None = None) -> TaskContext:
        runner = self._runner
        since = kept.replay.now if kept and kept.notes else None  # facts that change by themselves have done so until then
        return TaskContext(
            task,
            replace(later(self._problem, self._elapsed(since)), goal=goal),
            kept.runs[-1].run.knowledge if kept and kept.runs else Layered(runner.world),
            runner,
            replace(self.settings, on_change=on_change or self.settings.on_change),
            self._helper,
            self._preemption,
            task.wanted.on_conflict or self._limits.on_conflict,
            since,
        )

    def _recall(self, requests: Iterable[Request]) -> None:
        """Cancel requests that another process has given up; their resources are free when their servers say that they are over."""

        def hear(report: Report) -> None:
            if isinstance(report, Ended):
                self._journal.confirmed(report.request, self._resources)

        client = self._runner.backend.client
        for request in requests:
            if isinstance(client, ReattachingClient):
                client.reattach(request, hear, accepted=True)
                client.cancel(request.id)
            else:
                hear(Ended(request.id, NOT_REATTACHED))

    # --- ending ---------------------------------------------------------------------------------

    def _stop(self, task: Task, code: Code, reason: str) -> None:
        """End a task, which may still have to confirm it."""
        if task.control.has_begun:
            task.control.stop(code, reason)
        else:
            self._end(task, TaskEnding(code, reason))

    def _end(self, task: Task, ending: TaskEnding) -> None:
        """End a task; nobody hears of that before it is kept."""
        if self._tasks.get(task.id) is not task:  # it was never accepted, for the id is that of another one, say
            self._ended(task, ending)
        elif task.id not in self._ending:
            self._ending.add(task.id)
            ending = replace(ending, replans=task.replans)
            self._journal.over(task.id, ending, lambda: self._ended(task, ending))

    def _ended(self, task: Task, ending: TaskEnding) -> None:
        if self._tasks.get(task.id) is task:
            del self._tasks[task.id]
            self._ending.discard(task.id)
            if task in self._queued:
                self._queued.remove(task)
        opponents = self._preemption.leave(task)
        self._queue.leave(task)
        self._remember(task)
        task.end(ending)  # listed as past before its listeners know, so that they find it when they ask
        self._queue.changed()
        self._preemption.update(opponents)
        self._admit()


@dataclass(frozen=True, slots=True)
class TaskLimits:
    """The limits of a task manager.

    Args:
        active: the number of tasks that go on at the same time.
        queue: the number of tasks that wait besides.
        on_conflict: what to do about a goal that is in conflict with those of other tasks, if the goal does not specify it.
    """

    active: int = 20
    queue: int = 100
    on_conflict: OnConflict = OnConflict.PLAN_AROUND
