"""Tasks of a manager: what its loop does for each of those at once, and for a call of one, without the threads of the planner."""

from __future__ import annotations

import asyncio
import gc
import logging
import time
from collections.abc import Callable, Coroutine
from itertools import pairwise
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from uuid import UUID

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.plan import GAP, Plan, PlanningResult, PlanningStatus, PlanStep
from planner_bridge.model.problem import Problem
from planner_bridge.planning.normal_form import with_durations
from planner_bridge.tasks.result import TASKS, Stopwatch
from planner_bridge.tasks.settings import Memory, Settings, TaskObserver
from planner_bridge.tasks.task_manager import TaskLimits, TaskManager
from pnm.actions.backend import ClientBackend
from pnm.core.logic.conditions import Holds
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind, Reporter, Request
from pnm.journal.journal import NO_JOURNAL, WrittenJournal
from pnm.journal.store import JournalFile
from pnm.language.runner import PlanRunner
from pnm.tasks import Wanted
from tests.support.benchmarks.peers.worker import Measure
from tests.support.benchmarks.soak import memory, tasks_in_a_row
from tests.support.e2e.page.busy_run import AtOnce
from tests.support.pddl.problems import fleet

_ROBOTS = 500
"""In the world, however many have a task."""
_PLACES = 8
_LONG = Bindings({"move": Binding(timeout=3_600.0)})
"""Calls wait until all have begun: at the limit that they have otherwise, a minute, their tasks would plan anew."""
_SECONDS = 600.0
"""The duration of actions, where they have one."""
_ENDS = 15
"""Calls that end one after the other."""
_FIRST = 500
"""Tasks after which all is there that is kept for a while."""


class _OnceRound(Memory):
    """Plans that are known: a planner takes longer the more robots there are."""

    def plan(self, problem: Problem, timeout: float, search: Callable[[float], PlanningResult]) -> PlanningResult:
        assert isinstance(problem.goal, Holds)
        robot = problem.goal.fluent[1]
        places = [f"a{(int(robot[1:]) + number) % _PLACES}" for number in range(4)]
        lasts = _SECONDS if problem.is_timed else 0.0
        steps = [PlanStep("move", (robot, *way), number * (lasts + GAP), lasts) for number, way in enumerate(pairwise(places))]
        return PlanningResult(PlanningStatus.SOLVED, Plan(tuple(steps), temporal=problem.is_timed))


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


async def _at_once(count: int, which: int, *, is_timed: bool = False) -> float:
    """Return the seconds of the loop from a goal to its first request, or from the end of a call to the next request."""
    problem, client = fleet(robots=_ROBOTS, parcels=1, places=_PLACES), _Waiting()
    if is_timed:
        problem = with_durations(problem, dict.fromkeys(problem.domain.actions, _SECONDS))
    runner = PlanRunner({}, ClientBackend(client), initial_knowledge(problem), None, NO_JOURNAL)
    limits = TaskLimits(active=count, queue=count)
    manager = TaskManager(
        problem, runner, Settings(memory=_OnceRound(), bindings=_LONG), lambda text: Holds(tuple(text.split())), limits=limits
    )
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
    return (begun, median(ends))[which]


class _Counting(AtOnce):
    """Robots that do everything at once, and note when the first request came, and how many there were."""

    def __init__(self) -> None:
        self.began, self.count = 0.0, 0

    def goal_fields(self, action: GroundAction, /) -> tuple[str, ...] | None:
        return None

    def send(self, request: Request, report: Reporter, /) -> None:
        self.began = self.began or time.thread_time()
        self.count += 1
        super().send(request, report)


async def _under_way(calls: int, file: Path | None) -> float:
    """Return the seconds of the loop for each call of a task, from its first request to its end: its plan was found and proved before."""
    problem, client = fleet(robots=1, parcels=1, places=2 * calls), _Counting()
    world, journal = initial_knowledge(problem), WrittenJournal(JournalFile(file, 0.0), TASKS) if file else NO_JOURNAL
    runner = PlanRunner({}, ClientBackend(client), world, None, journal)
    manager = TaskManager(problem, runner, Settings(improve=0.0), lambda text: Holds(tuple(text.split())))
    journal.begin(world, runner.resources)
    result = await manager.run(Wanted(UUID(int=1), f"at r0 a{calls}"), TaskObserver(), Stopwatch())
    took = time.thread_time() - client.began
    assert (result.goal_reached, client.count) == (True, calls), result
    await manager.close()
    return took / calls


def _under_way_kept(calls: int) -> float:
    with TemporaryDirectory() as folder:
        return _seconds(_under_way(calls, Path(folder) / "journal"))


def _left_behind(count: int) -> float:
    """Return the megabytes by which the memory grows in 100 tasks, of so many after the first ones, with a journal."""

    async def soak(file: Path) -> float:
        before = 0.0
        async for number in tasks_in_a_row(file):
            if number == _FIRST:
                before = memory()
            if number == _FIRST + count:
                return memory() - before
        raise AssertionError

    with TemporaryDirectory() as folder:
        return 100 * _seconds(soak(Path(folder) / "journal")) / count


def _seconds(work: Coroutine[None, None, float]) -> float:
    level = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        return asyncio.run(work)
    finally:
        logging.disable(level)


MEASURES: dict[str, Measure] = {
    "tasks-begin": lambda count: 1e6 * _seconds(_at_once(count, 0)),
    "tasks-begin-timed": lambda count: 1e6 * _seconds(_at_once(count, 0, is_timed=True)),
    "tasks-next": lambda count: 1e6 * _seconds(_at_once(count, 1)),
    "task-call": lambda calls: 1e6 * _seconds(_under_way(calls, None)),
    "task-call-kept": lambda calls: 1e6 * _under_way_kept(calls),
    "left-behind": _left_behind,
}
