"""A sensor whose messages come on a topic, with the QoS of each of its publishers: reliable or not, latched or not."""

from __future__ import annotations

import asyncio
import logging
from contextlib import suppress
from functools import partial
from typing import Any, Final

from pnm.errors import InputError
from pnm.ros.node.ros_thread import RosThread, call_on_loop
from pnm.ros.node.typed_fields import value_at
from pnm.ros.sensors.sensor import SensorRecorder, checked, resolved

_log = logging.getLogger(__name__)

DEPTH: Final = 10
"""Unread messages that are kept."""


class TopicSensor:
    """A sensor that subscribes to one topic, once for every QoS of its publishers.

    The mutable state is, on the ROS thread, the type and the subscriptions; the latest message, until the event loop has
    taken it: of messages that come faster than that, only the last one counts; and for when the last one speaks.
    """

    def __init__(self, ros: RosThread, recorder: SensorRecorder) -> None:
        self.recorder = recorder
        self._ros = ros
        self._kind: Any = None
        self._subscriptions: dict[tuple[bool, bool], Any] = {}
        self._waiting = False
        self._latest: Any = None
        self._spoken = 0
        self._news = asyncio.Event()
        self._foreign: set[str] = set()

    # on the event loop's thread

    async def is_there(self) -> bool:
        """Return True if the topic has publishers of the right type."""
        return bool(await self._ros.ask(lambda: self._subscriptions))

    async def refresh(self, since: int, until: float) -> None:
        """Wait until the topic speaks for a time after this one, in nanoseconds of ROS; until then on the loop's clock at most.

        What has said nothing yet has no publisher, and what is latched only speaks when something changes: neither is waited for.
        """
        with suppress(TimeoutError):
            async with asyncio.timeout_at(until):
                while self._spoken <= since and self.recorder.heard.is_set() and not all(latched for _, latched in self._subscriptions):
                    self._news.clear()
                    await self._news.wait()

    def _take(self) -> None:
        self._waiting = False
        message, received = self._latest
        self.recorder.record(partial(value_at, message))
        self._spoken = max(self._spoken, spoken(message, received))
        self._news.set()

    # on the ROS thread

    def resolve(self) -> None:
        """Resolve the full name; raise an `InputError` if it is not valid in ROS."""
        self.name = resolved(self._ros.node.resolve_topic_name, self.recorder.instance, "topic")

    def look(self) -> None:
        """Subscribe to new publishers."""
        from rclpy.qos import DurabilityPolicy, ReliabilityPolicy  # here, because rclpy is an extra

        for info in self._ros.node.get_publishers_info_by_topic(self.name):
            if self._fits(info.topic_type):
                profile = info.qos_profile
                reliable = profile.reliability == ReliabilityPolicy.RELIABLE
                self._subscribe(reliable, reliable and profile.durability == DurabilityPolicy.TRANSIENT_LOCAL)

    def destroy(self) -> None:
        """Unsubscribe."""
        for subscription in self._subscriptions.values():
            self._ros.node.destroy_subscription(subscription)
        self._subscriptions.clear()

    def _fits(self, type_name: str) -> bool:
        """Return True for the type of the sensor: that in the file, or else the first one that is found."""
        wanted = self.recorder.instance.sensor.type
        if self._kind is None and not self.recorder.refused:
            try:
                self._kind, self.recorder.instance = checked(self.recorder.instance, wanted or type_name)
                self._type_name = wanted or type_name
            except InputError as error:
                call_on_loop(self.recorder.loop, self.recorder.refuse, error)
        if self._kind is None or type_name == self._type_name:
            return self._kind is not None
        if type_name not in self._foreign:
            self._foreign.add(type_name)
            _log.warning("%s is ignored where it has the type %s; expected %s", self.recorder.instance.name, type_name, self._type_name)
        return False

    def _subscribe(self, reliable: bool, latched: bool) -> None:
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy  # here, because rclpy is an extra

        if (reliable, latched) not in self._subscriptions:
            profile = QoSProfile(
                depth=DEPTH,
                reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
                durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
            )
            instance = self.recorder.instance
            create = self._ros.node.create_subscription
            try:
                self._subscriptions[reliable, latched] = create(self._kind, instance.name, self._receive, profile)
            except Exception as error:  # this process uses the topic with another type, for example
                reason = f"{instance.name} cannot be listened to: {error}"
                call_on_loop(self.recorder.loop, self.recorder.refuse, InputError(reason, instance.sensor.position))

    def _receive(self, message: Any) -> None:
        self._latest = message, self._ros.node.get_clock().now().nanoseconds
        if not self._waiting:
            self._waiting = True
            call_on_loop(self.recorder.loop, self._take)


def spoken(message: Any, received: int) -> int:
    """Return the time, in nanoseconds, for which a message speaks: that of its stamp if it has one, and else when it was received."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    stamped = 0 if stamp is None else stamp.sec * 10**9 + stamp.nanosec
    return min(stamped or received, received)
