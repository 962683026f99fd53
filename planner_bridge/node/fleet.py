"""The node of a part of a fleet: the robots of the part, and goals that come in at any node and are carried out by any."""

from __future__ import annotations

import asyncio
import logging
import re
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from time import sleep
from typing import Any, Final
from uuid import UUID

from planner_bridge.model.grounding import dynamic_names, initial_knowledge
from planner_bridge.model.problem import TOTAL_COST, TOTAL_TIME, Problem
from planner_bridge.node.node_journal import origin_of
from planner_bridge.node.options import Options
from planner_bridge.node.world_queries import SharedWorld, read_goals
from planner_bridge.ordering.interference import ReadWriteSets
from planner_bridge.tasks.context import Claims, Conflict
from planner_bridge.tasks.result import TASKS
from planner_bridge.tasks.task import Task
from planner_bridge.tasks.task_manager import TaskManager
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import fluents
from pnm.core.logic.effects import TimedChange
from pnm.core.logic.expressions import EXISTS, Fluent, Unknown, Value, fluent_text
from pnm.core.machine.bindings import Bindings
from pnm.errors import InputError, suggestion
from pnm.files.database.place import ServerUrl, place_of
from pnm.journal.fleet import Facts, Fleet, Part, TaskClaim
from pnm.journal.kept import DAY, JournalError
from pnm.tasks import Code, TaskEnding, TaskRefused, TaskState, TaskStatus, Wanted

_LOOK: Final = 1.0
"""Seconds at most until a part looks again for goals."""
_SOON: Final = 0.02
"""Seconds until it looks when something has changed here."""
_ANY_VALUE: Final[frozenset[bool | None]] = frozenset({None})
_WORD: Final = re.compile(r"[\w-]+")
_log = logging.getLogger(__name__)


class DealtRobots:
    """The robots of a fleet, dealt out to its parts in their order; a part knows its own only.

    Args:
        whole: the problem of the fleet.
        kind: the type of the robots.
        part: the one that is served here.
        goals: with names.

    Raises:
        InputError: there are no such robots, or the problem cannot be divided.
    """

    def __init__(self, whole: Problem, kind: str, part: Part, goals: Mapping[str, str]) -> None:
        robots = whole.objects_by_type.get(kind, ())
        if not robots:
            hint = suggestion(kind, whole.objects_by_type) or "expected a type of the domain that has objects"
            raise InputError(f"the fleet has no robots of the type {kind}; {hint}")
        self._part_of = {robot: index % part.count + 1 for index, robot in enumerate(robots)}
        self.part = part
        self._kind = kind
        self._knowledge = initial_knowledge(whole)
        self._world = SharedWorld(whole, self._knowledge, goals)
        others = {robot for robot, number in self._part_of.items() if number != part.number}
        self.problem = _without(whole, others)
        self.goals = {name: text for name, text in goals.items() if self._parts_of(name) <= {part.number}}
        for (what, choices), (_, own) in zip(whole.ranges(), self.problem.ranges(), strict=True):
            if choices != own and what != "the goal":
                raise InputError(f"{what} is about every {kind}, and a part of a fleet knows its own only; expected no such quantifier")
        about = " ".join(map(str, (whole.constraints, whole.preferences, whole.metric, whole.network)))
        if named := self._part_of.keys() & {*whole.domain.constants, *_WORD.findall(about)}:
            raise InputError(f"{min(named)} is named by the domain, or by a constraint: that cannot be divided among the parts of a fleet")
        self._changing = dynamic_names(whole) - {TOTAL_COST, *TOTAL_TIME} | {EXISTS}

    @classmethod
    def of(cls, whole: Problem, options: Options) -> DealtRobots:
        """Deal out the robots as the options of a node say; raise an `InputError` if that cannot be."""
        assert options.part
        return cls(whole, options.robots, options.part, read_goals(options.goals) if options.goals else {})

    def is_shared(self, fluent: Fluent) -> bool:
        """Return whether parts share a fact: actions change it, and it is about no robot."""
        return fluent[0] in self._changing and self._part_of.keys().isdisjoint(fluent)

    def check(self, bindings: Bindings) -> None:
        """Raise an `InputError` if actions of robots of several parts have a resource in common."""
        for action in self.problem.domain.actions.values():
            own = {f"{{{one.name[1:]}}}" for one in action.parameters if self.problem.domain.matches(one.types, (self._kind,))}
            for resource in bindings.of(action.name).resources:
                if not any(name in resource for name in own):
                    names = " or ".join(sorted(own)) or f"a {self._kind}"
                    raise InputError(f"the resource {resource} of {action.name} is not that of a robot; expected {names} in its name")

    def target(self, wanted: Wanted) -> int:
        """Return the part that has the robots of a task, 0 if it names none; raise an `InputError` if they are of several."""
        parts = self._parts_of(wanted.text) if not wanted.is_plan else self._among(_WORD.findall(wanted.text))
        if len(parts) > 1:
            raise InputError(f"it is about robots of the parts {', '.join(map(str, sorted(parts)))}; expected robots of one part")
        return min(parts, default=0)

    def _parts_of(self, goal: str) -> set[int]:
        mentioned = fluents(self._world.read_goal(goal), self._knowledge)
        return self._among(name for fluent in mentioned for name in fluent)

    def _among(self, names: Any) -> set[int]:
        return {self._part_of[name] for name in names if name in self._part_of}


def _without(problem: Problem, others: set[str]) -> Problem:
    """Return the problem without these objects, and what is said about them."""

    def known(facts: Mapping[Any, Any]) -> dict[Any, Any]:
        return {fluent: value for fluent, value in facts.items() if others.isdisjoint((*fluent, value))}

    timed = (TimedChange(change.time, changes) for change in problem.timed if (changes := known(change.changes)))
    objects = {name: types for name, types in problem.own_objects.items() if name not in others}
    return replace(problem, own_objects=objects, init=known(problem.init), timed=tuple(timed))


class FleetClaims(Claims):
    """The facts that a part shares with others, and the claims of its tasks to them.

    The mutable state is whether facts are recorded that come from other parts.

    Args:
        is_due: is called when there is something for others.
    """

    def __init__(self, fleet: Fleet, world: KnowledgeBase, is_shared: Callable[[Fluent], bool], is_due: Callable[[], None]) -> None:
        self._fleet = fleet
        self._world = world
        self._is_shared = is_shared
        self._is_due = is_due
        self._is_told = False
        known = world.facts()
        fleet.changed({fluent: known.get(fluent, False) for fluent in fleet.claimed})
        world.listen(self._changed)

    def record(self, facts: Facts) -> None:
        """Record what other parts have changed; what is sensed here is known better."""
        self._is_told = True
        try:
            self._world.update({fluent: value for fluent, value in facts.items() if not self._world.is_sensed(fluent)})
        finally:
            self._is_told = False

    def _changed(self, changes: Mapping[Fluent, Value | Unknown]) -> None:
        if not self._is_told and (shared := {fluent: value for fluent, value in changes.items() if self._is_shared(fluent)}):
            self._fleet.changed(shared)
            self._is_due()

    def take(self, task: Task, needed: Callable[[], ReadWriteSets]) -> tuple[Conflict, ...] | None:
        """Claim what a plan reads and writes of the shared facts."""
        sets = needed()
        reads, writes = ({*filter(self._is_shared, names)} for names in ((*sets.reads, *sets.facts), sets.writes))
        if not (reads or writes):
            return ()
        try:
            against, facts = self._fleet.claim(task.id, reads, writes)
        except JournalError as error:
            return (Conflict(task.id, "the fleet", ReadWriteSets(), str(error), until=_LOOK),)
        self.record(facts)
        return _conflicts(against) or (None if (reads | writes) & facts.keys() else ())

    def give(self, task: UUID) -> None:
        """Give back what a task has."""
        self._fleet.give(task)
        self._is_due()

    def others(self) -> tuple[Conflict, ...]:
        """Return the tasks of other parts that have claims."""
        try:
            return _conflicts(self._fleet.others())
        except JournalError:
            return ()


def _conflicts(claims: Iterable[TaskClaim]) -> tuple[Conflict, ...]:
    """Return the conflicts with the tasks that have these claims."""
    found: dict[UUID, Conflict] = {}
    for task, part, fluent, writes in claims:
        name, why = f"{task.hex[:8]} of part {part}", f"it has claimed {fluent_text(fluent)}"
        before = found.get(task, Conflict(task, name, ReadWriteSets(), why, until=_LOOK))
        written = {**before.footprint.writes, fluent: _ANY_VALUE} if writes else before.footprint.writes
        found[task] = replace(before, footprint=ReadWriteSets(reads=before.footprint.reads | {fluent}, writes=written))
    return tuple(found.values())


def open_fleet(options: Options) -> Fleet:
    """Open the fleet of which a node serves a part; raises as `Fleet` does."""
    place, part = place_of(options.journal), options.part
    assert isinstance(place, ServerUrl)
    assert part
    return Fleet(place, TASKS, part, f"{origin_of(options)} {options.robots}", options.keep_days * DAY)


class FleetManager(TaskManager):
    """The task manager of a part: tasks that come in here are kept for all parts, and carried out by the one that takes them.

    The mutable state is, besides, the tasks that came in here and are not over; the one that is being begun; and whether it is due to
    look for news, and could do so last.
    """

    def __init__(self, robots: DealtRobots, fleet: Fleet, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._fleet = fleet
        self._target = robots.target
        self._is_due = False
        self._claims = self._preemption.claims = FleetClaims(fleet, self._runner.world, robots.is_shared, self._look_soon)
        self._came_in: dict[UUID, tuple[Wanted, asyncio.Event]] = {}
        self._beginning: UUID | None = None
        self._is_well = True

    def begin(self, wanted: Wanted, /) -> None:
        """Keep a task for a part that takes it. Whatever is wrong with it ends it, with a code and a reason."""
        code, why = Code.QUEUE_FULL, f"{self._limits.queue} tasks are waiting already, or there is one of this id"
        try:
            is_kept = self._fleet.add(wanted, self._target(wanted), self._limits.queue)
        except InputError as error:
            is_kept, code, why = False, Code.INVALID_GOAL, str(error)
        except JournalError as error:
            is_kept, code, why = False, Code.ERROR, str(error)
        if is_kept:
            self._came_in[wanted.id] = wanted, asyncio.Event()
        else:
            self._listener.ended(wanted.id, TaskEnding(code, why))

    def begin_anew(self, problem: Problem) -> None:
        """Refuse another problem: the other parts have this one."""
        raise InputError("a part of a fleet keeps its problem; expected another fleet, by another ?name= of the journal")

    def go_on(self) -> list[tuple[Wanted, TaskEnding | None]]:
        """Return the tasks that came in here in another process, and how those have ended that are over."""
        tasks = self._fleet.of_door()
        self._came_in |= {wanted.id: (wanted, asyncio.Event()) for wanted, ending in tasks if ending is None}
        return tasks

    async def attend(self) -> None:
        """Look for news, as long as the node lives."""
        while True:
            self._look()
            try:
                await asyncio.to_thread(self._fleet.wait, _LOOK)
                self._is_well = True
            except JournalError as error:
                if self._is_well:
                    _log.warning("%s; meanwhile no tasks are shared", error)
                self._is_well = False
                await asyncio.to_thread(sleep, _LOOK)

    async def cancel(self, task: UUID | None, /, *, why: str = "cancelled on request") -> None:
        """End a task, wherever it is carried out; or all that are carried out here, and all that came in here."""
        elsewhere = [one for one in self._came_in if one not in self._tasks and task in (None, one)]
        ends = [self._came_in[one][1] for one in elsewhere]
        try:
            for one in elsewhere:
                self._fleet.cancel(one, TaskEnding(Code.CANCELLED, why))
        except JournalError as error:
            raise TaskRefused(str(error)) from error
        if task is None or not elsewhere:
            await super().cancel(task, why=why)
        await asyncio.gather(*(end.wait() for end in ends))

    async def close(self) -> None:
        """Cancel all tasks that are carried out here, and leave the fleet."""
        try:
            await super().close()
        finally:
            self._fleet.close()

    def status(self) -> tuple[TaskStatus, ...]:
        """Return the status of all tasks that are here, and of those that came in here and are not."""
        elsewhere = (
            TaskStatus(wanted.id, wanted.text, wanted.priority, TaskState.QUEUED, "waits for a part of the fleet, or is carried out by one")
            for wanted, _ in self._came_in.values()
            if wanted.id not in self._tasks
        )
        return (*super().status(), *elsewhere)

    def _end(self, task: Task, ending: TaskEnding) -> None:
        if task.id == self._beginning and self._journal.blocked:
            return  # it was not accepted, and is begun again where the journal can be written
        super()._end(task, ending)

    def _ended(self, task: Task, ending: TaskEnding) -> None:
        super()._ended(task, ending)
        if task.id == self._beginning:  # it was refused, of which no journal knows
            with suppress(JournalError):  # it is begun again, and refused again
                self._fleet.refuse(task.id, ending)
        self._is_over(task.id)
        self._claims.give(task.id)

    def _look_soon(self) -> None:
        """Look in a moment, when there may be more to look for."""
        if not self._is_due:
            self._is_due = True
            self._loop.call_later(_SOON, self._look)

    def _is_over(self, task: UUID) -> None:
        if task in self._came_in:
            self._came_in.pop(task)[1].set()

    def _look(self) -> None:
        """Take tasks if there is room for them, and hear how those have ended that came in here."""
        self._is_due = False
        if self._journal.blocked or not self._journal.may_act():
            return
        room = 0 if self._is_held else max(0, self._limits.active - len(self._tasks))
        try:
            news = self._fleet.look(room)
        except JournalError:
            return  # which `attend` says
        self._claims.record(news.facts)
        for self._beginning, wanted in ((wanted.id, wanted) for wanted in news.taken):
            super().begin(wanted)
        self._beginning = None
        if news.taken:  # there may be more
            self._look_soon()
        for task in news.cancelled:
            if task in self._tasks:
                self._stop(self._tasks[task], Code.CANCELLED, "its client has cancelled it")
        for task, ending in news.ended:
            if task in self._came_in and task not in self._tasks:
                self._is_over(task)
                self._listener.ended(task, ending)
