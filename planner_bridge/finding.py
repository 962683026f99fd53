"""Finding a plan that can be carried out beside those of others: in turn, waiting where there is none, preempting who yields."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from functools import cache, partial
from typing import TypeVar

from planner_bridge.chronicle import Chronicle, no_plan, sentence
from planner_bridge.circumstances import Conflict
from planner_bridge.codes import code_of_planning
from planner_bridge.footprints import Footprint, footprint
from planner_bridge.forbidding import ForbiddenCall, forbid
from planner_bridge.mission import Mission
from planner_bridge.plan import Plan
from planner_bridge.projection import after
from planner_bridge.search import Search
from planner_bridge.standing import Over, Standing
from planner_bridge.supervision import Supervision
from pnm.calls import UnderWay
from pnm.plan_graph import PlanGraph
from pnm.resources import who_keeps
from pnm.tasking import Code, OnConflict, TaskState

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
