"""An action server whose goals are carried out on the event loop, and end when that reports their result.

`rclpy` would have a coroutine wait for the end of every goal, and resumes all of them at each turn of its executor.
Here a goal is only marked as executing, and its execute callback runs when there is a result to send.
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
from typing import Any, Final, TypeAlias
from uuid import UUID

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import GoalEvent
from rclpy.qos import QoSProfile

from pnm.errors import PnmError
from pnm.ros.node.messages import import_type, to_message
from pnm.ros.node.ros_thread import RosThread
from pnm.ros.node.service_client import until_true
from pnm.ros.node.service_server import arrived

DEPTH: Final = 1000
"""Requests that may wait unread; beyond the default of 10 goals are lost silently."""
RESULT_TIMEOUT: Final = 60
"""Seconds that results are kept for clients that ask late."""
FEEDBACK: Final = 0.1
"""Seconds between two feedback messages."""
_FAREWELL: Final = 2.0
"""Seconds to send the last results."""

_log = logging.getLogger(__name__)


class GoalStatus(Enum):
    """How a goal ended, in the words of ROS 2."""

    SUCCEEDED = "succeeded"
    CANCELED = "canceled"
    ABORTED = "aborted"


@dataclass(frozen=True, slots=True)
class GoalResult:
    """How a goal ended, and the fields of its result message."""

    status: GoalStatus
    fields: Mapping[str, object]


BeginGoal: TypeAlias = Callable[[UUID], None]
"""Begins an accepted goal of this id; called on the event loop's thread."""


@dataclass(frozen=True, slots=True)
class GoalCallbacks:
    """What carries out the goals of a server.

    Args:
        accept: returns what begins the goal, or the reason why it is rejected; called on the ROS thread with the request.
            The reason is only logged: a rejection has no field for it, unlike the result of an aborted goal.
        cancel: called on the event loop's thread when a client requests cancellation; may come more than once, and after the end.
    """

    accept: Callable[[Any], BeginGoal | str]
    cancel: Callable[[UUID], None]


class GoalServer:
    """One action server.

    The mutable state is, on the ROS thread, the server, the handles of goals that are open and of those whose results are
    being sent, by goal id, and what begins the goal that was accepted last; on the event loop's, when the last goal ended.
    """

    def __init__(self, ros: RosThread, type_name: str, name: str, callbacks: GoalCallbacks) -> None:
        self._ros = ros
        self.type = import_type(type_name)
        self._loop = asyncio.get_running_loop()
        self.name = name
        self._callbacks = callbacks
        self._server: Any = None
        self._open: dict[UUID, Any] = {}
        self._ending: dict[UUID, Any] = {}
        self._begin: BeginGoal = lambda _: None
        self._ended = -math.inf

    def __repr__(self) -> str:
        return f"<GoalServer {self.name}, {len(self._open)} goals open>"

    # on the event loop's thread

    async def open(self) -> None:
        """Bring the server up."""
        await self._ros.ask(self._bring_up)

    def feed(self, goal: UUID, fields: Mapping[str, object]) -> None:
        """Send feedback about a goal, if it is open."""

        def publish() -> None:
            if goal in self._open:
                self._open[goal].publish_feedback(to_message(self.type.Feedback, fields))

        self._ros.call(publish)

    def end(self, goal: UUID, result: Callable[[], GoalResult]) -> None:
        """End a goal, if it is open; the function is called on the ROS thread."""
        self._ended = self._loop.time()
        self._ros.call(partial(self._end, goal, result))

    async def close(self, limit: float = _FAREWELL) -> None:
        """Take the server down, once the results of ended goals have arrived."""
        with suppress(TimeoutError):
            async with asyncio.timeout(limit):
                await until_true(self._ros, lambda: not self._open and not self._ending)
        await arrived(self._ended)
        await self._ros.ask(self._take_down)

    def vanish(self) -> None:
        """Take the server down at once; open goals get no result, as if the process had died."""
        self._ros.call(self._take_down)

    # on the ROS thread

    def _bring_up(self) -> None:
        many = QoSProfile(depth=DEPTH)
        self._server = ActionServer(
            self._ros.node,
            self.type,
            self.name,
            execute_callback=self._finish,
            goal_callback=self._decide,
            handle_accepted_callback=self._accepted,
            cancel_callback=self._cancel_asked,
            goal_service_qos_profile=many,
            result_service_qos_profile=many,
            cancel_service_qos_profile=many,
            result_timeout=RESULT_TIMEOUT,
        )

    def _decide(self, request: Any) -> GoalResponse:
        decision = self._callbacks.accept(request)
        if isinstance(decision, str):
            _log.warning("a goal for %s is rejected: %s", self.name, decision)
            return GoalResponse.REJECT
        # `rclpy` gives this callback no goal id, but calls `_accepted` for the goal before it decides about the next one.
        self._begin = decision
        return GoalResponse.ACCEPT

    def _accepted(self, handle: Any) -> None:
        goal = _id(handle)
        self._open[goal] = handle
        handle._update_state(GoalEvent.EXECUTE)  # what `execute` does, except for calling back
        self._loop.call_soon_threadsafe(self._begin, goal)

    def _cancel_asked(self, handle: Any) -> CancelResponse:
        self._loop.call_soon_threadsafe(self._callbacks.cancel, _id(handle))
        return CancelResponse.ACCEPT

    def _end(self, goal: UUID, result: Callable[[], GoalResult]) -> None:
        if goal not in self._open:
            return
        try:
            ended = result()
            status, message = ended.status, to_message(self.type.Result, ended.fields)
        except PnmError as error:
            _log.error("the result of a goal for %s cannot be sent: %s", self.name, error)
            status, message = GoalStatus.ABORTED, self.type.Result()
        handle = self._ending[goal] = self._open.pop(goal)
        self._server.notify_execute(handle, partial(self._finish, status=status, result=message))

    def _finish(self, handle: Any, status: GoalStatus = GoalStatus.ABORTED, result: Any = None) -> Any:
        match status:
            case GoalStatus.SUCCEEDED:
                handle.succeed()
            case GoalStatus.CANCELED:
                if not handle.is_cancel_requested:  # not by the client of the goal, but by a service of the node
                    handle._update_state(GoalEvent.CANCEL_GOAL)
                handle.canceled()
            case GoalStatus.ABORTED:
                handle.abort()
        self._ending.pop(_id(handle), None)
        return result or self.type.Result()

    def _take_down(self) -> None:
        self._open.clear()
        if self._server is not None:
            self._server.destroy()
            self._server = None


def _id(handle: Any) -> UUID:
    return UUID(bytes=bytes(handle.goal_id.uuid))
