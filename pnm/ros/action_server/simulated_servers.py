"""Simulated robots over ROS 2: action servers in front of an `ActionClient`, and the state topic.

`pnm simulate` offers robots this way: goals that come in become requests of the client. A goal is accepted when the client
accepts the request; cancellation is passed on; a request whose server is `LOST` takes its server away. While an action
runs, its progress is published as feedback, if the type has a field for it.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import count
from typing import Any, Final
from uuid import UUID

from pnm.actions.simulated_robots import SimulatedWorld
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Accepted, ActionClient, Ended, Outcome, OutcomeKind, Report, Request
from pnm.errors import InputError
from pnm.ros.action_server.goal_server import GoalServer
from pnm.ros.node.messages import FieldError, fields, to_data, to_message
from pnm.ros.node.publisher import Publisher, Throttle
from pnm.ros.node.ros_thread import RosThread
from pnm.ros.sensors import TOPIC, write_state

DECISION: Final = 5.0
"""Seconds the client may take to accept a request; the goal is rejected then."""
FEEDBACK: Final = 0.5
"""Seconds between two feedback messages about the progress of an action."""
_log = logging.getLogger(__name__)


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
            self._loop.call_later(FEEDBACK, self._feed)

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
