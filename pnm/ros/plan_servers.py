"""Plans as action servers: a goal of type ``pnm_interfaces/action/RunPlan`` has its plan carried out.

A goal is always accepted, unless the servers are being closed: a rejection cannot say why, but the result of an aborted goal
can. So parameters that are wrong abort their goal at once, with the reason ``parameters``.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from typing import Any, Final
from uuid import UUID

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.qos import QoSProfile
from rclpy.task import Future

from pnm.errors import InputError
from pnm.performing import Performance, Performer
from pnm.results import RunResult
from pnm.ros.graph import processes, server_name
from pnm.ros.messages import import_type, to_message
from pnm.ros.node import RosError, RosThread
from pnm.ros.served_goals import Audience, Ending, Progress, ServedGoal, read_parameters
from pnm.ros.service_client import until_true
from pnm.sources.people import printable

TYPE: Final = "pnm_interfaces/action/RunPlan"
DEPTH: Final = 1000
"""Requests that may wait unread; the default of 10 loses goals without a word."""
RESULT_TIMEOUT: Final = 60
"""Seconds that results are kept for clients that ask late."""
FEEDBACK: Final = 0.1
"""Seconds in which what happens is told in one message."""
CLOSING: Final = 20.0
"""Seconds in which plans have to end when the servers are closed: what they run has to confirm that it is cancelled."""
_FAREWELL: Final = 2.0
"""Seconds in which the last results are sent."""

_log = logging.getLogger(__name__)


class PlanServers:
    """One action server for each plan of a performer.

    The mutable state is, on the ROS thread, the servers and, by goal id, the futures of the results and the goal handles; on the
    event loop's thread, the tasks of the goals that go on; and whether the servers are being closed.

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
        self._type = import_type(TYPE)
        self._servers: list[Any] = []
        self._open: dict[UUID, tuple[Any, Any]] = {}
        self._tasks: dict[asyncio.Task[None], ServedGoal] = {}
        self._is_closing = False

    def __repr__(self) -> str:
        return f"<PlanServers {', '.join(self._performer.programs)}; {len(self._tasks)} goals>"

    # on the event loop's thread

    async def names(self) -> dict[str, str]:
        """Return the name in ROS of each plan's server, once it is known that nobody else has it.

        Raises:
            InputError: the name of a plan cannot be a name in ROS.
            RosError: there is a server or a node of the same name already.
        """
        await self._ros.settled()
        names = await self._ros.ask(self._names)
        await self._ros.ask(partial(self._check_alone, names))
        return names

    async def open(self, names: Mapping[str, str]) -> None:
        """Bring the servers up, under these names."""
        await self._ros.ask(partial(self._serve, names))

    async def close(self, limit: float = CLOSING) -> None:
        """Take no more goals, cancel what runs, wait until that is confirmed and told, and take the servers down."""
        self._is_closing = True
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
        with suppress(TimeoutError):
            async with asyncio.timeout(_FAREWELL):
                await until_true(self._ros, lambda: not self._open)
        await self._ros.ask(self._take_down)

    def _begin(self, goal: ServedGoal) -> None:
        observer = self._audience.began(goal)
        try:
            given = read_parameters(goal.parameters)
            told = Progress(goal, partial(self._tell_later, goal), observer)
            goal.performance = self._performer.perform(goal.plan, given, told)
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
        self._audience.ended(goal, ending)
        self._ros.call(partial(self._answer, goal.id, ending))

    def _cancel(self, goal: UUID) -> None:
        for one in self._tasks.values():
            if one.id == goal and one.performance is not None:
                one.is_cancelled = True
                one.performance.executor.stop()

    def _tell_later(self, goal: ServedGoal) -> None:
        if goal.is_told:
            goal.is_told = False
            self._loop.call_later(FEEDBACK, self._tell, goal)

    def _tell(self, goal: ServedGoal) -> None:
        goal.is_told = True
        if goal.performance is not None and goal.performance.result is None:
            running = list(map(printable, goal.performance.running))
            self._ros.call(partial(self._feed, goal.id, {"running": running, "ended": goal.ended, "restarts": goal.restarts}))

    # on the ROS thread

    def _names(self) -> dict[str, str]:
        found: dict[str, str] = {}
        for plan in self._performer.programs:
            name = server_name(self._ros.node, plan)
            if name in found.values():
                raise InputError(f"two plans would both have the action server {name}; names in ROS have _ for -")
            found[plan] = name
        return found

    def _check_alone(self, names: Mapping[str, str]) -> None:
        node = self._ros.node
        advice = "(one that was killed is remembered for up to 20 s)"
        for name in names.values():
            if processes(node, name):
                raise RosError(f"there is an action server {name} already; another process offers this plan {advice}")
        own = (node.get_name(), node.get_namespace())
        if node.get_node_names_and_namespaces().count(own) > 1:
            raise RosError(f"there is a node {node.get_fully_qualified_name()} already; is this world being served? {advice}")

    def _serve(self, names: Mapping[str, str]) -> None:
        many = QoSProfile(depth=DEPTH)
        for plan, name in names.items():
            self._servers.append(
                ActionServer(
                    self._ros.node,
                    self._type,
                    name,
                    execute_callback=self._execute,
                    goal_callback=partial(self._decide, plan),
                    handle_accepted_callback=partial(self._accepted, plan),
                    cancel_callback=self._cancel_asked,
                    goal_service_qos_profile=many,
                    result_service_qos_profile=many,
                    cancel_service_qos_profile=many,
                    result_timeout=RESULT_TIMEOUT,
                )
            )

    def _decide(self, plan: str, _request: Any) -> GoalResponse:
        if self._is_closing:
            _log.warning("a goal for %s is rejected: its server is being closed", plan)
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _accepted(self, plan: str, handle: Any) -> None:
        goal = ServedGoal(plan, _id(handle), handle.request.parameters)
        self._open[goal.id] = handle, Future()
        self._loop.call_soon_threadsafe(self._begin, goal)
        handle.execute()

    def _cancel_asked(self, handle: Any) -> CancelResponse:
        self._loop.call_soon_threadsafe(self._cancel, _id(handle))
        return CancelResponse.ACCEPT

    def _feed(self, goal: UUID, fields: Mapping[str, object]) -> None:
        if goal in self._open:
            self._open[goal][0].publish_feedback(to_message(self._type.Feedback, fields))

    def _answer(self, goal: UUID, ending: Ending) -> None:
        if goal in self._open:
            self._open[goal][1].set_result(ending)

    async def _execute(self, handle: Any) -> Any:
        """Wait for the end of the goal; `rclpy` goes on with others meanwhile, and sends what is returned."""
        ending = await self._open[_id(handle)][1]
        if ending.success:
            handle.succeed()
        elif ending.reason == "cancelled" and handle.is_cancel_requested:
            handle.canceled()
        else:
            handle.abort()
        del self._open[_id(handle)]
        return to_message(self._type.Result, ending.fields())

    def _take_down(self) -> None:
        for server in self._servers:
            server.destroy()
        self._servers.clear()


def _id(handle: Any) -> UUID:
    return UUID(bytes=bytes(handle.goal_id.uuid))
