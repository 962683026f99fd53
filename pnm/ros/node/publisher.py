"""A topic of ours: messages from the event loop's thread, and whether anybody listens."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from typing import Any, Final

from rclpy.event_handler import PublisherEventCallbacks
from rclpy.qos import DurabilityPolicy, QoSProfile

from pnm.ros.node.messages import import_type, to_message
from pnm.ros.node.ros_thread import RosThread

DEPTH: Final = 1000
"""Messages that slow listeners may be behind."""


class Topic:
    """A publisher. The mutable state is the publisher, on the ROS thread, and how many listen, on the event loop's.

    Args:
        type_name: such as ``pnm_interfaces/msg/Plans``.
        name: relative to the node's namespace.
        is_latched: whether somebody who comes later gets the last message.
        heard: called on the event loop's thread when somebody begins to listen.

    Raises:
        InputError: the type is not installed.
    """

    def __init__(
        self, ros: RosThread, type_name: str, name: str, *, is_latched: bool = False, heard: Callable[[], None] = lambda: None
    ) -> None:
        self._ros = ros
        self._loop = asyncio.get_running_loop()
        self._type = import_type(type_name)
        self._name = name
        self._latched = is_latched
        self._heard = heard
        self._publisher: Any = None
        self.listeners = 0
        """How many listen."""

    def __repr__(self) -> str:
        return f"<Topic {self._name}, {self.listeners} listen>"

    async def open(self) -> None:
        """Begin to publish."""
        await self._ros.ask(self._advertise)

    def publish(self, fields: Mapping[str, object] | Callable[[], Mapping[str, object]]) -> None:
        """Publish a message of these fields, or of those that a function returns on the ROS thread."""
        self._ros.call(partial(self._publish, fields))

    async def close(self) -> None:
        """Publish nothing more."""
        await self._ros.ask(self._withdraw)

    def _matched(self, count: int, change: int) -> None:
        self.listeners = count
        if change > 0:
            self._heard()

    # on the ROS thread

    def _advertise(self) -> None:
        depth, durability = (1, DurabilityPolicy.TRANSIENT_LOCAL) if self._latched else (DEPTH, DurabilityPolicy.VOLATILE)
        told = PublisherEventCallbacks(matched=self._tell)
        qos = QoSProfile(depth=depth, durability=durability)
        self._publisher = self._ros.node.create_publisher(self._type, self._name, qos, event_callbacks=told)

    def _tell(self, info: Any) -> None:
        with suppress(RuntimeError):  # the event loop is closed
            self._loop.call_soon_threadsafe(self._matched, info.current_count, info.current_count_change)

    def _publish(self, fields: Mapping[str, object] | Callable[[], Mapping[str, object]]) -> None:
        if self._publisher is not None:
            self._publisher.publish(to_message(self._type, fields() if callable(fields) else fields))

    def _withdraw(self) -> None:
        if self._publisher is not None:
            self._ros.node.destroy_publisher(self._publisher)
            self._publisher = None
