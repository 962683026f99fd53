"""Finding a plan that can be carried out beside those of others: in turn, waiting where there is none, preempting who yields.

The search for a plan that leaves others in peace.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field, replace
from functools import cache, partial
from typing import Final, TypeVar, cast
from uuid import UUID

from planner_bridge.model.forbidden_actions import ForbiddenCall, forbid
from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.plan import Plan, PlanningResult, PlanningStatus
from planner_bridge.model.plan_simulation import after
from planner_bridge.model.problem import Problem
from planner_bridge.ordering.interference import Footprint, around, footprint, optimistic_state
from planner_bridge.ordering.plan_to_graph import calls_of, one_by_one
from planner_bridge.planning.solve import solve
from planner_bridge.tasks.constraint_monitor import Supervision
from planner_bridge.tasks.context import Begun, Circumstances, Conflict, Mission
from planner_bridge.tasks.control import Over, Standing
from planner_bridge.tasks.replanning import Progress, shortened, why_not
from planner_bridge.tasks.result import Stopwatch, code_of_planning
from planner_bridge.tasks.settings import Settings, TaskObserver
from planner_bridge.tasks.task_history import Chronicle, no_plan, sentence
from pnm.core.execution.handover import UnderWay
from pnm.core.execution.resources import who_keeps
from pnm.core.logic.conditions import TRUE
from pnm.core.machine.plan_graph import ActionCall, PlanGraph
from pnm.errors import InputError
from pnm.tasks import Code, OnConflict, TaskState

_NO_PLAN: Final = frozenset({PlanningStatus.UNSOLVABLE, PlanningStatus.NO_PLAN})
LEAN: Final = 100
"""Calls of the longest plan of which needless ones are left out."""


@dataclass
class Search:
    """Asks the planner, and the neighbours whether the plan is in their way. The mutable state is what has a default.

    Args:
        settings: the planner and its limits.
        observer: is told what happens.
        seconds: measures how long planners take.
        circumstances: the other tasks, and whether to look for a plan that leaves them alone.
    """

    settings: Settings
    observer: TaskObserver
    seconds: Stopwatch
    circumstances: Circumstances
    reserved: Callable[[], Footprint] | None = None
    """Works out what the plan found last needs and changes: neighbours, if there are any, respect that from the moment it was found."""
    _has_found: bool = False
    _is_stopped: threading.Event = field(default_factory=threading.Event)

    def stop(self) -> None:
        """Have searches end: nobody wants a plan any more."""
        self._is_stopped.set()

    async def find(
        self, now: Problem, under_way: list[ActionCall], limit: float, given: Plan | None = None
    ) -> tuple[PlanningResult, tuple[Conflict, ...]]:
        """Return what the planner says, and the neighbours with whom its plan is in conflict.

        Args:
            now: what is to be solved.
            under_way: the calls that go on meanwhile.
            limit: seconds that each search may take.
            given: a plan that shall be carried out if that is possible beside the neighbours; no planner is asked then.

        Raises:
            InputError: the planner refuses the problem, which it has never been asked about before.
        """
        self.reserved = None
        if given is not None:
            return PlanningResult(PlanningStatus.SOLVED, given), self._reserve(now, given, under_way)
        self.observer.planning(self.settings.planner)
        begun = self.circumstances.neighbours.begun()  # now, and not when the planner has answered
        found = await self._solve(now, limit)
        if found.plan is None:
            self.observer.unplanned(found)
            return found, await self._too_early(now, begun, found, limit)
        self._has_found = True
        conflicts = self._reserve(now, found.plan, under_way)
        if any(not one.yields for one in conflicts) and self.circumstances.on_conflict is OnConflict.PLAN_AROUND:
            found, conflicts = await self._around(now, under_way, limit, found, conflicts)
        if conflicts:
            self.reserved = None
        return found, conflicts

    async def _too_early(self, now: Problem, begun: tuple[Begun, ...], found: PlanningResult, limit: float) -> tuple[Conflict, ...]:
        """Return those after whose calls that are under way there may be a plan: while a robot moves, it is nowhere."""
        if not begun or found.status not in _NO_PLAN:
            return ()
        hopeful = optimistic_state(now, [call for one in begun for call in one.calls])
        other = await self._solve(hopeful, limit)
        if other.plan is None:
            return ()
        needed, world = footprint(calls_of(hopeful, other.plan), now.goal, initial_knowledge(hopeful)), initial_knowledge(now)
        conflicts = [Conflict(one.task, one.name, footprint(one.calls, TRUE, world), str(one), one.yields) for one in begun]
        return tuple(one for one in conflicts if needed.disturbed_by(one.footprint)) or tuple(conflicts)

    async def _around(
        self, now: Problem, under_way: list[ActionCall], limit: float, found: PlanningResult, conflicts: tuple[Conflict, ...]
    ) -> tuple[PlanningResult, tuple[Conflict, ...]]:
        """Look for a plan that leaves alone those with whom there is a conflict, and those with whom that one is in conflict."""
        respected: dict[UUID, Conflict] = {}
        while new := {one.task: one for one in conflicts if one.task not in respected and not one.yields}:
            respected |= new
            other = await self._solve(around(now, [one.footprint for one in respected.values()]), limit)
            if other.plan is None:
                return found, tuple(respected.values())
            conflicts = self._reserve(now, other.plan, under_way)
            if all(one.yields for one in conflicts):
                return other, conflicts
        return found, conflicts

    def _reserve(self, now: Problem, plan: Plan, under_way: list[ActionCall]) -> tuple[Conflict, ...]:
        self.reserved = cache(lambda: footprint((*under_way, *calls_of(now, plan)), now.goal, initial_knowledge(now)))
        return self.circumstances.neighbours.conflicts(self.reserved)

    async def _solve(self, problem: Problem, limit: float) -> PlanningResult:
        found = await self._planned(problem, limit)
        return found if found.plan is None else replace(found, plan=lean(problem, found.plan))

    async def _planned(self, problem: Problem, limit: float) -> PlanningResult:
        timeout = max(0.01, min(self.settings.planner_timeout, limit))
        search = partial(solve, problem, planner=self.settings.planner, cancel=self._is_stopped, executor=self.settings.executor)
        try:
            with self.seconds.of("plan"):
                return await asyncio.to_thread(search, timeout=timeout)
        except asyncio.CancelledError:
            self.stop()
            if cast("asyncio.Task[object]", asyncio.current_task()).cancelling():
                raise
            return PlanningResult(PlanningStatus.CANCELLED, message="the search was cancelled")  # and not whoever waits for it
        except InputError as error:
            if not self._has_found:
                raise
            return PlanningResult(PlanningStatus.INVALID, message=str(error))


def lean(problem: Problem, plan: Plan) -> Plan:
    """Return the plan without calls that it does not need to reach its goal; planners sometimes add some.

    One after the other is left out if what is left still works (greedy action elimination, Nakhost and Müller, 2010). Where a plan
    is more than a way to its goal it is left as it is, and so are long ones: the work grows with the square of their length.
    """
    if plan.temporal or len(plan.steps) > LEAN or _wants_more(problem):
        return plan
    progress, world = Progress.beginning(one_by_one(problem, plan)), initial_knowledge(problem)
    if why_not(progress, world):
        return plan
    kept = {call.index for call in shortened(progress, world).rest}
    return replace(plan, steps=tuple(step for number, step in enumerate(plan.steps) if number in kept))


def _wants_more(problem: Problem) -> bool:
    """Tell whether the problem asks for more than its goal: tasks, constraints, preferences, or the best of something."""
    domain, metric = problem.domain, problem.metric
    is_short = metric is None or (metric.direction == "minimize" and str(metric.expression) in ("(total-cost)", "(total-time)"))
    preferences = (*domain.preferences, *problem.preferences, *(one for schema in domain.actions.values() for one in schema.preferences))
    return bool(problem.network or problem.constraints or domain.constraints or preferences) or not is_short


Way = TypeVar("Way", Plan, PlanGraph)


class Finding:
    """Finds plans for one mission.

    The mutable state is the plan to begin with, when the last search began, and that of the search.

    Args:
        mission: what plans are for.
        standing: whether they are still wanted.
        supervision: what of the problem is left, and how much time.
        chronicle: what has failed, and how many plans there have been.
        given: a plan to begin with, in place of one that would have to be found.
    """

    def __init__(
        self, mission: Mission, standing: Standing, supervision: Supervision, chronicle: Chronicle, given: Plan | None = None
    ) -> None:
        self._mission = mission
        self._standing = standing
        self._supervision = supervision
        self._chronicle = chronicle
        self._given = given
        self._search = Search(mission.settings, mission.observer, mission.seconds, mission.circumstances)
        self.origin = 0.0
        """When the search for the current plan began: what its times count from."""

    @property
    def reserved(self) -> Footprint | None:
        """What the plan found last needs and changes."""
        return self._search.reserved() if self._search.reserved else None

    def stop(self) -> None:
        """Have searches end: nobody wants a plan any more."""
        self._search.stop()

    def forget(self) -> None:
        """Have neighbours no longer respect the plan found last."""
        self._search.reserved = None

    async def find(self, forbidden: frozenset[ForbiddenCall]) -> Plan:
        """Find a plan that can be carried out beside those of the neighbours; wait for them if there is none.

        Raises:
            Over: there is none, or nobody wants it any more.
        """

        async def search() -> tuple[Plan | None, tuple[Conflict, ...]]:
            self.origin = asyncio.get_running_loop().time()
            self._standing.enter(TaskState.PLANNING)
            return await self.look(forbidden)

        plan = await self._beside_others(search)
        self.accept(plan)
        return plan

    async def room_for(self, rest: PlanGraph) -> PlanGraph:
        """Wait until the rest of a plan can be carried out beside those of the neighbours.

        Raises:
            Over: nobody waits for that.
        """

        async def compare() -> tuple[PlanGraph | None, tuple[Conflict, ...]]:
            needed = cache(partial(footprint, rest.calls, rest.goal, self._mission.world))
            conflicts = self._mission.circumstances.neighbours.newcomers(needed)
            self._search.reserved = None if conflicts else needed
            return (None, conflicts) if conflicts else (rest, ())

        return await self._beside_others(compare)

    async def _beside_others(self, attempt: Callable[[], Awaitable[tuple[Way | None, tuple[Conflict, ...]]]]) -> Way:
        """Return what an attempt yields with which nobody is in conflict, after waiting if need be."""
        neighbours = self._mission.circumstances.neighbours
        while True:
            await self._standing.may_go()
            await self._standing.until(neighbours.turn())
            try:
                found, conflicts = await self._attempt_in_turn(attempt)
            finally:
                neighbours.leave(in_vain=False)
            if found is not None:
                return found
            if not conflicts:
                continue
            reason = "; ".join(map(str, conflicts))
            if self._mission.circumstances.on_conflict is OnConflict.REFUSE:
                raise Over(Code.CONFLICT, reason)
            self._standing.enter(TaskState.QUEUED, f"waits for {reason}")

    async def _attempt_in_turn(
        self, attempt: Callable[[], Awaitable[tuple[Way | None, tuple[Conflict, ...]]]]
    ) -> tuple[Way | None, tuple[Conflict, ...]]:
        """Try, and try again when those have made way that yield; neither a way nor conflicts if it has been paused meanwhile."""
        neighbours = self._mission.circumstances.neighbours
        while not self._standing.is_paused:
            found, conflicts = await attempt()
            if self._standing.is_paused:  # whatever was found may not be so any more when it goes on
                break
            if found is not None:
                return found, ()
            if not all(one.yields for one in conflicts):
                neighbours.leave(in_vain=True)
                return None, conflicts
            await self._standing.until(neighbours.preempt(conflicts))
        return None, ()

    async def look(
        self, forbidden: frozenset[ForbiddenCall], under_way: tuple[UnderWay, ...] = ()
    ) -> tuple[Plan | None, tuple[Conflict, ...]]:
        """Return a plan, or with whom all plans that were found are in conflict.

        Raises:
            Over: there is none, or nobody wants it any more.
            Unforeseeable: it is not known what the world will be after what is under way.
        """
        self._standing.check()
        now = forbid(self._supervision.now(after(self._mission.world, under_way)), forbidden)
        given = None if self._chronicle.plans else self._given
        found, conflicts = await self._search.find(now, [one.call for one in under_way], self._supervision.limit.left, given)
        self._standing.check()
        if found.plan is None and not conflicts:
            unfulfilled = self._chronicle.unfulfilled(self._supervision.missing)
            kept = who_keeps(self._mission.circumstances.resources.withheld)  # nobody knows what it has made of the world
            reason = sentence(self._chronicle.last_failure, no_plan(found, forbidden), unfulfilled, kept)
            raise Over(code_of_planning(found.status, self._chronicle.failures), reason)
        return (None, conflicts) if conflicts else (found.plan, ())

    def accept(self, plan: Plan) -> None:
        """Note that a plan is going to be carried out."""
        limits = self._mission.settings.limits
        self._chronicle.plans += 1
        self._supervision.limit.allow(limits.allowed(plan.makespan if plan.temporal else 0.0))
        self._mission.observer.planned(plan)
