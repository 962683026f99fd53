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


class SimulatorBackend(ClientBackend):
    """The robots of a world: an action client that performs every request at once, after which sensors report what is so.

    Attributes:
        world: the simulator's.
        actions: how many were performed, attempts that failed included.
        spent: whether a battery was ever empty.
    """

    def __init__(self, world: World, bindings: Bindings, sensing: Sensing) -> None:
        super().__init__(self)
        self.world = world
        self.actions = 0
        self.spent = False
        self._bindings = bindings
        self._sensing = sensing
        self._sensors: tuple[Instance, ...] = ()

    async def open(self, knowledge: KnowledgeBase) -> None:
        """Report the state of the world, from now on after every action."""
        for name in self._sensing.names:
            knowledge.sense((name,), lag=0.0)
        self._knowledge = knowledge
        self._sensors = instances(self._sensing, knowledge.objects)
        self._report()

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
        self._report()
        ended = Outcome(OutcomeKind.SUCCEEDED, {"execution_result": {"status": int(result.status), "message": result.message or ""}})
        report(Ended(request.id, self._bindings.of(request.action.name).judged(ended)))

    def _report(self) -> None:
        answer = {"state": world_state(self.world)}
        for sensor in self._sensors:
            reading = read(sensor, partial(value_in, answer), self._knowledge.objects)
            assert not reading.unread, reading.unread
            self._knowledge.update(reading.facts)
