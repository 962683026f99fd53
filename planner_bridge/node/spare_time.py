"""Work of a node for which no robot waits: what it learns, and the odds of its tasks. In threads, for a twentieth of the time at most."""

from __future__ import annotations

import asyncio
import logging
from abc import abstractmethod
from pathlib import Path
from time import monotonic
from typing import Final
from uuid import UUID

from planner_bridge.explanations.learning import learn_into
from planner_bridge.model.grounding import problem_now
from planner_bridge.model.plan import Policy
from planner_bridge.model.problem import Problem
from planner_bridge.pipeline.odds import KnownRobots
from planner_bridge.pipeline.policy_odds import PolicyChain, RestOfPlan
from planner_bridge.tasks.task_manager import TaskManager
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.machine.plan_graph import PlanGraph
from pnm.errors import PnmError
from pnm.files.database.place import Place
from pnm.tasks import EVENTS, TaskEnding, TaskListener, TraceEvent, TraceKind

_log = logging.getLogger(__name__)

_SPARED: Final = 20.0
"""Times as long as the work has taken, it is not begun again."""


class SpareTime(TaskListener):
    """Does some work when there is news. The mutable state is the task that does so, and whether there is news since it has begun."""

    def __init__(self) -> None:
        self.news = asyncio.Event()
        self._attending = asyncio.ensure_future(self._attend())

    @abstractmethod
    async def work(self) -> None:
        """Do the work."""

    async def close(self) -> None:
        """Begin no more."""
        self._attending.cancel()
        await asyncio.gather(self._attending, return_exceptions=True)

    async def _attend(self) -> None:
        while True:
            await self.news.wait()
            self.news.clear()
            began = monotonic()
            try:
                await self.work()
            except Exception:
                _log.exception("%s cannot work", type(self).__name__)
            await asyncio.sleep(_SPARED * (monotonic() - began))


class Learner(SpareTime):
    """Adds to a file of rates what the journal tells, when a task is over."""

    def __init__(self, place: Place, rates: Path) -> None:
        self._place, self._rates = place, rates
        super().__init__()

    def ended(self, task: UUID, ending: TaskEnding) -> None:
        """Learn from it."""
        self.news.set()

    async def work(self) -> None:
        """Learn from what has ended."""
        try:
            await asyncio.to_thread(learn_into, self._rates, self._place)
        except asyncio.CancelledError:  # it may not have been read to the end
            self.news.set()
            raise
        except PnmError as error:
            EVENTS.warning("nothing was learned: %s", error)

    async def close(self) -> None:
        """Learn from what has ended, and no more."""
        await super().close()
        if self.news.is_set():
            await self.work()


class Foreteller(SpareTime):
    """Works out the odds of what is left of the plans of tasks, when a task has another one, or a call has begun or ended.

    The mutable state is which tasks these are, the policies of tasks, with the problem where the last stretch began, and what follows it.
    """

    def __init__(self, tasks: TaskManager, known: KnownRobots, world: KnowledgeBase) -> None:
        self._tasks, self._known, self._world, self._due = tasks, known, world, dict[UUID, None]()
        self._policies, self._follows = dict[UUID, tuple[Policy, Problem]](), dict[UUID, tuple[PlanGraph, PolicyChain | None]]()
        super().__init__()

    def planned(self, task: UUID) -> None:
        """Work them out."""
        self._policies.pop(task, None)
        self._follows.pop(task, None)
        if (control := self._tasks.control_of(task)) is not None and control.policy is not None:
            self._policies[task] = control.policy, problem_now(control.policy.problem, self._world)
        self._due[task] = None
        self.news.set()

    def ended(self, task: UUID, ending: TaskEnding) -> None:
        """Forget the task."""
        self._policies.pop(task, None)
        self._follows.pop(task, None)

    def happened(self, moment: TraceEvent) -> None:
        """Work them out if it is about a call."""
        if moment.kind in (TraceKind.SENT, TraceKind.ENDED, TraceKind.FAILED):
            self._due[moment.task] = None
            self.news.set()

    async def work(self) -> None:
        """Work out what is due."""
        due, self._due = self._due, {}
        for task in due:
            if (control := self._tasks.control_of(task)) is not None and (run := control.run) is not None:
                rest = RestOfPlan.of(run, asyncio.get_running_loop().time())
                begun, follows = self._policies.get(task), self._follows.get(task, (None, None))
                if begun is not None and follows[0] is not rest.graph:  # its run may be the one before that of its plan
                    follows = rest.graph, await asyncio.to_thread(rest.chain, self._known, *begun)
                    if task in self._policies:
                        self._follows[task] = follows
                odds = await asyncio.to_thread(rest.odds, self._known, follows[1])
                self._tasks.foretell(task, odds.told if odds else None, rest.now)
