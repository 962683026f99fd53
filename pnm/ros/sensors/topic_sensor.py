"""A sensor that listens to a topic, in the way in which each of its publishers publishes: reliable or not, latched or not."""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import partial
from typing import Any, Final

from pnm.errors import InputError
from pnm.ros.node.ros_thread import RosThread
from pnm.ros.sensors.fields import value_at
from pnm.ros.sensors.sensor import Sense, checked, resolved

DEPTH: Final = 10
"""Messages that are kept until they are read."""

_log = logging.getLogger(__name__)


class TopicSensor:
    """The subscriptions to one topic: one for every way in which somebody publishes on it.

    The mutable state is, on the ROS thread, the type and the subscriptions; and the latest message, if it has not been
    handed over yet: of a flood of messages the last one counts.
    """

    def __init__(self, ros: RosThread, sense: Sense) -> None:
        self.sense = sense
        self._ros = ros
        self._kind: Any = None
        self._subscriptions: dict[tuple[bool, bool], Any] = {}
        self._waiting = False
        self._latest: Any = None
        self._foreign: set[str] = set()

    # on the event loop's thread

    async def is_there(self) -> bool:
        """Tell whether somebody publishes."""
        return bool(await self._ros.ask(lambda: self._subscriptions))

    def _take(self) -> None:
        self._waiting = False
        self.sense.hear(partial(value_at, self._latest))

    # on the ROS thread

    def resolve(self) -> None:
        """Find out the full name.

        Raises:
            InputError: it cannot be a name in ROS.
        """
        self._full_name = resolved(self._ros.node.resolve_topic_name, self.sense.instance, "topic")

    def look(self) -> None:
        """Subscribe to whoever is new."""
        from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

        for info in self._ros.node.get_publishers_info_by_topic(self._full_name):
            if self._fits(info.topic_type):
                profile = info.qos_profile
                reliable = profile.reliability == ReliabilityPolicy.RELIABLE
                self._subscribe(reliable, reliable and profile.durability == DurabilityPolicy.TRANSIENT_LOCAL)

    def destroy(self) -> None:
        """Subscribe no longer."""
        for subscription in self._subscriptions.values():
            self._ros.node.destroy_subscription(subscription)
        self._subscriptions.clear()

    def _fits(self, type_name: str) -> bool:
        """Tell whether messages of this type are understood; the first type that is there is the one, unless the file says it."""
        wanted = self.sense.instance.sensor.type
        if self._kind is None and not self.sense.refused:
            try:
                self._kind, self.sense.instance = checked(self.sense.instance, wanted or type_name)
                self._type_name = wanted or type_name
            except InputError as error:
                self._hand_over(partial(self.sense.refuse, error))
        if self._kind is None or type_name == self._type_name:
            return self._kind is not None
        if type_name not in self._foreign:
            self._foreign.add(type_name)
            _log.warning("%s is ignored where it has the type %s; expected %s", self.sense.instance.name, type_name, self._type_name)
        return False

    def _subscribe(self, reliable: bool, latched: bool) -> None:
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        if (reliable, latched) not in self._subscriptions:
            profile = QoSProfile(
                depth=DEPTH,
                reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
                durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
            )
            instance = self.sense.instance
            create = self._ros.node.create_subscription
            try:
                self._subscriptions[reliable, latched] = create(self._kind, instance.name, self._receive, profile)
            except Exception as error:  # this process uses the topic with another type, for example
                reason = f"{instance.name} cannot be listened to: {error}"
                self._hand_over(partial(self.sense.refuse, InputError(reason, instance.sensor.position)))

    def _receive(self, message: Any) -> None:
        self._latest = message
        if not self._waiting:
            self._waiting = True
            self._hand_over(self._take)

    def _hand_over(self, function: Callable[[], object]) -> None:
        try:
            self.sense.loop.call_soon_threadsafe(function)
        except RuntimeError:
            _log.debug("the event loop is closed; nobody hears of the message")
