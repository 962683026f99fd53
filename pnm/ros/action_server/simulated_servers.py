"""Action servers in front of any `ActionClient`: goals come in over ROS 2 and are passed on to it.

`pnm simulate` offers simulated robots this way. A goal is accepted when the client accepts the
request; cancelling is passed on; a request whose server is `LOST` takes its server away. While
an action runs, its share done is published as feedback, if the type has a field for it.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final
from uuid import UUID, uuid4

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Accepted, ActionClient, Ended, Outcome, OutcomeKind, Report, Request
from pnm.errors import InputError
from pnm.ros.node.messages import FieldError, fields, import_type, to_data, to_message
from pnm.ros.node.ros_thread import RosThread

DEPTH: Final = 100
"""Goals a server may have unanswered; the default of 10 loses goals without a word."""
RESULT_TIMEOUT: Final = 60
"""Seconds that results are kept for clients that ask late."""
DECISION: Final = 5.0
"""Seconds the client may take to accept a request; the goal is rejected then."""
FEEDBACK: Final = 0.5
"""Seconds between two messages about the progress of an action."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Offer:
    """One action server: its name, its type, and which ground action a goal means."""

    server: str
    type: str
    decode: Callable[[Mapping[str, object]], GroundAction]
    """Raises `InputError` when the goal makes no sense."""


@dataclass(eq=False)
class _Goal:
    """A goal of a client of ours: the request it became, and how that went."""

    offer: Offer
    request: UUID = field(default_factory=uuid4)
    decided: Future[bool] = field(default_factory=Future)
    handle: Any = None
    outcome: Outcome | None = None


class ActionServers:
    """Serves offers from the ROS thread; asks the client on the event loop's thread.

    The mutable state is, on the ROS thread, the servers and the goals by goal id; on the event loop's thread,
    the goals accepted and not over, and whether their progress is being told.

    Args:
        progress: how much of a request is done, from 0 to 1; None when that cannot be told.
    """

    def __init__(
        self, ros: RosThread, client: ActionClient, loop: asyncio.AbstractEventLoop, progress: Callable[[UUID], float] | None = None
    ) -> None:
        self._ros = ros
        self._client = client
        self._loop = loop
        self._servers: dict[str, Any] = {}
        self._goals: dict[bytes, _Goal] = {}
        self._progress = progress
        self._working: set[_Goal] = set()
        self._telling = False

    async def offer(self, offers: list[Offer]) -> None:
        """Bring the servers up."""
        types = {one.server: import_type(one.type) for one in offers}
        for one in offers:
            await self._ros.ask(partial(self._serve, one, types[one.server]))

    async def close(self) -> None:
        """Take all servers down."""
        for name in tuple(self._servers):
            await self._ros.ask(partial(self._remove, name))

    # on the ROS thread

    def _serve(self, offer: Offer, action_type: Any) -> None:
        many = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.VOLATILE)
        accepted: list[_Goal] = []

        def decide(goal: Any) -> GoalResponse:
            found = self._decide(offer, to_data(goal))
            if found is None:
                return GoalResponse.REJECT
            accepted.append(found)
            return GoalResponse.ACCEPT

        def start(handle: Any) -> None:
            # rclpy calls this for one goal before it decides about the next one of this server
            goal = accepted.pop()
            goal.handle = handle
            self._goals[bytes(handle.goal_id.uuid)] = goal

        def cancel(handle: Any) -> CancelResponse:
            goal = self._goals.get(bytes(handle.goal_id.uuid))
            if goal:
                self._loop.call_soon_threadsafe(self._client.cancel, goal.request)
            return CancelResponse.ACCEPT

        self._servers[offer.server] = ActionServer(
            self._ros.node,
            action_type,
            offer.server,
            execute_callback=lambda handle: self._finish(action_type, handle),
            goal_callback=decide,
            handle_accepted_callback=start,
            cancel_callback=cancel,
            goal_service_qos_profile=many,
            result_service_qos_profile=many,
            cancel_service_qos_profile=many,
            result_timeout=RESULT_TIMEOUT,
        )

    def _decide(self, offer: Offer, data: Mapping[str, object]) -> _Goal | None:
        """Pass the goal on and wait for the client to accept it or not."""
        try:
            action = offer.decode(data)
        except InputError as error:
            _log.warning("%s rejects a goal: %s", offer.server, error)
            return None
        goal = _Goal(offer)
        request = Request(goal.request, action, data)
        self._loop.call_soon_threadsafe(self._client.send, request, partial(self._report, goal))
        try:
            return goal if goal.decided.result(DECISION) else None
        except TimeoutError:
            _log.warning("%s rejects a goal: no decision within %g s", offer.server, DECISION)
            self._loop.call_soon_threadsafe(self._client.cancel, goal.request)
            return None

    def _end(self, goal: _Goal, outcome: Outcome) -> None:
        """Let rclpy run `_finish`, which sends the result; or take the server away without a word."""
        goal.outcome = outcome
        if outcome.kind is OutcomeKind.LOST:
            self._remove(goal.offer.server)
        elif goal.handle is not None and goal.offer.server in self._servers:
            goal.handle.execute()

    def _feed(self, shares: Mapping[_Goal, float]) -> None:
        for goal, share in shares.items():
            if goal.handle is not None and goal.outcome is None:
                goal.handle.publish_feedback(import_type(goal.offer.type).Feedback(progress=share))

    def _finish(self, action_type: Any, handle: Any) -> Any:
        goal = self._goals.pop(bytes(handle.goal_id.uuid))
        outcome = goal.outcome or Outcome(OutcomeKind.ABORTED)
        match outcome.kind:
            case OutcomeKind.SUCCEEDED:
                handle.succeed()
            case OutcomeKind.CANCELED if handle.is_cancel_requested:
                handle.canceled()
            case _:
                handle.abort()
        return _result(action_type, outcome)

    def _remove(self, name: str) -> None:
        server = self._servers.pop(name, None)
        if server is not None:
            server.destroy()

    # on the event loop's thread

    def _report(self, goal: _Goal, report: Report) -> None:
        match report:
            case Accepted():
                goal.decided.set_result(True)
                if self._progress and _has_progress(goal.offer.type):
                    self._working.add(goal)
                    self._tell_later()
            case Ended(_, outcome) if not goal.decided.done():
                _log.warning("%s rejects a goal: %s", goal.offer.server, outcome.message)
                goal.decided.set_result(False)
            case Ended(_, outcome):
                self._working.discard(goal)
                self._ros.call(partial(self._end, goal, outcome))

    def _tell_later(self) -> None:
        if not self._telling:
            self._telling = True
            self._loop.call_later(FEEDBACK, self._tell)

    def _tell(self) -> None:
        self._telling = False
        if self._working and self._progress:
            self._ros.call(partial(self._feed, {goal: self._progress(goal.request) for goal in self._working}))
            self._tell_later()


def _has_progress(action_type: str) -> bool:
    kinds = import_type(action_type).Feedback.get_fields_and_field_types()
    return kinds.get("progress") in ("float", "double")


def _result(action_type: Any, outcome: Outcome) -> Any:
    """Fill the result by name; the message goes to a field called so, if there is one."""
    data = {"message": outcome.message, **outcome.result}
    known = fields(action_type.Result)
    try:
        return to_message(action_type.Result, {name: value for name, value in data.items() if name in known})
    except FieldError as error:
        _log.warning("the result is left empty: %s", error)
        return action_type.Result()
