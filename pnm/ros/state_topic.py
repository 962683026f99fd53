"""The state topic ``knowledge/sensed``: complete reports about some predicates and functions, both ends of it."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from pnm.core.knowledge_base import parse_fluent, parse_statement, statement_text
from pnm.core.logic.expressions import UNKNOWN, Fluent, Unknown, Value, fluent_text
from pnm.errors import InputError
from pnm.ros.node.messages import import_type
from pnm.ros.node.ros_thread import RosThread, call_on_loop

TOPIC = "knowledge/sensed"

Facts = dict[Fluent, Value | Unknown]
Listener = Callable[[frozenset[str], Facts, int], None]
Refuse = Callable[[frozenset[str], str], None]

_log = logging.getLogger(__name__)


class SensedReports:
    """Passes every report on ``knowledge/sensed`` to a listener, on the event loop's thread: names, true facts, sequence number.

    A report is complete about the predicates and functions it names: it replaces all earlier reports about them, from any
    publisher. So several publishers need disjoint names. What cannot be read goes to `refuse`, with the names of the report
    and the reason.
    """

    def __init__(self, ros: RosThread, loop: asyncio.AbstractEventLoop, listener: Listener, refuse: Refuse, topic: str = TOPIC) -> None:
        self._ros = ros
        self._loop = loop
        self._listener = listener
        self._refuse = refuse
        self._topic = topic
        self._heard = asyncio.Event()
        self._closed = False
        self._subscription: Any = None
        ros.call(partial(self._subscribe, import_type("pnm_interfaces/msg/State")))

    async def first(self, limit: float) -> bool:
        """Wait until the first report was passed on; return whether there was one.

        Gives up after `limit` seconds, and as soon as the ROS graph is known to have no publisher of reports.
        """
        try:
            async with asyncio.timeout(limit):
                while not self._heard.is_set():
                    if not await self._has_publisher():
                        return False
                    await asyncio.wait_for(self._heard.wait(), limit)
        except TimeoutError:
            _log.warning("nothing was reported on %s within %g s", self._topic, limit)
        return self._heard.is_set()

    def close(self) -> None:
        """Unsubscribe."""
        if not self._closed:
            self._closed = True
            self._ros.call(self._unsubscribe)

    async def _has_publisher(self) -> bool:
        settled = asyncio.ensure_future(self._ros.settled())
        heard = asyncio.ensure_future(self._heard.wait())
        try:
            await asyncio.wait((settled, heard), return_when=asyncio.FIRST_COMPLETED)
        finally:
            settled.cancel()
            heard.cancel()
        return self._heard.is_set() or bool(await self._ros.ask(lambda: self._subscription.get_publisher_count()))

    def _pass_on(self, listener: Callable[..., None], *report: object) -> None:
        if not self._closed:
            listener(*report)

    # on the ROS thread

    def _subscribe(self, state: Any) -> None:
        from rclpy.qos import DurabilityPolicy, QoSProfile  # here, because rclpy is an extra

        latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._subscription = self._ros.node.create_subscription(state, self._topic, self._receive, latched)

    def _unsubscribe(self) -> None:
        if self._subscription is not None:
            self._ros.node.destroy_subscription(self._subscription)

    def _receive(self, message: Any) -> None:
        names = frozenset(message.names)
        try:
            report = names, read_state(message), int(message.sequence)
        except InputError as error:
            call_on_loop(self._loop, self._pass_on, self._refuse, names, str(error))
        else:
            call_on_loop(self._loop, self._pass_on, self._listener, *report)
            call_on_loop(self._loop, self._heard.set)


def read_state(message: Any) -> Facts:
    """Return the facts, objects and numbers of a ``pnm_interfaces/msg/State``; a NaN is unknown.

    Raises `InputError` if a fact is malformed, or there are not as many values as fluents.
    """
    if len(message.fluents) != len(message.values):
        raise InputError(f"{len(message.fluents)} fluents, but {len(message.values)} values")
    facts: Facts = dict(map(parse_statement, message.facts))
    for text, value in zip(message.fluents, message.values, strict=True):
        facts[parse_fluent(text)] = UNKNOWN if math.isnan(value) else float(value)
    return facts


def write_state(names: frozenset[str], facts: Mapping[Fluent, Value | Unknown], sequence: int) -> dict[str, object]:
    """Return the fields of a ``pnm_interfaces/msg/State`` that reports these facts, objects and numbers."""
    stated = [statement_text(fluent, value) for fluent, value in facts.items() if value is True or isinstance(value, str)]
    numbers = {
        fluent_text(fluent): math.nan if isinstance(value, Unknown) else value
        for fluent, value in facts.items()
        if not isinstance(value, bool | str)
    }
    return {"names": sorted(names), "facts": stated, "fluents": list(numbers), "values": list(numbers.values()), "sequence": sequence}
