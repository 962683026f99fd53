"""The household's robots in this process: an action client that calls the simulator, and its sensors."""

from __future__ import annotations

import asyncio
from functools import partial
from uuid import UUID

from pyrobosim.core import World

from pnm.actions.backend import ClientBackend
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind, Reporter, Request
from pnm.core.message_fields import value_in
from pnm.knowledge.sensor_model import Instance, Sensing, instances, read
from tests.support.e2e.household.simulator import perform, world_state


class SimulatorClient:
    """Performs each request at once, and has what has changed reported before its end.

    Attributes:
        actions: how many were performed, attempts that failed included.
        spent: whether a battery was ever empty.
    """

    def __init__(self, world: World, bindings: Bindings) -> None:
        self.world = world
        self.actions = 0
        self.spent = False
        self.report_state = lambda: None
        self._bindings = bindings

    def goal_fields(self, action: GroundAction, /) -> tuple[str, ...]:
        """Return the fields of an `ExecuteTaskAction` goal."""
        return ("action", "realtime_factor")

    def send(self, request: Request, report: Reporter, /) -> None:
        """Perform the request in the next turn of the loop."""
        asyncio.get_running_loop().call_soon(self._perform, request, report)

    def cancel(self, request: UUID, /) -> None:
        """Do nothing: what was accepted is over."""

    def _perform(self, request: Request, report: Reporter) -> None:
        report(Accepted(request.id))
        result = perform(self.world, request.goal["action"])
        self.actions += 1
        self.spent |= any(robot.battery_level <= 0 for robot in self.world.robots)
        self.report_state()
        reached = Outcome(OutcomeKind.SUCCEEDED, {"execution_result": {"status": int(result.status), "message": result.message or ""}})
        report(Ended(request.id, self._bindings.of(request.action.name).judged(reached)))


class SimulatorBackend(ClientBackend):
    """The robots of a world, whose state is read by the sensors of a file after every action."""

    def __init__(self, world: World, bindings: Bindings, sensing: Sensing) -> None:
        super().__init__(SimulatorClient(world, bindings))
        self._world = world
        self._sensing = sensing

    async def open(self, knowledge: KnowledgeBase) -> None:
        """Report the state of the world, from now on after every action."""
        for name in self._sensing.names:
            knowledge.sense((name,), lag=0.0)
        sensors = instances(self._sensing, knowledge.objects)
        self.client.report_state = partial(self._report, knowledge, sensors)
        self.client.report_state()

    def _report(self, knowledge: KnowledgeBase, sensors: tuple[Instance, ...]) -> None:
        answer = {"state": world_state(self._world)}
        for sensor in sensors:
            reading = read(sensor, partial(value_in, answer), knowledge.objects)
            assert not reading.unread, reading.unread
            knowledge.update(reading.facts)
