"""Plans as action servers: a goal of type ``pnm_interfaces/action/RunPlan`` has its plan carried out.

A goal is always accepted, unless the servers are being closed: a rejection cannot say why, but the result of an aborted goal
can. So parameters that are wrong abort their goal at once, with the reason ``parameters``.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Mapping
from functools import partial
from typing import Any, Final
from uuid import UUID

from pnm.errors import InputError
from pnm.performing import Performance, Performer
from pnm.results import RunResult
from pnm.ros.goal_server import FEEDBACK, Answer, GoalCalls, GoalServer, Status
from pnm.ros.graph import server_name
from pnm.ros.node import RosThread
from pnm.ros.served_goals import Audience, Ending, Progress, ServedGoal, read_parameters
from pnm.ros.throttle import Throttle
from pnm.sources.people import printable

TYPE: Final = "pnm_interfaces/action/RunPlan"
CLOSING: Final = 20.0
"""Seconds in which plans have to end when the servers are closed: what they run has to confirm that it is cancelled."""
_LOOK: Final = 0.05
"""Seconds between two looks at runs that are coming to a pause."""

_log = logging.getLogger(__name__)


class PlanServers:
    """One action server for each plan of a performer; takes goals between `resume` and `pause`.

    The mutable state is the servers by plan, the tasks of the goals that go on, and why no goals are taken.

    Args:
        ros: the thread of the node.
        performer: carries out the plans.
        audience: is told what happens.
    """

    def __init__(self, ros: RosThread, performer: Performer, audience: Audience | None = None) -> None:
        self._ros = ros
        self._performer = performer
        self._audience = audience or Audience()
        self._loop = asyncio.get_running_loop()
        self._servers: dict[str, GoalServer] = {}
        self._tasks: dict[asyncio.Task[None], ServedGoal] = {}
        self._feedback = Throttle(self._loop, FEEDBACK, self._tell)
        self._closed = "the node is inactive"
        self._is_closing = False

    def __repr__(self) -> str:
        return f"<PlanServers {', '.join(self._performer.programs)}; {len(self._tasks)} goals>"

    # on the event loop's thread

    async def names(self) -> dict[str, str]:
        """Return the name in ROS of each plan's server.

        Raises:
            InputError: the name of a plan cannot be a name in ROS, or two plans would have the same.
        """
        return await self._ros.ask(self._names)

    async def open(self, names: Mapping[str, str]) -> None:
        """Bring the servers up, under these names."""
        for plan, name in names.items():
            calls = GoalCalls(partial(self._begin, plan), self._cancel, lambda: self._closed)
            self._servers[plan] = GoalServer(self._ros, TYPE, name, calls)
            await self._servers[plan].open()

    async def pause(self) -> None:
        """Take no more goals, and cancel what runs; return when that is confirmed."""
        self._closed = "the node is inactive"
        runs = [goal.performance.executor for goal in self._tasks.values() if goal.performance is not None]
        for executor in runs:
            executor.pause(at_once=True)
        while True:
            if all(executor.paused or executor.run.over for executor in runs):
                return
            await asyncio.sleep(_LOOK)

    def resume(self) -> None:
        """Take goals, and begin anew what was cancelled."""
        self._closed = ""
        for goal in self._tasks.values():
            if goal.performance is not None:
                goal.performance.executor.resume()

    async def close(self, limit: float = CLOSING) -> None:
        """Take no more goals, cancel what runs, wait until that is confirmed and told, and take the servers down."""
        self._is_closing = True
        self._closed = "its server is being closed"
        for goal in self._tasks.values():
            if goal.performance is not None:
                goal.performance.executor.stop(reason="whoever serves the plan is being shut down")
        try:
            if self._tasks:
                await asyncio.wait(tuple(self._tasks), timeout=limit)
        finally:
            for task, goal in self._tasks.items():
                _log.warning("%s has not ended; what it runs is left alone", goal.plan)
                task.cancel()
        await asyncio.gather(*(server.close() for server in self._servers.values()))
        self._servers.clear()
        self._feedback.close()

    def _begin(self, plan: str, id: UUID, request: Any) -> None:
        goal = ServedGoal(plan, id, request.parameters)
        observer = self._audience.began(goal)
        try:
            given = read_parameters(goal.parameters)
            told = Progress(goal, partial(self._feedback.note, goal), observer)
            goal.performance = self._performer.perform(plan, given, told)
        except InputError as error:
            self._end(goal, Ending(False, "parameters", str(error)))
            return
        task = self._loop.create_task(self._carry_out(goal, goal.performance))
        self._tasks[task] = goal
        task.add_done_callback(self._tasks.pop)

    async def _carry_out(self, goal: ServedGoal, performance: Performance) -> None:
        ending = Ending(False, "error", "an error of whoever serves the plan")
        try:
            result = await self._performer.execute(performance)
            ending = Ending(result.goal, self._reason(goal, result), result.reason, performance.results)
        except Exception:
            _log.exception("%s cannot be carried out", goal.plan)
        finally:
            self._end(goal, ending)

    def _reason(self, goal: ServedGoal, result: RunResult) -> str:
        if result.goal:
            return "goal"
        if result.stopped:
            return "cancelled" if goal.is_cancelled or self._is_closing else "timed_out"
        return result.failures[0].cause if result.failures else "goal_false"

    def _end(self, goal: ServedGoal, ending: Ending) -> None:
        self._feedback.forget(goal)
        self._audience.ended(goal, ending)
        cancelled = ending.reason == "cancelled" and goal.is_cancelled
        status = Status.SUCCEEDED if ending.success else Status.CANCELED if cancelled else Status.ABORTED
        self._servers[goal.plan].answer(goal.id, lambda: Answer(status, ending.fields()))

    def _cancel(self, goal: UUID) -> None:
        for one in self._tasks.values():
            if one.id == goal and one.performance is not None:
                one.is_cancelled = True
                one.performance.executor.stop()

    def _tell(self, goal: ServedGoal) -> None:
        if goal.performance is not None and goal.performance.result is None:
            running = list(map(printable, goal.performance.running))
            self._servers[goal.plan].feed(goal.id, {"running": running, "ended": goal.ended, "restarts": goal.restarts})

    # on the ROS thread

    def _names(self) -> dict[str, str]:
        found: dict[str, str] = {}
        for plan in self._performer.programs:
            name = server_name(self._ros.node, plan)
            if name in found.values():
                raise InputError(f"two plans would both have the action server {name}; names in ROS have _ for -")
            found[plan] = name
        return found
