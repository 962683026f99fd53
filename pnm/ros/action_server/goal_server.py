"""An action server whose goals are carried out on the event loop: accepted at once, told about, and answered when they are over.

A goal is rejected only while the server takes none at all: a rejection cannot say why, but the result of an aborted goal can.
"""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from functools import partial
from typing import Any, Final
from uuid import UUID

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import GoalEvent
from rclpy.qos import QoSProfile
from rclpy.task import Future

from pnm.errors import PnmError, RosError
from pnm.ros.node.graph import processes
from pnm.ros.node.messages import import_type, to_message
from pnm.ros.node.ros_thread import RosThread
from pnm.ros.node.service_client import until_true
from pnm.ros.node.service_server import arrived

DEPTH: Final = 1000
"""Requests that may wait unread; the default of 10 loses goals without a word."""
RESULT_TIMEOUT: Final = 60
"""Seconds that results are kept for clients that ask late."""
FEEDBACK: Final = 0.1
"""Seconds between two messages about what happens."""
_FAREWELL: Final = 2.0
"""Seconds in which the last results are sent."""
_ADVICE: Final = "(one that was killed is remembered for up to 20 s)"

_log = logging.getLogger(__name__)


class Status(Enum):
    """How a goal ended, in the words of ROS 2."""

    SUCCEEDED = "succeeded"
    CANCELED = "canceled"
    ABORTED = "aborted"


@dataclass(frozen=True, slots=True)
class Answer:
    """How a goal ended, and the fields of its result."""

    status: Status
    fields: Mapping[str, object]


@dataclass(frozen=True, slots=True)
class GoalCalls:
    """Who carries out the goals of a server.

    Args:
        begin: called on the event loop's thread with the id of an accepted goal and its request.
        cancel: called there when a client wants the goal cancelled; may come more than once, and when it is over.
        closed: says why no goals are taken; empty while they are. Called on the ROS thread.
    """

    begin: Callable[[UUID, Any], None]
    cancel: Callable[[UUID], None]
    closed: Callable[[], str]


class GoalServer:
    """One action server.

    The mutable state is, on the ROS thread, the server and, by goal id, the handles and the futures of the answers; on the event
    loop's, when the last answer was given.

    Args:
        type_name: such as ``pnm_interfaces/action/RunPlan``.
        name: relative to the node's namespace.

    Raises:
        InputError: the type is not installed.
    """

    def __init__(self, ros: RosThread, type_name: str, name: str, calls: GoalCalls) -> None:
        self._ros = ros
        self._type = import_type(type_name)
        self._loop = asyncio.get_running_loop()
        self.name = name
        self._calls = calls
        self._server: Any = None
        self._open: dict[UUID, tuple[Any, Any]] = {}
        self._answered = -math.inf

    def __repr__(self) -> str:
        return f"<GoalServer {self.name}, {len(self._open)} goals open>"

    # on the event loop's thread

    async def open(self) -> None:
        """Bring the server up."""
        await self._ros.ask(self._bring_up)

    def feed(self, goal: UUID, fields: Mapping[str, object]) -> None:
        """Send feedback about a goal, if it is not over."""
        self._ros.call(partial(self._feed, goal, fields))

    def answer(self, goal: UUID, answer: Callable[[], Answer]) -> None:
        """End a goal; the function is called on the ROS thread."""
        self._answered = self._loop.time()
        self._ros.call(partial(self._answer, goal, answer))

    async def close(self, limit: float = _FAREWELL) -> None:
        """Take the server down, once the answers that were given have arrived."""
        with suppress(TimeoutError):
            async with asyncio.timeout(limit):
                await until_true(self._ros, lambda: not self._open)
        await arrived(self._answered)
        await self._ros.ask(self._take_down)

    # on the ROS thread

    def _bring_up(self) -> None:
        many = QoSProfile(depth=DEPTH)
        self._server = ActionServer(
            self._ros.node,
            self._type,
            self.name,
            execute_callback=self._execute,
            goal_callback=self._decide,
            handle_accepted_callback=self._accepted,
            cancel_callback=self._cancel_asked,
            goal_service_qos_profile=many,
            result_service_qos_profile=many,
            cancel_service_qos_profile=many,
            result_timeout=RESULT_TIMEOUT,
        )

    def _decide(self, _request: Any) -> GoalResponse:
        if reason := self._calls.closed():
            _log.warning("a goal for %s is rejected: %s", self.name, reason)
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _accepted(self, handle: Any) -> None:
        goal = _id(handle)
        self._open[goal] = handle, Future()
        self._loop.call_soon_threadsafe(self._calls.begin, goal, handle.request)
        handle.execute()

    def _cancel_asked(self, handle: Any) -> CancelResponse:
        self._loop.call_soon_threadsafe(self._calls.cancel, _id(handle))
        return CancelResponse.ACCEPT

    def _feed(self, goal: UUID, fields: Mapping[str, object]) -> None:
        if goal in self._open:
            self._open[goal][0].publish_feedback(to_message(self._type.Feedback, fields))

    def _answer(self, goal: UUID, answer: Callable[[], Answer]) -> None:
        if goal in self._open:
            _, future = self._open[goal]
            try:
                found = answer()
                future.set_result((found.status, to_message(self._type.Result, found.fields)))
            except PnmError as error:
                _log.error("the result of a goal for %s cannot be said: %s", self.name, error)
                future.set_result((Status.ABORTED, self._type.Result()))

    async def _execute(self, handle: Any) -> Any:
        """Wait for the end of the goal; `rclpy` goes on with others meanwhile, and sends what is returned."""
        status, result = await self._open[_id(handle)][1]
        match status:
            case Status.SUCCEEDED:
                handle.succeed()
            case Status.CANCELED:
                if not handle.is_cancel_requested:  # somebody else than the client of the goal wanted it
                    handle._update_state(GoalEvent.CANCEL_GOAL)
                handle.canceled()
            case Status.ABORTED:
                handle.abort()
        del self._open[_id(handle)]
        return result

    def _take_down(self) -> None:
        if self._server is not None:
            self._server.destroy()
            self._server = None


async def check_alone(ros: RosThread, servers: tuple[str, ...]) -> None:
    """Make sure that nobody else has the name of the node, or of one of these action servers.

    Raises:
        RosError: somebody has.
    """
    await ros.settled()
    await ros.ask(partial(_check_alone, ros.node, servers))


def _check_alone(node: Any, servers: tuple[str, ...]) -> None:
    for name in servers:
        if processes(node, name):
            raise RosError(f"there is an action server {name} already; another process offers it {_ADVICE}")
    own = (node.get_name(), node.get_namespace())
    if node.get_node_names_and_namespaces().count(own) > 1:
        raise RosError(f"there is a node {node.get_fully_qualified_name()} already; is this being served? {_ADVICE}")


def _id(handle: Any) -> UUID:
    return UUID(bytes=bytes(handle.goal_id.uuid))
