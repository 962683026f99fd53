"""The state topic of simulated robots: complete reports about the predicates and functions that they sense."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Any, Final

from rclpy.event_handler import PublisherEventCallbacks
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from pnm.actions.simulated_world import SimulatedWorld
from pnm.core.logic.expressions import Fluent, Unknown, Value
from pnm.ros.node.messages import import_type, to_message
from pnm.ros.node.ros_thread import RosThread
from pnm.ros.sensors.state_topic import TOPIC, write_state

STATE: Final = "pnm_interfaces/msg/State"


DEPTH: Final = 10


class StatePublisher:
    """Reports the named predicates and functions in full, once per turn of the loop in which something changed.

    The mutable state is the number of reports, and whether one is due.
    """

    def __init__(self, ros: RosThread, loop: asyncio.AbstractEventLoop, world: SimulatedWorld, names: frozenset[str]) -> None:
        self._ros = ros
        self._loop = loop
        self._world = world
        self._names = names
        self._type = import_type(STATE)
        self._publisher: Any = None
        self._sequence = 0
        self._due = False

    async def open(self, heard: Callable[[], None]) -> None:
        """Publish the state as it is, and every later one; call `heard` when somebody listens, again and again."""
        # latched, so that whoever comes later learns the state at once
        latched = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        callbacks = PublisherEventCallbacks(matched=lambda _: self._loop.call_soon_threadsafe(heard))
        self._publisher = await self._ros.ask(
            lambda: self._ros.node.create_publisher(self._type, TOPIC, latched, event_callbacks=callbacks)
        )
        self._world.truth.listen(self._changed)
        self._publish()

    def _changed(self, changes: Mapping[Fluent, Value | Unknown]) -> None:
        if not self._due:
            self._due = True
            self._loop.call_soon(self._publish)

    def _publish(self) -> None:
        self._due = False
        self._sequence += 1
        message = to_message(self._type, write_state(self._names, self._world.report(self._names), self._sequence))
        self._ros.call(lambda: self._publisher.publish(message))
