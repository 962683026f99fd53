"""The search for a plan that leaves others in peace."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache, partial
from typing import Final, cast
from uuid import UUID

from planner_bridge.circumstances import Begun, Circumstances, Conflict
from planner_bridge.footprints import Footprint, around, at_best, footprint
from planner_bridge.model import Problem
from planner_bridge.plan import Plan, PlanningResult, PlanningStatus
from planner_bridge.planning import solve
from planner_bridge.plans import calls_of, one_by_one
from planner_bridge.replanning import Progress, shortened, why_not
from planner_bridge.state import initial_knowledge
from planner_bridge.stopwatch import Stopwatch
from planner_bridge.tasks import Settings, TaskObserver
from pnm.conditions import TRUE
from pnm.errors import InputError
from pnm.plan_graph import ActionCall
from pnm.tasking import OnConflict

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
        hopeful = at_best(now, [call for one in begun for call in one.calls])
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
