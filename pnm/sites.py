"""Where actions are carried out: simulated robots in this process, or action servers of ROS 2.

A site is opened with the knowledge it shall keep up to date, and closed when the task is over.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Iterable
from time import monotonic
from typing import Final, Protocol

from pnm.actions.base import ActionClient
from pnm.actions.simulated import SimulatedRobots, sense
from pnm.bindings import Bindings
from pnm.knowledge import KnowledgeBase
from pnm.plan_graph import GroundAction

DISCOVERY: Final = 10.0
"""Seconds that robots may take to appear which are started together with us; later, who is missing fails by name."""

_log = logging.getLogger(__name__)


class Site(Protocol):
    """Carries out actions and reports about the world."""

    @property
    def client(self) -> ActionClient:
        """What requests are sent to."""

    async def open(self, knowledge: KnowledgeBase) -> None:
        """Connect, and bring the knowledge up to date with what is observed."""

    async def prepare(self, actions: Iterable[GroundAction]) -> None:
        """Get ready to carry out these actions."""

    async def close(self) -> None:
        """Disconnect."""


class RobotsSite:
    """Simulated robots in this process; under virtual time a run takes no time at all."""

    def __init__(self, robots: SimulatedRobots, assumed: frozenset[str] = frozenset()) -> None:
        self.robots = robots
        self._assumed = assumed

    @property
    def client(self) -> ActionClient:
        """The robots."""
        return self.robots

    async def open(self, knowledge: KnowledgeBase) -> None:
        """Start the world's clock and let knowledge be told of everything that is sensed."""
        sense(self.robots.world, knowledge, self._assumed)
        self.robots.begin()

    async def prepare(self, actions: Iterable[GroundAction]) -> None:
        """Do nothing: simulated robots are always ready."""

    async def close(self) -> None:
        """Stop the world."""
        self.robots.close()


class Ros2Site:
    """The action servers found in the ROS 2 graph, and the facts published on `knowledge/sensed`."""

    def __init__(self, bindings: Bindings) -> None:
        self._bindings = bindings

    @property
    def client(self) -> ActionClient:
        """The client of every action server."""
        return self._client

    async def open(self, knowledge: KnowledgeBase) -> None:
        """Join the ROS 2 graph and wait for the first report about the world, if anybody publishes one."""
        from pnm.ros.action_client import Ros2ActionClient  # here, because rclpy is an extra
        from pnm.ros.node import RosThread
        from pnm.ros.sensing import Facts, Sensing

        loop = asyncio.get_running_loop()
        self.ros = RosThread("pnm")
        self._client = Ros2ActionClient(self.ros, self._bindings, loop)
        lag = self._bindings.lag

        ignored: set[str] = set()

        def tell(names: frozenset[str], facts: Facts, _sequence: int) -> None:
            for name in sorted(names & knowledge.rules.derived - ignored):
                _log.warning("reports about %s are ignored: its facts follow from rules", name)
                ignored.add(name)
            watched = names - self._bindings.assumed
            knowledge.sense(watched, lag=lag)
            knowledge.replace(watched, {fluent: value for fluent, value in facts.items() if fluent[0] in watched})

        self._sensing = Sensing(self.ros, loop, tell)
        await self._sensing.first(DISCOVERY)

    async def prepare(self, actions: Iterable[GroundAction]) -> None:
        """Look for the servers of these actions; wait for them only while this node itself is new."""
        await self._client.prepare(actions, self.ros.joined + DISCOVERY - monotonic())

    async def close(self) -> None:
        """Leave the ROS 2 graph."""
        self._client.close()
        self.ros.close()
