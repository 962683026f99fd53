"""Where actions are carried out: simulated robots in this process, or action servers of ROS 2.

A site is opened with the knowledge it shall keep up to date, and closed when the task is over.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable
from time import monotonic
from typing import TYPE_CHECKING, Any, Final, Protocol
from uuid import UUID

from pnm.actions.base import ActionClient
from pnm.actions.simulated import SimulatedRobots, sense
from pnm.bindings import Bindings
from pnm.effects import TimedChange
from pnm.errors import InputError
from pnm.knowledge import KnowledgeBase
from pnm.plan_graph import GroundAction
from pnm.reports import Reports
from pnm.sensing import NO_SENSING, Sensing
from pnm.sources.base import Source

if TYPE_CHECKING:
    from pnm.ros.knowledge_services import Find, KnowledgeServices
    from pnm.ros.node import RosThread
    from pnm.ros.sensing import SensedReports
    from pnm.ros.sensors import Sensors

DISCOVERY: Final = 10.0
"""Seconds that robots may take to appear which are started together with us; later, who is missing fails by name."""


class Site(Protocol):
    """Carries out actions and reports about the world."""

    @property
    def client(self) -> ActionClient:
        """What requests are sent to."""

    async def open(self, knowledge: KnowledgeBase) -> None:
        """Connect, and bring the knowledge up to date with what is observed."""

    async def share(self, mark: bytes, find: Find, source: Source) -> None:
        """Let whoever carries out a request ask, and change, what the run knows that has sent it.

        Args:
            mark: what the identities of all requests begin with.
            find: finds the knowledge by the identity of the request.
            source: asked for what runs do not know themselves.
        """

    def over(self, request: UUID, /) -> None:
        """Note that a request is over: nobody needs to know anything for it any more."""

    async def prepare(self, actions: Iterable[GroundAction]) -> tuple[str, ...]:
        """Get ready to carry out these actions; return the names of servers that are not there yet."""

    async def close(self) -> None:
        """Disconnect."""


def schedule(knowledge: KnowledgeBase, timed: Iterable[TimedChange], began: float) -> Callable[[], None]:
    """Let those facts change by themselves that nobody reports, so many seconds after the beginning; return what stops that."""
    loop = asyncio.get_running_loop()
    timers: list[asyncio.TimerHandle] = []
    for change in timed:
        assumed = {fluent: value for fluent, value in change.changes.items() if not knowledge.is_sensed(fluent)}
        timers.append(loop.call_at(began + change.time, knowledge.update, assumed))

    def stop() -> None:
        for timer in timers:
            timer.cancel()

    return stop


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

    async def share(self, mark: bytes, find: Find, source: Source) -> None:
        """Do nothing: simulated robots ask for nothing."""

    def over(self, request: UUID, /) -> None:
        """Do nothing."""

    async def prepare(self, actions: Iterable[GroundAction]) -> tuple[str, ...]:
        """Do nothing: simulated robots are always ready."""
        return ()

    async def close(self) -> None:
        """Stop the world."""
        self.robots.close()


class Ros2Site:
    """The action servers found in the ROS 2 graph, the facts published on `knowledge/sensed`, and sensors.

    Args:
        bindings: how actions are bound to servers.
        sensing: which topics and services speak of what.
        ros: the thread of a node that goes on when the site is closed; by default the site has one of its own.

    The mutable state is what `open` and `share` make.

    Raises:
        InputError: something is sensed of which the bindings say that it is assumed.
    """

    def __init__(self, bindings: Bindings, sensing: Sensing = NO_SENSING, ros: RosThread | None = None) -> None:
        for one in sorted(sensing.names & bindings.assumed):
            raise InputError(f"there is a sensor for {one}, which is among the 'assumed' of the bindings; expected one of the two")
        self._bindings = bindings
        self._shared = ros
        self._sensing = sensing
        self._sensed: SensedReports | None = None
        self._reports: Reports | None = None
        self._sensors: Sensors | None = None
        self._client: Any = None
        self._services: list[KnowledgeServices] = []
        self.ros: Any = ros
        """The thread of the node, once the site is open."""

    @property
    def client(self) -> ActionClient:
        """The client of every action server, once the site is open."""
        return self._client  # type: ignore[no-any-return]

    async def open(self, knowledge: KnowledgeBase) -> None:
        """Join the ROS 2 graph and wait for the first report about the world, if anybody publishes one.

        Raises:
            InputError: a sensor cannot be used.
        """
        from pnm.ros.action_client import Ros2ActionClient  # here, because rclpy is an extra
        from pnm.ros.node import RosThread
        from pnm.ros.sensing import SensedReports
        from pnm.ros.sensors import Sensors

        loop = asyncio.get_running_loop()
        self.ros = self._shared or RosThread("pnm_run")  # `pnm` is the one that serves
        self._client = Ros2ActionClient(self.ros, self._bindings, loop)
        lag, sensing = self._bindings.lag, self._sensing
        self._sensors = Sensors(self.ros, sensing, knowledge, lag)
        ignored = {
            **dict.fromkeys(knowledge.rules.derived, "its facts follow from rules"),
            **dict.fromkeys(sensing.names, "there is a sensor for it"),
            **dict.fromkeys(self._bindings.assumed, ""),
        }
        self._reports = Reports(knowledge, ignored, lag, sensing.stale, sensing.signatures)
        self._sensed = SensedReports(self.ros, loop, self._reports.tell)
        await self._sensors.open()
        await self._sensed.first(DISCOVERY)

    async def share(self, mark: bytes, find: Find, source: Source) -> None:
        """Offer the two services that action servers find by the identity of their goal."""
        from pnm.ros.goal_ids import service_prefix
        from pnm.ros.knowledge_services import KnowledgeServices

        self._services.append(KnowledgeServices(self.ros, asyncio.get_running_loop(), service_prefix(mark), find, source))
        await self._services[-1].open()

    def over(self, request: UUID, /) -> None:
        """Withdraw what a server is still asking for the request."""
        for services in self._services:
            services.end(request)

    async def prepare(self, actions: Iterable[GroundAction]) -> tuple[str, ...]:
        """Look for the servers of these actions; wait for them only while this node itself is new."""
        missing: tuple[str, ...] = await self._client.prepare(actions, self.ros.joined + DISCOVERY - monotonic())
        return missing

    async def close(self) -> None:
        """Leave the ROS 2 graph."""
        if self._reports is not None:
            self._reports.close()
        if self._sensors is not None:
            await self._sensors.close()
        for services in self._services:
            await services.close()
        if self._client is not None:
            self._client.close()
        if self._sensed is not None:
            self._sensed.close()
        if self.ros is not None and self._shared is None:
            await asyncio.to_thread(self.ros.close)  # what still happens on its thread may need this loop
