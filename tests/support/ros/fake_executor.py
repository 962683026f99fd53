"""The executor of a run as far as action servers see it: sends goals, and answers what they ask."""

from __future__ import annotations

import asyncio
import json
import os
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Any
from uuid import UUID, uuid4, uuid5

from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.machine.bindings import Binding
from pnm.core.machine.requests import Outcome, OutcomeKind
from pnm.knowledge.source import Asker, MemoryKnowledge, Source
from pnm.knowledge.sources import Sources
from pnm.ros.knowledge import KnowledgeServices, service_prefix
from pnm.ros.node.ros_thread import RosThread
from tests.support.ros.recording_client import GROUND, RecordingClient, Sent


@dataclass
class FakeExecutor:
    """One run, whose local variables are `local`, and its goals."""

    ros: RosThread
    sources: Source
    local: KnowledgeBase = field(default_factory=KnowledgeBase)
    mark: bytes = field(default_factory=lambda: os.urandom(4))
    goals: dict[UUID, asyncio.Task[Outcome]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        loop = asyncio.get_running_loop()
        self.run = self.new_id()
        self.name = service_prefix(self.mark)
        self.services = KnowledgeServices(self.ros, loop, self.name, self.find, self.sources)
        self.clients: dict[str, RecordingClient] = {}

    def new_id(self) -> UUID:
        """Return an id as the runs and goals of this executor have them."""
        return UUID(bytes=self.mark + uuid5(uuid4(), "goal").bytes[4:])

    def find(self, goal: UUID) -> tuple[Layered, Asker] | None:
        return (Layered(KnowledgeBase(), self.local), Asker(self.run, "tour")) if goal in self.goals else None

    def send(self, server: str, action: str, *arguments: object, id: UUID | None = None) -> asyncio.Task[Outcome]:
        """Send a goal; the task ends with its outcome."""
        sent = self.client(server).send("do", id or self.new_id(), action=action, arguments=[json.dumps(one) for one in arguments])
        self.goals[sent.id] = asyncio.ensure_future(self._ended(sent))
        return self.goals[sent.id]

    async def _ended(self, sent: Sent) -> Outcome:
        try:
            return await sent.ended()
        finally:
            del self.goals[sent.id]
            self.services.end(sent.id)

    def client(self, server: str) -> RecordingClient:
        if server not in self.clients:
            self.clients[server] = RecordingClient(self.ros, do=Binding(server=server, type=GROUND))
        return self.clients[server]

    async def meet(self, server: str) -> None:
        """Send a goal that matters to nobody until one is answered: what is answered at a first contact may be lost on the way."""
        for _ in range(3):
            if (await self.send(server, "query", "local", "nothing")).kind is not OutcomeKind.UNAVAILABLE:
                return

    async def said(self, server: str, action: str, *arguments: object) -> Any:
        """Send a goal and return what came of it: a list with the value or nothing in it, or the text of an error."""
        outcome = await self.send(server, action, *arguments)
        assert outcome.kind is OutcomeKind.SUCCEEDED, outcome
        return json.loads(outcome.message)

    async def close(self) -> None:
        await self.services.close()
        for client in self.clients.values():
            client.ros2.close()
        await self.sources.close()


@asynccontextmanager
async def fake_executor(
    ros: RosThread, shared: Sequence[Source] | None = None, person: Source | None = None
) -> AsyncIterator[FakeExecutor]:
    """Open an executor with global knowledge in memory, or these."""
    one = FakeExecutor(ros, Sources([MemoryKnowledge()] if shared is None else shared, person))
    await one.services.open()
    try:
        yield one
    finally:
        await one.close()
