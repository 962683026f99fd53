"""Several tasks at once, in one world with shared robots: goals with priorities; pause, resume, preempt, cancel.

A task makes way for one of higher priority that needs what it has, or whose plan is in conflict with its own: it is paused, and
goes on by itself when that one is over. Among equals the first one is served first.
"""

from __future__ import annotations

import asyncio
import logging
import os
from collections.abc import Callable, Collection, Coroutine
from dataclasses import dataclass, replace
from functools import partial
from typing import Final
from uuid import UUID, uuid4

from planner_bridge.model.grounding import problem_now
from planner_bridge.model.plan import Plan
from planner_bridge.model.problem import Problem
from planner_bridge.tasks.context import TaskContext
from planner_bridge.tasks.goal_loop import GoalLoop
from planner_bridge.tasks.plan_task import PlanTask
from planner_bridge.tasks.result import Stopwatch, TaskResult, join_reasons
from planner_bridge.tasks.scheduling.planning_queue import PlanningQueue
from planner_bridge.tasks.scheduling.preemption import Preemption
from planner_bridge.tasks.scheduling.task_text import TaskText, read_text
from planner_bridge.tasks.settings import OnChange, Settings, TaskObserver
from planner_bridge.tasks.task import Task
from pnm.actions.backend import Backend
from pnm.broadcast import broadcast
from pnm.clock import stop_then_cancel
from pnm.core.execution.resources import Resources
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.conditions import TRUE, Condition
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.net.net import Marking
from pnm.errors import InputError
from pnm.knowledge.sources.source import Asker, Source
from pnm.language.runner import PlanRunner
from pnm.tasks import SHORT, Code, OnConflict, TaskEnding, TaskListener, TaskRefused, TaskState, TaskStatus, TaskStep, Wanted

_REMEMBERED: Final = 20
"""Tasks that are over and still listed."""

_log = logging.getLogger(__name__)


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


class TaskManager:
    """Carries out tasks in one world, as `pnm.tasks.Tasks`.

    The mutable state is what the constructor sets under "state".

    Args:
        problem: the domain and the objects of goals; its initial state is not looked at.
        knowledge: of the world; the backend keeps it up to date.
        backend: carries the actions out; it is open.
        settings: planner, bindings, limits and policies.
        read_goal: reads a goal; raises InputError.
        source: answers what runs do not know.
        limits: how many tasks there may be.
        runner: carries out the plans that are loaded; all tasks share its resources.
    """

    def __init__(
        self,
        problem: Problem,
        knowledge: KnowledgeBase,
        backend: Backend,
        settings: Settings,
        read_goal: Callable[[str], Condition],
        *,
        source: Source | None = None,
        limits: TaskLimits | None = None,
        runner: PlanRunner | None = None,
    ) -> None:
        self._problem = problem
        self._knowledge = knowledge
        self._backend = backend
        self._settings = settings
        self._read_goal = read_goal
        self._source = source
        self._limits = limits or TaskLimits()
        self._runner = runner
        self._resources = runner.resources if runner else Resources()
        self._prefix = runner.prefix if runner else os.urandom(4)
        self._loop = asyncio.get_running_loop()
        self._began = self._loop.time()
        # state
        self._tasks: dict[UUID, Task] = {}
        self._past: list[Task] = []
        self._work: dict[UUID, asyncio.Task[None]] = {}
        self._reading: set[asyncio.Task[None]] = set()
        self._listeners: list[TaskListener] = []
        self._order = 0
        self._is_held = False
        self._queue: PlanningQueue[Task] = PlanningQueue(lambda task: task.rank)
        self._preemption = Preemption(self._tasks, self._resources, self._queue)
        self._listeners.append(self._preemption)
        self._listener = broadcast(TaskListener, self._listeners)
        self._stop_listening = self._resources.listen(self._preemption.preempt_holders)

    def __repr__(self) -> str:
        return f"<TaskManager {len(self._tasks)} tasks>"

    # --- Tasks ----------------------------------------------------------------------------------

    def begin(self, wanted: Wanted, /) -> None:
        """Begin a task. Whatever is wrong with it ends it, with a code and a reason."""
        self._order += 1
        self._begin(Task(wanted, self._order, self._listener, self._loop.time))

    async def run(self, wanted: Wanted, observer: TaskObserver, stopwatch: Stopwatch) -> TaskResult:
        """Carry out a task and return its result. Cancelling this stops the task; cancelling it again leaves it alone.

        Args:
            wanted: what the task is about.
            observer: listens to the task.
            stopwatch: measures where its time goes.

        Raises:
            InputError: there is something wrong with the task; nothing was started.
        """
        self._order += 1
        task = Task(wanted, self._order, self._listener, self._loop.time, (observer,), stopwatch)
        self._begin(task)
        if work := self._work.get(task.id):
            await stop_then_cancel(work, lambda: self._stop(task, Code.CANCELLED, "cancelled"))
        if task.result is None:
            raise task.error or InputError(task.control.reason)
        return task.result

    async def pause(self, task: UUID | None, /, *, at_once: bool, why: str = "paused on request") -> None:
        """Start nothing more of a task, or of all; return when nothing of it is under way."""
        if task is None:  # tasks that come later begin paused as well
            self._is_held = True
        chosen = self._chosen(task)
        # A task that is paused already keeps its reason: it is not this request that stops it.
        reasons = [active_task.control.reason if active_task.is_held else why for active_task in chosen]
        for active_task in chosen:
            active_task.is_held = True
            self._queue.leave(active_task)
        await asyncio.gather(
            *(active_task.control.pause(reason, at_once=at_once) for active_task, reason in zip(chosen, reasons, strict=True))
        )
        self._queue.changed()

    async def resume(self, task: UUID | None, /, *, but: Collection[UUID] = ()) -> None:
        """Let a task that was paused go on, or all but these."""
        chosen = [active_task for active_task in self._chosen(task) if active_task.id not in but]
        if task is None:
            self._is_held = False
        elif not chosen[0].is_held:
            raise TaskRefused(f"the task {task} was not paused")
        for active_task in chosen:
            active_task.is_held = False
        self._preemption.update_all()  # not resumed directly, nor one after the other: which of them go on is decided for all at once
        self._admit()

    async def cancel(self, task: UUID | None, /, *, why: str = "cancelled on request") -> None:
        """End a task, or all; return when what was under way has confirmed it, or the limit for that has passed."""
        chosen = self._chosen(task)
        for active_task in chosen:  # all are asked to end before the first is waited for, so that they end side by side
            self._stop(active_task, Code.CANCELLED, why)
        for active_task in chosen:
            await active_task.control.over.wait()

    def status(self) -> tuple[TaskStatus, ...]:
        """Return the status of all tasks that are not over, in the order in which they are served, and of those that ended last."""
        return tuple(task.status for task in (*sorted(self._tasks.values(), key=lambda task: task.rank), *self._past))

    def plan(self, task: UUID, /) -> tuple[int, tuple[TaskStep, ...]]:
        """Return the number of plans that the task has had before, and the steps of its plan; none when it has none."""
        active_task = self._tasks.get(task)
        return (max(0, active_task.plans - 1), active_task.steps) if active_task else (0, ())

    def net(self, task: UUID, /) -> tuple[int, PetriNetMachine, Marking] | None:
        """Return the number of nets that the task has had before, the net that it has now, and its marking."""
        active_task = self._tasks.get(task)
        return active_task.net if active_task else None

    def listen(self, listener: TaskListener, /) -> Callable[[], None]:
        """Have a listener listen from now on; return what stops that."""
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener)

    # --- for the node ---------------------------------------------------------------------------

    def begin_anew(self, problem: Problem) -> None:
        """Pursue goals in the world of another problem from now on.

        Raises:
            InputError: there are tasks.
        """
        if self._tasks:
            raise InputError(f"there are {len(self._tasks)} tasks; they must be over before another problem is loaded")
        self._problem, self._began = problem, self._loop.time()

    def knowledge_of(self, request: UUID) -> tuple[Layered, Asker] | None:
        """Return the knowledge of the run that has sent a request, and as whom it asks; None unless the request is open."""
        for task in self._tasks.values():
            run = task.control.run
            if run is not None and request in run.open_requests:
                return run.knowledge, Asker(run.id, task.wanted.text)
        return None

    async def close(self) -> None:
        """Cancel all tasks, and wait until they are over; leave them alone when this is cancelled."""
        tasks = tuple(self._tasks.values())
        for reading in self._reading:
            reading.cancel()
        for task in tasks:
            self._stop(task, Code.CANCELLED, "the task manager is being shut down")
        try:
            for task in tasks:
                await task.control.over.wait()
        except asyncio.CancelledError:
            for work in self._work.values():
                work.cancel()
            raise
        finally:
            self._stop_listening()

    # --- beginning ------------------------------------------------------------------------------

    def _begin(self, task: Task) -> None:
        waiting = sum(not other.control.has_begun for other in self._tasks.values())
        if task.id in self._tasks:
            self._end(task, TaskEnding(Code.ERROR, "there is a task of this id already"))
            return
        if waiting >= self._limits.queue and self._is_full:
            self._end(task, TaskEnding(Code.QUEUE_FULL, f"{waiting} tasks are waiting already"))
            return
        programs = self._runner.programs if self._runner else {}
        read = partial(read_text, task.wanted, self._read_goal, programs, self._now() if task.wanted.is_plan else self._problem)
        if not (is_long := len(task.wanted.text) > SHORT):
            self._understand(task, read)
        if task.ending:
            return
        self._tasks[task.id] = task  # from here on the task is listed, and its deadline can end it even before it is admitted
        if task.wanted.deadline is not None:
            reason = f"the goal was not reached within {task.wanted.deadline:g} s"
            task.deadline = self._loop.call_later(task.wanted.deadline, self._stop, task, Code.DEADLINE_MISSED, reason)
        task.is_held = self._is_held
        task.entered(TaskState.QUEUED, "")
        if is_long:
            reading = self._loop.create_task(self._understand_beside(task, read))
            self._reading.add(reading)
            reading.add_done_callback(self._reading.discard)
        self._admit()

    async def _understand_beside(self, task: Task, read: Callable[[], TaskText]) -> None:
        """Read a long text in a thread; the task may be over meanwhile."""
        reading = asyncio.ensure_future(asyncio.to_thread(read))
        try:
            await asyncio.wait((reading,))
        finally:
            reading.cancel()
        if task.ending is None:
            self._understand(task, reading.result)
            self._admit()

    def _understand(self, task: Task, read: Callable[[], TaskText]) -> None:
        """Note what carries the task out, as its text says, or end it if that is wrong."""
        try:
            match read():
                case None:
                    assert self._runner is not None, "a loaded plan has a runner"
                    task.start = PlanTask(self._runner, self._context(task, TRUE)).carry_out
                case Plan() as plan:
                    task.start = lambda: GoalLoop(self._context(task, TRUE, on_change=OnChange.LAZY), given=plan).pursue()
                case goal:
                    task.goal = str(goal)
                    task.start = lambda: GoalLoop(self._context(task, goal)).pursue()
        except InputError as error:
            task.error = error
            self._end(task, TaskEnding(Code.INVALID_GOAL, str(error)))
        except Exception as error:
            _log.exception("%s cannot begin", task.name)
            task.error = error
            self._end(task, TaskEnding(Code.ERROR, f"{type(error).__name__}: {error}"))

    def _now(self) -> Problem:
        return problem_now(self._problem, self._knowledge, self._loop.time() - self._began)

    def _context(self, task: Task, goal: Condition, *, on_change: OnChange | None = None) -> TaskContext:
        return TaskContext(
            task,
            replace(self._now(), goal=goal),
            Layered(self._knowledge),
            self._backend,
            replace(self._settings, on_change=on_change or self._settings.on_change),
            self._resources,
            self._source,
            self._preemption,
            task.wanted.on_conflict or self._limits.on_conflict,
            lambda: UUID(bytes=self._prefix + uuid4().bytes[4:]),
        )

    @property
    def _is_full(self) -> bool:
        return sum(task.control.has_begun for task in self._tasks.values()) >= self._limits.active

    def _admit(self) -> None:
        for task in sorted(self._tasks.values(), key=lambda task: task.rank):
            if task.start and not task.control.has_begun and not task.is_held and not self._is_full:
                task.control.begin(TaskState.RUNNING if task.wanted.is_plan else TaskState.PLANNING)
                self._work[task.id] = self._loop.create_task(self._carry_out(task, task.start()))

    async def _carry_out(self, task: Task, work: Coroutine[None, None, TaskResult]) -> None:
        ending = TaskEnding(Code.ERROR, "an internal error; the log says more")
        try:
            task.result = await work
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
            reasons = join_reasons(stopped.reason if stopped else "", "what it runs is left alone")
            ending = TaskEnding(stopped.code if stopped else Code.CANCELLED, reasons)
            raise
        finally:
            del self._work[task.id]
            self._end(task, ending)

    # --- ending ---------------------------------------------------------------------------------

    def _stop(self, task: Task, code: Code, reason: str) -> None:
        """End a task, which may still have to confirm it."""
        if task.control.has_begun:
            task.control.stop(code, reason)
        else:
            self._end(task, TaskEnding(code, reason))

    def _end(self, task: Task, ending: TaskEnding) -> None:
        if self._tasks.get(task.id) is task:  # a task refused for its id must not remove the one that has this id
            del self._tasks[task.id]
        self._queue.leave(task)
        self._past = [*self._past[1 - _REMEMBERED :], task]
        task.end(ending)  # listed as past before its listeners know, so that they find it when they ask
        self._queue.changed()
        self._preemption.update_all()
        self._admit()

    def _chosen(self, task: UUID | None) -> list[Task]:
        if task is None:
            return list(self._tasks.values())
        if task not in self._tasks:
            over = any(past.id == task for past in self._past)
            raise TaskRefused(f"the task {task} is over" if over else f"there is no task {task}")
        return [self._tasks[task]]
