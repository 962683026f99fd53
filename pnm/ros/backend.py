"""The ROS 2 execution backend: the action servers, state reports and sensors of the ROS graph."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable
from time import monotonic
from typing import Any, Final
from uuid import UUID

from pnm.clock import follow_real_time
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.domain import Vocabulary
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import ActionClient
from pnm.core.readiness import Readiness, ReadyState
from pnm.errors import InputError
from pnm.knowledge.sensor_model import NO_SENSING, Objects, Sensing, instances, unknown
from pnm.knowledge.source import FindKnowledge, Source
from pnm.knowledge.state_reports import StateReports
from pnm.ros.action_client.client import Ros2ActionClient
from pnm.ros.knowledge import KnowledgeServices, service_prefix
from pnm.ros.node.graph import server_name, snapshot
from pnm.ros.node.ros_thread import RosThread
from pnm.ros.readiness import action_readiness, open_readiness, sensor_readiness, server_calls
from pnm.ros.sensors import Sensors, resolved
from pnm.ros.sim_time import USE_SIM_TIME, follow_sim_time
from pnm.ros.state_topic import TOPIC, SensedReports

DISCOVERY: Final = 10.0
"""Seconds to wait for servers and reports of robots that are started together with this node."""
_LOOK: Final = 0.25
_FINAL: Final = frozenset({ReadyState.READY, ReadyState.UNFIT, ReadyState.OPEN})
"""States that waiting does not change."""
"""Seconds between two looks at the ROS graph while something is waited for."""


class Ros2Backend:
    """The action servers found in the ROS 2 graph, the facts published on `knowledge/sensed`, and sensors.

    Args:
        known: the declared names, which reports are checked against; None if nothing is declared.
        ros: the thread of a node that goes on when the backend is closed; by default the backend has one of its own.
        sim_time: whether time is that of a simulation, from ``/clock``.
        may_act: whether something may be sent; asked by any thread, right before that.
        prefix: the first bytes of the ids of all goals that processes of this node send; empty if they have none in common.
        kept: goals of another process of this node that this one goes on with.

    The mutable state is what `open` and `share` make.

    Raises:
        InputError: a fluent has a sensor and is among the assumed ones of the bindings.
    """

    def __init__(
        self,
        bindings: Bindings,
        sensing: Sensing = NO_SENSING,
        known: Vocabulary | None = None,
        ros: RosThread | None = None,
        *,
        sim_time: bool = False,
        prefix: bytes = b"",
        kept: Iterable[UUID] = (),
        may_act: Callable[[], bool] = lambda: True,
    ) -> None:
        self._prefix = prefix
        self._kept = kept
        for name in sorted(sensing.names & bindings.assumed):
            raise InputError(f"there is a sensor for {name}, which is among the 'assumed' of the bindings; expected one of the two")
        self._bindings = bindings
        self._shared = ros
        self._sim_time = sim_time
        self._may_act = may_act
        self._sensing = sensing
        self._known = known
        self._knowledge = KnowledgeBase()
        self._sensed: SensedReports | None = None
        self._reports: StateReports | None = None
        self._sensors: Sensors | None = None
        self._client: Any = None
        self._services: list[KnowledgeServices] = []
        self.ros: Any = ros
        """The thread of the node, once the backend is open."""

    @property
    def client(self) -> ActionClient:
        """The client of every action server, once the backend is open."""
        return self._client  # type: ignore[no-any-return]

    async def open(self, knowledge: KnowledgeBase) -> None:
        """Join the ROS 2 graph and wait for the first report about the world, if there is a publisher of reports."""
        loop, self._knowledge = asyncio.get_running_loop(), knowledge
        self.ros = self._shared or RosThread("pnm_run", args=USE_SIM_TIME if self._sim_time else ())  # `pnm` is the one that serves
        if self._shared is None:
            await follow_sim_time(self.ros)
        lag, sensing = self._bindings.lag, self._sensing
        self._sensors = Sensors(self.ros, sensing, knowledge, lag)
        from pnm.ros.action_client.other_goals import OtherGoals  # here, because rclpy is an extra

        self._others = OtherGoals(self.ros, self._prefix, self._kept, self._may_act)
        self._client = Ros2ActionClient(self.ros, self._bindings, loop, self._ended, self._others, self._may_act)
        ignored = {
            **dict.fromkeys(knowledge.rules.derived, "its facts follow from rules"),
            **dict.fromkeys(sensing.names, "there is a sensor for it"),
            **dict.fromkeys(self._bindings.assumed, ""),
        }
        self._reports = StateReports(knowledge, ignored, lag, sensing.stale, self._known, TOPIC)
        self._sensed = SensedReports(self.ros, loop, self._reports.record, self._reports.refuse)
        await self._sensors.open()
        await self._sensed.first(DISCOVERY)

    async def check(
        self, actions: Iterable[GroundAction] = (), wait: float = 0.0, known: Vocabulary | None = None
    ) -> tuple[Readiness, ...]:
        """Return how ready the servers of all declared actions and of these, and all sensors are.

        What is not there is looked for until this node has discovered the others, and for `wait` seconds.

        Raises:
            InputError: the name of a server is not valid in ROS.
        """
        until, has_settled = monotonic() + wait, False
        while True:
            rows = await self.look(actions, known)
            if all(row.state in _FINAL for row in rows) or (has_settled and monotonic() >= until):
                return rows
            if not has_settled:
                await self.ros.settled()
                has_settled = True
            else:
                await asyncio.sleep(_LOOK)

    async def check_sensors(self, sensing: Sensing, objects: Objects) -> None:
        """Raise an `InputError` if these sensors cannot be those of another world: two report the same, or a name is not valid in ROS."""
        every = instances(sensing, objects)
        await self.ros.ask(lambda: [resolved(self.ros.node.resolve_topic_name, instance, "sensor") for instance in every])

    async def sense_objects(self, sensing: Sensing) -> None:
        """Have the sensors report on the objects that are known now, if these are others than before."""
        if self._sensors is not None and instances(sensing, self._knowledge.objects) != self._sensors.instances:
            await self._sensors.close()
            self._sensors = Sensors(self.ros, sensing, self._knowledge, self._bindings.lag)
            await self._sensors.open()

    async def look(self, actions: Iterable[GroundAction] = (), known: Vocabulary | None = None) -> tuple[Readiness, ...]:
        """Return how ready they are at this moment, as far as this node has discovered the others; see `check`."""
        known = known or self._known or Vocabulary({})
        every = dict.fromkeys((*server_calls(known, self._bindings), *actions))
        calls = [call for call in every if self._bindings.names_server(call)]
        bound = {call: (self._bindings.server(call), self._bindings.of(call.name).position) for call in calls}
        node = self.ros.node
        servers = await self.ros.ask(lambda: {call: server_name(node, *named) for call, named in bound.items()})
        graph, topic = await self.ros.ask(lambda: (snapshot(node), str(node.resolve_topic_name(TOPIC))))
        await self.ros.ask(lambda: [self._others.watch(server) for server in {*servers.values()} & graph.servers.keys()])
        uses = self._sensors.uses() if self._sensors else ()
        sensed = (unknown(use.instance, self._knowledge.objects).variables for use in uses)
        variables = frozenset(self._knowledge.variables()).union(*sensed)
        reports = self._reports.readiness(topic, graph.topics.get(topic, ())) if self._reports else ()
        rows = (*action_readiness(servers, self._bindings, known, graph, variables, self._patience), *sensor_readiness(uses, graph))
        return *rows, *open_readiness([call for call in every if call not in bound], self._bindings), *reports

    async def refresh(self) -> None:
        """Ask the services that are sensors, and wait for their answers, within their limits."""
        if self._sensors is not None:
            await self._sensors.refresh()

    def declare(self, known: Vocabulary) -> None:
        """Check reports against these names from now on."""
        self._known = known
        if self._reports is not None:
            self._reports.declare(known)

    async def share(self, mark: bytes, find: FindKnowledge, source: Source) -> None:
        """Offer the two services that action servers find by the identity of their goal."""
        self._services.append(KnowledgeServices(self.ros, asyncio.get_running_loop(), service_prefix(mark), find, source))
        await self._services[-1].open()

    def _ended(self, request: UUID) -> Awaitable[object]:
        """Withdraw what a server is still asking for a request that is over, and ask how the world is now."""
        for services in self._services:
            services.end(request)
        if self._sensors is not None:
            self._sensors.expect_news()
        return self.refresh()

    async def prepare(self, actions: Iterable[GroundAction]) -> tuple[str, ...]:
        """Look for the servers of these actions that have names already; wait for them only while this node itself is new."""
        named = [action for action in actions if self._bindings.names_server(action)]
        return await self._client.prepare(named, self._patience)  # type: ignore[no-any-return]

    async def busy_elsewhere(self) -> tuple[str, ...]:
        """Return the action servers that are at work on goals of other programs, or on goals that this node has forgotten."""
        return await self.ros.ask(self._others.busy_servers)  # type: ignore[no-any-return]

    @property
    def _patience(self) -> float:
        """Seconds for which servers are waited for: while this node itself is new."""
        return max(0.0, float(self.ros.joined) + DISCOVERY - monotonic())

    async def close(self) -> None:
        """Leave the ROS 2 graph; a simulation whose time was followed may have left before."""
        if self._shared is None:
            follow_real_time()
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
