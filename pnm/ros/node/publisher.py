"""A publisher that is used from the event loop's thread, and knows how many subscribe; and a limit for how often."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, Generic, TypeVar

from rclpy.event_handler import PublisherEventCallbacks

from pnm.ros.node.messages import import_type, to_message
from pnm.ros.node.ros_thread import RosThread, call_on_loop, profile

DEPTH: Final = 1000
"""Messages that slow subscribers may be behind."""


@dataclass(eq=False, repr=False)
class Publisher:
    """One topic to publish on. What is private, and the number of subscriptions, changes."""

    ros: RosThread
    type_name: str
    name: str
    is_latched: bool = False
    """Whether late subscribers get the last message, and no earlier one: until the last came they would believe that."""
    matched: Callable[[], None] = lambda: None
    """Called on the event loop's thread at every new subscription."""
    subscriptions: int = 0
    """The number of subscriptions, on the event loop's thread."""
    _publisher: Any = None
    """That of `rclpy`, on the ROS thread."""

    def __post_init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._type = import_type(self.type_name)

    async def open(self) -> None:
        """Advertise the topic."""

        def count(info: Any) -> None:
            self.subscriptions = info.current_count
            if info.current_count_change > 0:
                self.matched()

        def advertise() -> None:
            qos = profile(1 if self.is_latched else DEPTH, latched=self.is_latched)
            matched = PublisherEventCallbacks(matched=partial(call_on_loop, self._loop, count))
            self._publisher = self.ros.node.create_publisher(self._type, self.name, qos, event_callbacks=matched)

        await self.ros.ask(advertise)

    def publish(self, fields: Mapping[str, object] | Callable[[], Mapping[str, object]]) -> None:
        """Publish a message of these fields, or of those that a function returns on the ROS thread."""

        def publish() -> None:
            if self._publisher is not None:
                self._publisher.publish(to_message(self._type, fields() if callable(fields) else fields))

        self.ros.call(publish)

    async def close(self) -> None:
        """Withdraw the topic."""

        def withdraw() -> None:
            if self._publisher is not None:
                self.ros.node.destroy_publisher(self._publisher)
                self._publisher = None

        await self.ros.ask(withdraw)


# --- a rate limit: a call per key and period, at once after a pause; calls in between become one ----

K = TypeVar("K", bound=Hashable)


class Throttle(Generic[K]):
    """Calls a function for every key that was noted: in the next turn of the loop, or a period (seconds) after its last call.

    The mutable state is, by key, the timer of the call that is due and the time of the last call.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, period: float, function: Callable[[K], None]) -> None:
        self._loop = loop
        self._period = period
        self._function = function
        self._due: dict[K, asyncio.TimerHandle] = {}
        self._called: dict[K, float] = {}

    def note(self, key: K) -> None:
        """Make a call due, unless there is one."""
        if key not in self._due:
            at = self._called[key] + self._period if key in self._called else self._loop.time()
            self._due[key] = self._loop.call_at(at, self.at_once, key)

    def at_once(self, key: K) -> None:
        """Call now, however long the last call is ago, instead of a call that is due."""
        if key in self._due:
            self._due.pop(key).cancel()
        self._called[key] = self._loop.time()
        self._function(key)

    def forget(self, key: K) -> None:
        """Drop the call that is due for a key, and the time of its last call."""
        self._called.pop(key, None)
        if key in self._due:
            self._due.pop(key).cancel()

    def close(self) -> None:
        """Drop all calls that are due."""
        for key in (*self._due, *self._called):
            self.forget(key)
