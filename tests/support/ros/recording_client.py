"""A client whose reports can be awaited."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Any, Final
from uuid import UUID, uuid4

from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Accepted, Ended, Outcome, Postponed, Report, Request
from pnm.ros.action_client.client import Ros2ActionClient
from pnm.ros.node.ros_thread import RosThread
from tests.support.processes import LIMIT

GROUND: Final = "pnm_interfaces/action/GroundAction"


@dataclass
class Sent:
    """A request that was sent, and the reports about it."""

    request: Request
    reports: asyncio.Queue[Report] = field(default_factory=asyncio.Queue)

    @property
    def id(self) -> UUID:
        return self.request.id

    async def accepted(self, limit: float = LIMIT) -> None:
        async with asyncio.timeout(limit):
            while isinstance(report := await self.reports.get(), Postponed):
                assert report.request == self.id
        assert report == Accepted(self.id)

    async def ended(self, limit: float = LIMIT) -> Outcome:
        """Return the outcome; there must not be a second one."""
        async with asyncio.timeout(limit):
            while True:
                report = await self.reports.get()
                if isinstance(report, Ended):
                    assert report.request == self.id
                    assert self.reports.empty()
                    return report.outcome


class RecordingClient:
    """A client with one binding per action name, and the requests sent through it."""

    def __init__(self, ros: RosThread, ended: Callable[[UUID], Awaitable[object]] | None = None, **bindings: Binding) -> None:
        options: dict[str, Any] = {} if ended is None else {"ended": ended}
        self.may_act = True
        self.ros2 = Ros2ActionClient(ros, Bindings(bindings), asyncio.get_running_loop(), **options, may_act=lambda: self.may_act)

    def send(self, name: str, /, id: UUID | None = None, **goal: object) -> Sent:
        sent = Sent(Request(id or uuid4(), GroundAction(name), goal))
        self.ros2.send(sent.request, sent.reports.put_nowait)
        return sent

    def reattach(self, name: str, /, **goal: object) -> Sent:
        sent = Sent(Request(uuid4(), GroundAction(name), goal))
        self.ros2.reattach(sent.request, sent.reports.put_nowait, accepted=False)
        return sent

    def cancel(self, sent: Sent) -> None:
        self.ros2.cancel(sent.id)
