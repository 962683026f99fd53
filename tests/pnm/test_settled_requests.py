"""Requests that end as a person says."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from uuid import UUID

import pytest

from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.conditions import TRUE
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import ActionCall, GroundAction, PlanGraph
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind, Report, Request
from pnm.executor import Executor

BINDINGS = Bindings({"look": Binding(store={"place": "seen"}, retries=0)})


class Client:
    """A robot that is at work until it is cancelled, and ends then in this way, with a result whose fields are as they begin."""

    def __init__(self, ends: OutcomeKind) -> None:
        self._ends = ends
        self._hear: dict[UUID, Callable[[Report], object]] = {}
        self.accepted = asyncio.Event()
        self.requests: list[UUID] = []

    def send(self, request: Request, hear: Callable[[Report], object]) -> None:
        self._hear[request.id] = hear
        self.requests.append(request.id)
        hear(Accepted(request.id))
        self.accepted.set()

    def cancel(self, request: UUID) -> None:
        self._hear.pop(request)(Ended(request, Outcome(self._ends, {"place": "nowhere"})))


@pytest.mark.parametrize(("ends", "seen"), [(OutcomeKind.CANCELED, None), (OutcomeKind.ABORTED, None), (OutcomeKind.SUCCEEDED, "nowhere")])
def test_what_a_server_gives_back_that_was_stopped_is_no_result(ends: OutcomeKind, seen: str | None) -> None:
    async def course() -> tuple[bool, object]:
        plan = PlanGraph((ActionCall(0, GroundAction("look")),), (), goal=TRUE)
        knowledge = Layered(KnowledgeBase(), KnowledgeBase())
        client = Client(ends)
        executor = Executor(Run(generate(plan, BINDINGS), knowledge, bindings=BINDINGS, id=UUID(int=1)), client)
        running = asyncio.ensure_future(executor.execute())
        await client.accepted.wait()
        executor.settle(client.requests[0], OutcomeKind.SUCCEEDED)
        result = await running
        value = knowledge.local.variable("seen")
        return result.goal, value if value == "nowhere" else None

    assert asyncio.run(asyncio.wait_for(course(), 60)) == (True, seen)
