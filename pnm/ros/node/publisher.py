"""A publisher that is used from the event loop's thread, and knows how many subscribe."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Final

from rclpy.event_handler import PublisherEventCallbacks
from rclpy.qos import DurabilityPolicy, QoSProfile

from pnm.ros.node.messages import import_type, to_message
from pnm.ros.node.ros_thread import RosThread, call_on_loop

DEPTH: Final = 1000
"""Messages that slow subscribers may be behind."""


class Publisher:
    """One topic to publish on.

    The mutable state is the publisher of `rclpy`, on the ROS thread, and the number of subscriptions, on the event loop's.

    Args:
        is_latched: whether late subscribers get the last message, and no earlier one: until the last came they would believe that.
        matched: called on the event loop's thread at every new subscription.
    """

    def __init__(
        self,
        ros: RosThread,
        type_name: str,
        name: str,
        *,
        is_latched: bool = False,
        matched: Callable[[], None] = lambda: None,
    ) -> None:
        self._ros = ros
        self._loop = asyncio.get_running_loop()
        self._type = import_type(type_name)
        self._name = name
        self._is_latched = is_latched
        self._matched = matched
        self._publisher: Any = None
        self.subscriptions = 0
        """How many subscriptions there are."""

    def __repr__(self) -> str:
        return f"<Publisher {self._name}, {self.subscriptions} subscriptions>"

    async def open(self) -> None:
        """Advertise the topic."""
        await self._ros.ask(self._advertise)

    def publish(self, fields: Mapping[str, object] | Callable[[], Mapping[str, object]]) -> None:
        """Publish a message of these fields, or of those that a function returns on the ROS thread."""
        self._ros.call(partial(self._publish, fields))

    async def close(self) -> None:
        """Withdraw the topic."""
        await self._ros.ask(self._withdraw)

    def _count(self, count: int, change: int) -> None:
        self.subscriptions = count
        if change > 0:
            self._matched()

    # on the ROS thread

    def _advertise(self) -> None:
        durability = DurabilityPolicy.TRANSIENT_LOCAL if self._is_latched else DurabilityPolicy.VOLATILE
        callbacks = PublisherEventCallbacks(
            matched=lambda info: call_on_loop(self._loop, self._count, info.current_count, info.current_count_change)
        )
        qos = QoSProfile(depth=1 if self._is_latched else DEPTH, durability=durability)
        self._publisher = self._ros.node.create_publisher(self._type, self._name, qos, event_callbacks=callbacks)

    def _publish(self, fields: Mapping[str, object] | Callable[[], Mapping[str, object]]) -> None:
        if self._publisher is not None:
            self._publisher.publish(to_message(self._type, fields() if callable(fields) else fields))

    def _withdraw(self) -> None:
        if self._publisher is not None:
            self._ros.node.destroy_publisher(self._publisher)
            self._publisher = None
