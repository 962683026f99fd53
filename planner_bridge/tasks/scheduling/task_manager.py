"""Several tasks at once, in one world with shared robots: goals with priorities; pause, resume, preempt, cancel.

A task makes way for one of higher priority that needs what it has, or whose plan is in conflict with its own: it is paused, and
goes on by itself when that one is over. Among equals who came first is served first.

All who listen to tasks, as one.
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
from planner_bridge.planning.plan_text import read_plan
from planner_bridge.tasks.context import Circumstances, Mission
from planner_bridge.tasks.goal_loop import Pursuit
from planner_bridge.tasks.plan_task import Recital
from planner_bridge.tasks.result import Stopwatch
from planner_bridge.tasks.scheduling.planning_queue import Turnstile
from planner_bridge.tasks.scheduling.preemption import Neighbourhood, Precedence
from planner_bridge.tasks.settings import OnChange, Settings
from planner_bridge.tasks.task import Begins, Doing, Task
from pnm.actions.backend import Backend
from pnm.core.execution.resources import Resources
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.conditions import TRUE, Condition
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.net.net import Marking
from pnm.errors import InputError
from pnm.knowledge.sources.source import Asker, Source
from pnm.language.runner import Performer
from pnm.tasks import Code, Moment, OnConflict, Status, Step, TaskEnding, TaskListener, TaskRefused, TaskState, Wanted


class Everybody(TaskListener):
    """Passes on what happens to all who listen. The mutable state is who does."""

    def __init__(self) -> None:
        self._listeners: list[TaskListener] = []

    def add(self, listener: TaskListener) -> Callable[[], None]:
        """Tell the listener from now on; return what stops that."""
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener)

    def changed(self, task: UUID) -> None:
        """Note that the status of a task is another one."""
        for one in tuple(self._listeners):
            one.changed(task)

    def planned(self, task: UUID) -> None:
        """Note that a task has another plan."""
        for one in tuple(self._listeners):
            one.planned(task)

    def happened(self, moment: Moment) -> None:
        """Note an event."""
        for one in tuple(self._listeners):
            one.happened(moment)

    def moved(self, task: UUID) -> None:
        """Note that tokens have moved."""
        for one in tuple(self._listeners):
            one.moved(task)

    def ended(self, task: UUID, ending: TaskEnding) -> None:
        """Note that a task is over."""
        for one in tuple(self._listeners):
            one.ended(task, ending)


_REMEMBERED: Final = 20
"""Tasks that are over and still told about."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Room:
    """How many tasks there may be.

    Args:
        active: that are pursued at the same time.
        queue: that wait besides.
        on_conflict: what to do about a goal that cannot be pursued beside others, if it does not say.
    """

    active: int = 20
    queue: int = 100
    on_conflict: OnConflict = OnConflict.PLAN_AROUND


class TaskMaster:
    """Pursues goals in one world, as `pnm.tasks.Tasks`.

    The mutable state is what the constructor sets under "state".

    Args:
        problem: the domain and the objects; what is true at first is not looked at any more.
        knowledge: what is known of the world; the site keeps it up to date.
        site: where actions are carried out, which is open.
        settings: planner, bindings, limits and policies.
        read_goal: finds out what a text means as a goal; raises InputError.
        source: who is asked and told what runs do not know.
        room: how many tasks there may be.
        performer: carries out the plans that are loaded; what its runs have for themselves is shared with all tasks.
    """

    def __init__(
        self,
        problem: Problem,
        knowledge: KnowledgeBase,
        site: Backend,
        settings: Settings,
        read_goal: Callable[[str], Condition],
        *,
        source: Source | None = None,
        room: Room | None = None,
        performer: Performer | None = None,
    ) -> None:
        self._problem = problem
        self._knowledge = knowledge
        self._site = site
        self._settings = settings
        self._read_goal = read_goal
        self._source = source
        self._room = room or Room()
        self._performer = performer
        self._resources = performer.resources if performer else Resources()
        self._prefix = performer.prefix if performer else os.urandom(4)
        self._loop = asyncio.get_running_loop()
        self._began = self._loop.time()
        # state
        self._tasks: dict[UUID, Task] = {}
        self._past: list[Task] = []
        self._doing: dict[UUID, asyncio.Task[None]] = {}
        self._everybody = Everybody()
        self._order = 0
        self._is_held = False
        self._turnstile: Turnstile[Task] = Turnstile(lambda task: task.rank)
        self._precedence = Precedence(self._tasks, self._resources, self._turnstile)
        self._everybody.add(_Watch(self._precedence))
        self._stop_listening = self._resources.listen(self._precedence.arrange)

    def __repr__(self) -> str:
        return f"<TaskMaster {len(self._tasks)} tasks>"

    # --- Tasks ----------------------------------------------------------------------------------

    def begin(self, wanted: Wanted, /) -> None:
        """Begin a task. Whatever is wrong with it ends it, with a code and a reason."""
        self._order += 1
        task = Task(wanted, self._order, self._everybody, self._loop.time)
        waiting = sum(one.doing is None for one in self._tasks.values())
        if wanted.id in self._tasks:
            self._end(task, TaskEnding(Code.ERROR, "there is a task of this id already"))
            return
        if waiting >= self._room.queue and self._is_full:
            self._end(task, TaskEnding(Code.QUEUE_FULL, f"{waiting} tasks are waiting already"))
            return
        try:
            task.begins = self._recital(task) if wanted.is_plan else self._goal(task)
        except InputError as error:
            self._end(task, TaskEnding(Code.INVALID_GOAL, str(error)))
            return
        self._tasks[task.id] = task
        if wanted.deadline is not None:
            task.deadline = self._loop.call_later(wanted.deadline, self._missed, task)
        task.is_held = self._is_held
        task.enter(TaskState.QUEUED)
        self._admit()

    async def pause(self, task: UUID | None, /, *, at_once: bool, why: str = "somebody has paused it") -> None:
        """Start nothing more of a task, or of all; return when nothing of it is under way."""
        if task is None:
            self._is_held = True
        chosen = self._chosen(task)
        reasons = [one.why if one.is_held else why for one in chosen]
        for one in chosen:
            one.is_held = True
            self._turnstile.leave(one)
        await asyncio.gather(*(one.pause(reason, at_once=at_once) for one, reason in zip(chosen, reasons, strict=True)))
        self._turnstile.changed()

    async def resume(self, task: UUID | None, /, *, but: Collection[UUID] = ()) -> None:
        """Let a task that was paused go on, or all but these."""
        chosen = [one for one in self._chosen(task) if one.id not in but]
        if task is None:
            self._is_held = False
        elif not chosen[0].is_held:
            raise TaskRefused(f"the task {task} was not paused")
        for one in chosen:
            one.is_held = False
            self._precedence.update(one)
        self._admit()

    async def cancel(self, task: UUID | None, /, *, why: str = "somebody has cancelled it") -> None:
        """End a task, or all; return when what was under way has confirmed it, or the limit for that has passed."""
        chosen = self._chosen(task)
        for one in chosen:
            self.stop(one, Code.CANCELLED, why)
        for one in chosen:
            await one.over.wait()

    def status(self) -> tuple[Status, ...]:
        """Return how all tasks that are not over are doing, in the order in which they are served, and those that ended last."""
        return tuple(one.status for one in (*sorted(self._tasks.values(), key=lambda one: one.rank), *self._past))

    def plan(self, task: UUID, /) -> tuple[int, tuple[Step, ...]]:
        """Return how many plans the task has had before, and how far its plan has come; nothing when it has none."""
        found = self._tasks.get(task)
        return (max(0, found.plans - 1), found.steps) if found else (0, ())

    def net(self, task: UUID, /) -> tuple[int, PetriNetMachine, Marking] | None:
        """Return how many nets the task has had before, the net that it has now, and where its tokens are."""
        found = self._tasks.get(task)
        return found.net if found else None

    def listen(self, listener: TaskListener, /) -> Callable[[], None]:
        """Tell the listener from now on; return what stops that."""
        return self._everybody.add(listener)

    # --- for whoever serves ---------------------------------------------------------------------

    def begin_anew(self, problem: Problem) -> None:
        """Pursue goals in the world of another problem from now on.

        Raises:
            InputError: there are tasks.
        """
        if self._tasks:
            raise InputError(f"there are {len(self._tasks)} tasks; they must be over before another problem is loaded")
        self._problem, self._began = problem, self._loop.time()

    def knowledge_of(self, request: UUID) -> tuple[Layered, Asker] | None:
        """Return what the run knows whose request this is, and whom it asks as; None when it is not, or no longer, open."""
        for task in self._tasks.values():
            run = task.doing.run if task.doing else None
            if run is not None and request in run.open_requests:
                return run.knowledge, Asker(run.id, task.wanted.text)
        return None

    async def close(self) -> None:
        """Cancel all tasks, and wait until they are over; leave them alone when that is cancelled."""
        for one in tuple(self._tasks.values()):
            self.stop(one, Code.CANCELLED, "whoever does the task is being shut down")
        try:
            for one in tuple(self._tasks.values()):
                await one.over.wait()
        except asyncio.CancelledError:
            for doing in self._doing.values():
                doing.cancel()
            raise
        finally:
            self._stop_listening()

    def stop(self, task: Task, code: Code, reason: str) -> None:
        """End a task, which may still have to confirm it."""
        if task.doing is not None:
            task.doing.stop(code, reason)
        else:
            self._end(task, TaskEnding(code, reason))

    # --- admission ------------------------------------------------------------------------------

    @property
    def _is_full(self) -> bool:
        return sum(one.doing is not None for one in self._tasks.values()) >= self._room.active

    def _admit(self) -> None:
        """Begin with those that wait, as far as there is room."""
        for task in sorted(self._tasks.values(), key=lambda one: one.rank):
            if task.begins and task.doing is None and not task.is_held and not self._is_full:
                task.doing, performing = task.begins()
                doing = self._doing[task.id] = self._loop.create_task(self._do(task, performing))
                doing.add_done_callback(partial(self._forget, task))

    def _goal(self, task: Task) -> Begins:
        """Return what pursues a goal.

        Raises:
            InputError: it is none.
        """
        goal = self._read_goal(task.wanted.text)
        task.meant = str(goal)
        return partial(self._pursuit, task, goal, None)

    def _recital(self, task: Task) -> Begins:
        """Return what carries out a plan: one that is loaded, or a text of calls.

        Raises:
            InputError: it is neither.
        """
        programs = self._performer.programs if self._performer else {}
        if self._performer and (task.wanted.text in programs or (programs and "(" not in task.wanted.text)):
            recital = Recital(self._performer, task)
            return lambda: (recital, recital.perform())
        if not self._problem.domain.actions:
            raise InputError("a plan that is sent as a text needs a domain with actions, and none is loaded")
        if task.wanted.parameters:
            raise InputError(f"a plan that is sent as a text has no parameters; found {', '.join(task.wanted.parameters)}")
        plan = read_plan(task.wanted.text, self._now())
        return partial(self._pursuit, task, TRUE, plan)

    def _now(self) -> Problem:
        return problem_now(self._problem, self._knowledge, self._loop.time() - self._began)

    def _pursuit(self, task: Task, goal: Condition, plan: Plan | None) -> tuple[Doing, Coroutine[None, None, TaskEnding]]:
        circumstances = Circumstances(
            task.id,
            task.wanted.text,
            task.wanted.priority,
            self._resources,
            self._source,
            Neighbourhood(task, self._tasks, self._precedence, self._turnstile),
            task.wanted.on_conflict or self._room.on_conflict,
            lambda: UUID(bytes=self._prefix + uuid4().bytes[4:]),
        )
        settings = self._settings if plan is None else replace(self._settings, on_change=OnChange.LAZY)
        knowledge = Layered(self._knowledge)
        problem = replace(self._now(), goal=goal)
        pursuit = Pursuit(Mission(problem, self._site, settings, task, Stopwatch(), knowledge, circumstances), given=plan)
        return pursuit, _pursued(pursuit)

    async def _do(self, task: Task, performing: Coroutine[None, None, TaskEnding]) -> None:
        ending = TaskEnding(Code.ERROR, "an error of whoever does the task; its log says more")
        try:
            ending = await performing
        except InputError as error:
            ending = TaskEnding(Code.PLANNER_ERROR, str(error))
        except Exception:
            _log.exception("%s cannot be done", task.name)
        finally:
            self._end(task, ending)

    def _forget(self, task: Task, _: object) -> None:
        self._doing.pop(task.id, None)

    def _end(self, task: Task, ending: TaskEnding) -> None:
        if self._tasks.get(task.id) is task:
            del self._tasks[task.id]
        self._turnstile.leave(task)
        self._past = [*self._past[1 - _REMEMBERED :], task]
        task.end(ending)
        self._turnstile.changed()
        self._precedence.changed(task.id)
        self._admit()

    def _missed(self, task: Task) -> None:
        self.stop(task, Code.DEADLINE_MISSED, f"the goal was not reached within {task.wanted.deadline:g} s")

    def _chosen(self, task: UUID | None) -> list[Task]:
        if task is None:
            return list(self._tasks.values())
        if task not in self._tasks:
            over = any(one.id == task for one in self._past)
            raise TaskRefused(f"the task {task} is over" if over else f"there is no task {task}")
        return [self._tasks[task]]


async def _pursued(pursuit: Pursuit) -> TaskEnding:
    result = await pursuit.pursue()
    return TaskEnding(result.code, result.reason)


class _Watch(TaskListener):
    """Looks at those that make way for a task whenever its status changes."""

    def __init__(self, precedence: Precedence) -> None:
        self.changed = precedence.changed  # type: ignore[method-assign]
