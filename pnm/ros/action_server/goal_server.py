"""An action server whose goals are accepted and carried out on the event loop, and end when that reports their result.

`rclpy` decides about a goal before it says its id, and would have a coroutine wait for the end of every goal, all of which are resumed
at each turn of its executor. Here a goal is answered when the event loop has decided, so that it can be kept first; it is only marked
as executing, and its execute callback runs when there is a result to send.
"""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Awaitable, Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final
from uuid import UUID

from action_msgs.msg import GoalInfo
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import GoalEvent, ServerGoalHandle
from rclpy.qos import QoSProfile
from rclpy.task import Future
from unique_identifier_msgs import msg as identifiers

from pnm.core.machine.requests import OutcomeKind
from pnm.errors import PnmError
from pnm.ros.node.messages import import_type, to_message
from pnm.ros.node.ros_thread import RosThread, call_on_loop
from pnm.ros.node.services import Fields, arrived, until_true

DEPTH: Final = 1000
"""Requests that may wait unread; beyond the default of 10 goals are lost silently."""
RESULT_TIMEOUT: Final = 60
"""Seconds that results are kept for clients that ask late."""
FEEDBACK: Final = 0.1
"""Seconds between two feedback messages."""
_FAREWELL: Final = 2.0
"""Seconds to send the last results."""
_log = logging.getLogger(__name__)


class _PatientServer(ActionServer):  # type: ignore[misc]
    """An action server of `rclpy` that answers a goal when it is told to."""

    def __init__(self, *args: Any, arrived: Callable[[UUID, Any, Callable[[bool], None]], None], **options: Any) -> None:
        self._arrived = arrived
        super().__init__(*args, **options)

    async def _execute_goal_request(self, request_header_and_message: tuple[Any, Any]) -> None:
        request = request_header_and_message[1]
        self._arrived(UUID(bytes=bytes(request.goal_id.uuid)), request.goal, partial(self._answer, request_header_and_message))

    def _answer(self, request_header_and_message: tuple[Any, Any], is_accepted: bool) -> None:
        self.register_goal_callback(lambda _: GoalResponse.ACCEPT if is_accepted else GoalResponse.REJECT)
        with suppress(StopIteration):  # nothing is awaited in it
            super()._execute_goal_request(request_header_and_message).send(None)

    def handle(self, goal: UUID) -> Any:
        """Return the handle of a goal, also of one that is over and whose result can still be asked for; None if there is none."""
        return self._goal_handles.get(goal.bytes)

    def go_on(self, goal: UUID) -> None:
        """Have a goal that another process has accepted."""
        info = GoalInfo(goal_id=identifiers.UUID(uuid=list(goal.bytes)))
        self._goal_handles[goal.bytes] = ServerGoalHandle(self, info, None)
        self._result_futures[goal.bytes] = Future()
        self.add_future(self._result_futures[goal.bytes])


@dataclass(eq=False, repr=False)
class GoalServer:
    """One action server. What is private changes, on one of two threads."""

    ros: RosThread
    type_name: str
    name: str
    accept: Callable[[UUID, Any], Awaitable[str]]
    """Begins a goal, and returns nothing or the reason why it is rejected. Its client hears that it is accepted after that.
    The reason is only logged: a rejection has no field for it, unlike the result of an aborted goal."""
    cancel: Callable[[UUID], None]
    """Called when a client requests cancellation; may come more than once, and after the end. Both are called on the loop's thread."""
    # on the ROS thread
    _server: Any = None
    _open: dict[UUID, Any] = field(default_factory=dict)
    """The handles of goals that are open."""
    _ending: dict[UUID, Any] = field(default_factory=dict)
    """Those of goals whose results are being sent."""
    _undecided: dict[UUID, Callable[[], None] | None] = field(default_factory=dict)
    """Goals that are being decided about, with what ends those that are over already."""
    # on the event loop's thread
    _decisions: set[asyncio.Task[None]] = field(default_factory=set)
    _ended: float = -math.inf
    """The time of the end of the last goal."""

    def __post_init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self.type = import_type(self.type_name)

    # on the event loop's thread

    async def open(self, kept: Iterable[UUID] = ()) -> None:
        """Bring the server up, with goals that another process of this name has accepted: their clients are still waiting."""
        await self.ros.ask(partial(self._bring_up, tuple(kept)))

    def feed(self, goal: UUID, fields: Fields) -> None:
        """Send feedback about a goal, if it is open."""

        def publish() -> None:
            if goal in self._open:
                self._open[goal].publish_feedback(to_message(self.type.Feedback, fields))

        self.ros.call(publish)

    def end(self, goal: UUID, kind: OutcomeKind, result: Callable[[], Fields], *, is_cancel_asked: bool = False) -> None:
        """End a goal, if it is open: it succeeds, or is cancelled if its client or somebody else has asked for that, or it is aborted.

        The function is called on the ROS thread, and returns the fields of the result.
        """
        self._ended = self._loop.time()
        self.ros.call(partial(self._end, goal, kind, result, is_cancel_asked))

    async def close(self, limit: float = _FAREWELL) -> None:
        """Take the server down, once the results of ended goals have arrived."""
        with suppress(TimeoutError):
            async with asyncio.timeout(limit):
                await until_true(self.ros, lambda: not (self._undecided or self._open or self._ending))
        await arrived(self._ended)
        await self.ros.ask(self._take_down)
        for decision in self._decisions:
            decision.cancel()

    def vanish(self) -> None:
        """Take the server down at once; open goals get no result, as if the process had died."""
        self.ros.call(self._take_down)

    def _decide(self, goal: UUID, request: Any, answer: Callable[[bool], None]) -> None:
        async def decide() -> None:
            try:
                reason = await self.accept(goal, request)
            except Exception as error:
                _log.exception("a goal for %s cannot begin", self.name)
                reason = f"{type(error).__name__}: {error}"
            self.ros.call(partial(self._answer, goal, answer, reason))

        decision = self._loop.create_task(decide())
        self._decisions.add(decision)
        decision.add_done_callback(self._decisions.discard)

    # on the ROS thread

    def _bring_up(self, kept: Iterable[UUID]) -> None:
        def cancel(handle: Any) -> CancelResponse:
            self._loop.call_soon_threadsafe(self.cancel, _id(handle))
            return CancelResponse.ACCEPT

        many = QoSProfile(depth=DEPTH)
        self._server = _PatientServer(
            self.ros.node,
            self.type,
            self.name,
            arrived=self._arrived,
            execute_callback=self._finish,
            handle_accepted_callback=lambda _: None,
            cancel_callback=cancel,
            goal_service_qos_profile=many,
            result_service_qos_profile=many,
            cancel_service_qos_profile=many,
            result_timeout=RESULT_TIMEOUT,
        )
        for goal in kept:  # before any request is read: a client that asks for a goal that is not known takes it for lost
            self._server.go_on(goal)
            self._execute(goal)

    def _arrived(self, goal: UUID, request: Any, answer: Callable[[bool], None]) -> None:
        if goal in self._undecided or self._server.handle(goal) is not None:
            _log.warning("a goal for %s is rejected: %s is the id of another one", self.name, goal)
            answer(False)
            return
        self._undecided[goal] = None
        call_on_loop(self._loop, self._decide, goal, request, answer)

    def _answer(self, goal: UUID, answer: Callable[[bool], None], reason: str) -> None:
        end = self._undecided.pop(goal)
        if self._server is None:
            return
        if reason:
            _log.warning("a goal for %s is rejected: %s", self.name, reason)
        answer(not reason)
        if self._server.handle(goal) is not None:  # also if its client went away while it was answered
            self._execute(goal)
            if end is not None:
                end()

    def _execute(self, goal: UUID) -> None:
        handle = self._open[goal] = self._server.handle(goal)
        handle._update_state(GoalEvent.EXECUTE)  # what `execute` does, except for calling back

    def _end(self, goal: UUID, kind: OutcomeKind, result: Callable[[], Fields], is_cancel_asked: bool) -> None:
        if goal in self._undecided:  # its client hears first that it is accepted
            self._undecided[goal] = partial(self._end, goal, kind, result, is_cancel_asked)
        if goal not in self._open:
            return
        try:
            message = to_message(self.type.Result, result())
        except PnmError as error:
            _log.error("the result of a goal for %s cannot be sent: %s", self.name, error)
            kind, message = OutcomeKind.ABORTED, self.type.Result()
        handle = self._ending[goal] = self._open.pop(goal)
        self._server.notify_execute(handle, partial(self._finish, kind=kind, result=message, is_cancel_asked=is_cancel_asked))

    def _finish(self, handle: Any, kind: OutcomeKind = OutcomeKind.ABORTED, result: Any = None, is_cancel_asked: bool = False) -> Any:
        if kind is OutcomeKind.SUCCEEDED:
            handle.succeed()
        elif kind is OutcomeKind.CANCELED and (is_cancel_asked or handle.is_cancel_requested):
            if not handle.is_cancel_requested:  # not by the client of the goal, but by a service of the node
                handle._update_state(GoalEvent.CANCEL_GOAL)
            handle.canceled()
        else:
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
