"""An action server whose goals are accepted and carried out on the event loop; and those of simulated robots.

`rclpy` decides about a goal before it says its id, and would have a coroutine wait for the end of every goal, all of which are resumed
at each turn of its executor. Here a goal is answered when the event loop has decided, so that it can be kept first; it is only marked
as executing, and its execute callback runs when there is a result to send.
"""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Awaitable, Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import count
from typing import Any, Final
from uuid import UUID

from action_msgs.msg import GoalInfo
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import GoalEvent, ServerGoalHandle
from rclpy.qos import QoSProfile
from rclpy.task import Future
from unique_identifier_msgs import msg as identifiers

from pnm.actions.simulated_robots import SimulatedWorld
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Accepted, ActionClient, Ended, Outcome, OutcomeKind, Report, Request
from pnm.errors import InputError, PnmError
from pnm.ros.node.messages import FieldError, fields, import_type, to_data, to_message
from pnm.ros.node.ros_thread import RosThread, call_on_loop
from pnm.ros.node.services import Fields, Publisher, Throttle, arrived, until_true
from pnm.ros.sensors import TOPIC, write_state

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


# --- simulated robots over ROS 2: action servers in front of an `ActionClient`, and the state topic ------
# `pnm simulate` offers robots this way: goals that come in become requests of the client. A goal is accepted when the client
# accepts the request; cancellation is passed on; a request whose server is `LOST` takes its server away. While an action
# runs, its progress is published as feedback, if the type has a field for it.


DECISION: Final = 5.0
"""Seconds the client may take to accept a request; the goal is rejected then."""
PROGRESS: Final = 0.5
"""Seconds between two feedback messages about the progress of an action."""


@dataclass(frozen=True, slots=True)
class Offer:
    """One action server: its name, its type, and which ground action a goal means."""

    server: str
    type: str
    decode: Callable[[Mapping[str, object]], GroundAction]
    """Raises `InputError` when the goal makes no sense."""
    answer: Callable[[GroundAction, Outcome], Mapping[str, object]] = lambda action, outcome: {}
    """Returns the result fields that say how the action has ended."""


@dataclass(eq=False)
class _SimulatedGoal:
    """A goal, whose id is that of the request that it becomes."""

    server: GoalServer
    answer: Callable[[Outcome], Mapping[str, object]]
    decision: asyncio.Future[str] = field(default_factory=lambda: asyncio.get_running_loop().create_future())
    """The reason why the request was rejected; nothing once it was accepted."""


class SimulatedServers:
    """Action servers whose goals an `ActionClient` carries out. To be used on the event loop's thread.

    `progress` returns how much of a request is done, from 0 to 1; None if the client cannot say.
    The mutable state is the servers by name, the goals that have begun, by id, until they end, and whether feedback is due.
    """

    def __init__(self, ros: RosThread, client: ActionClient, progress: Callable[[UUID], float] | None = None) -> None:
        self._ros = ros
        self._client = client
        self._progress = progress
        self._loop = asyncio.get_running_loop()
        self._servers: dict[str, GoalServer] = {}
        self._goals: dict[UUID, _SimulatedGoal] = {}
        self._is_feeding = False

    async def open(self, offers: Iterable[Offer]) -> None:
        """Bring the servers up."""
        for offer in offers:
            self._servers[offer.server] = GoalServer(self._ros, offer.type, offer.server, partial(self._accept, offer), self._cancel)
        for server in self._servers.values():
            await server.open()

    async def _accept(self, offer: Offer, id: UUID, message: Any) -> str:
        """Send the request, and wait until the client accepts or rejects it."""
        try:
            action = offer.decode(data := to_data(message))
        except InputError as error:
            return str(error)
        goal = self._goals[id] = _SimulatedGoal(self._servers[offer.server], partial(offer.answer, action))
        self._client.send(Request(id, action, data), partial(self._report, goal))
        try:
            async with asyncio.timeout(DECISION):
                reason = await goal.decision
        except TimeoutError:
            self._client.cancel(id)
            reason = f"no decision within {DECISION:g} s"
        if reason:
            self._goals.pop(id, None)
        elif self._progress is not None and _has_progress(goal.server):
            self._feed_later()
        return reason

    def _cancel(self, id: UUID) -> None:
        if id in self._goals:
            self._client.cancel(id)

    def _report(self, goal: _SimulatedGoal, report: Report) -> None:
        match report:
            case Accepted() if not goal.decision.done():
                goal.decision.set_result("")
            case Ended(_, outcome) if not goal.decision.done():
                goal.decision.set_result(outcome.message or outcome.kind.value)
            case Ended(id, outcome) if self._goals.pop(id, None):
                if outcome.kind is OutcomeKind.LOST:
                    goal.server.vanish()
                else:
                    goal.server.end(id, outcome.kind, lambda: _result_fields(goal, outcome))

    def _feed_later(self) -> None:
        if not self._is_feeding:
            self._is_feeding = True
            self._loop.call_later(PROGRESS, self._feed)

    def _feed(self) -> None:
        self._is_feeding = False
        for id, goal in self._goals.items():
            if self._progress is not None and _has_progress(goal.server):
                goal.server.feed(id, {"progress": self._progress(id)})
                self._feed_later()


def _has_progress(server: GoalServer) -> bool:
    return server.type.Feedback.get_fields_and_field_types().get("progress") in ("float", "double")


def _result_fields(goal: _SimulatedGoal, outcome: Outcome) -> dict[str, object]:
    """Return the result's fields by name, the message in a field called so; nothing if a value does not fit its field."""
    result = goal.server.type.Result
    known = fields(result)
    data = {name: value for name, value in {"message": outcome.message, **outcome.result, **goal.answer(outcome)}.items() if name in known}
    try:
        to_message(result, data)
    except FieldError as error:
        _log.warning("the result is left empty: %s", error)
        return {}
    return data


async def publish_state(ros: RosThread, world: SimulatedWorld, names: frozenset[str], matched: Callable[[], None]) -> None:
    """Publish complete reports about some predicates and functions of a simulated world: now, and whenever it changes.

    Several changes in one turn of the event loop make one report. `matched` is called at every new subscription.
    """
    publisher = Publisher(ros, "pnm_interfaces/msg/State", TOPIC, is_latched=True, matched=matched)
    numbers = count(1)

    def report(_: None) -> None:
        publisher.publish(write_state(names, world.report(names), next(numbers)))

    due: Throttle[None] = Throttle(asyncio.get_running_loop(), 0.0, report)
    await publisher.open()
    world.truth.listen(lambda _: due.note(None))
    due.at_once(None)
