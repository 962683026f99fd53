"""Tasks at once in one world: what the loop of their manager does for each, without the threads of the planner."""

from __future__ import annotations

import asyncio
import gc
import logging
import time
from statistics import median
from uuid import UUID

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.tasks.settings import Settings
from planner_bridge.tasks.task_manager import TaskLimits, TaskManager
from pnm.actions.backend import ClientBackend
from pnm.core.logic.conditions import Holds
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind, Reporter, Request
from pnm.journal.journal import NO_JOURNAL
from pnm.language.runner import PlanRunner
from pnm.tasks import Wanted
from tests.support.benchmarks.peers.worker import Measure
from tests.support.pddl.problems import fleet

_ROBOTS = 200
"""In the world, however many have a task."""
_PLACES = 8
_ENDS = 15
"""Calls that end one after the other."""


class _Waiting:
    """Robots that begin with everything, and end when they are told to."""

    def __init__(self) -> None:
        self.sent = asyncio.Semaphore(0)
        self.open: list[tuple[UUID, Reporter]] = []

    def goal_fields(self, action: GroundAction, /) -> tuple[str, ...] | None:
        return None

    def send(self, request: Request, report: Reporter, /) -> None:
        asyncio.get_running_loop().call_soon(report, Accepted(request.id))
        self.open.append((request.id, report))
        self.sent.release()

    def cancel(self, request: UUID, /) -> None:
        """Ignore it."""


async def _at_once(count: int) -> tuple[float, float]:
    """Return the seconds of the loop from a goal to its first request, and from the end of a call to the next request."""
    problem, client = fleet(robots=_ROBOTS, parcels=1, places=_PLACES), _Waiting()
    runner = PlanRunner({}, ClientBackend(client), initial_knowledge(problem), None, NO_JOURNAL)
    limits = TaskLimits(active=count, queue=count)
    manager = TaskManager(problem, runner, Settings(improve=0.0), lambda text: Holds(tuple(text.split())), limits=limits)
    gc.collect()
    began = time.thread_time()
    for robot in range(count):
        manager.begin(Wanted(UUID(int=robot + 1), f"at r{robot} a{(robot + 3) % _PLACES}"))
    for _ in range(count):
        await client.sent.acquire()
    begun, ends = (time.thread_time() - began) / count, list[float]()
    for _ in range(min(count, _ENDS)):
        request, report = client.open.pop(0)
        began = time.thread_time()
        report(Ended(request, Outcome(OutcomeKind.SUCCEEDED)))
        await client.sent.acquire()
        ends.append(time.thread_time() - began)
    working = [task for task in asyncio.all_tasks() if task is not asyncio.current_task()]
    for task in working:
        task.cancel()
    await asyncio.wait(working)
    return begun, median(ends)


def _measured(which: int) -> Measure:
    def measure(count: int) -> float:
        level = logging.root.manager.disable
        logging.disable(logging.CRITICAL)
        try:
            return asyncio.run(_at_once(count))[which] * 1e6
        finally:
            logging.disable(level)

    return measure


MEASURES: dict[str, Measure] = {"tasks-begin": _measured(0), "tasks-next": _measured(1)}
