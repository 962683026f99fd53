"""When the client of a goal hears that it is accepted, rejected or over."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any
from uuid import UUID

from pnm.core.machine.bindings import Binding
from pnm.core.machine.requests import OutcomeKind
from pnm.ros.action_server.goal_server import GoalServer
from pnm.ros.node.ros_thread import RosThread
from tests.support.ros.recording_client import RecordingClient

TYPE = "pnm_interfaces/action/AchieveGoal"
DONE = OutcomeKind.SUCCEEDED, lambda: {"message": "done"}


@asynccontextmanager
async def serving(
    two: tuple[RosThread, RosThread], connect: Callable[..., RecordingClient], accept: Callable[[GoalServer, UUID, str], Awaitable[str]]
) -> AsyncIterator[tuple[GoalServer, RecordingClient]]:
    """A server that decides about the texts of goals, and a client that sends them."""

    async def decide(goal: UUID, request: Any) -> str:
        return await accept(server, goal, request.goal)

    server = GoalServer(two[0], TYPE, "reach", decide, lambda goal: server.end(goal, *DONE))
    await server.open()
    yield server, connect(two[1], reach=Binding(type=TYPE))
    await server.close()


async def test_a_goal_is_accepted_when_its_server_has_decided_and_others_meanwhile(two, connect):
    kept, arrived = asyncio.Event(), asyncio.Event()

    async def accept(server: GoalServer, goal: UUID, text: str) -> str:
        if text == "slow":
            arrived.set()
            await kept.wait()
        return ""

    async with serving(two, connect, accept) as (_, client):
        slow = client.send("reach", goal="slow")
        await arrived.wait()
        await client.send("reach", goal="quick").accepted()
        assert slow.reports.empty()
        kept.set()
        await slow.accepted()


async def test_what_is_over_while_it_is_decided_about_is_accepted_first(two, connect):
    async def accept(server: GoalServer, goal: UUID, text: str) -> str:
        server.end(goal, *DONE)
        await asyncio.sleep(0.1)
        return ""

    async with serving(two, connect, accept) as (_, client):
        sent = client.send("reach", goal="over")
        await sent.accepted()
        outcome = await sent.ended()
        assert (outcome.kind, outcome.result["message"]) == (OutcomeKind.SUCCEEDED, "done")


async def test_a_goal_whose_server_died_before_it_answered_goes_on_in_the_next_process_that_has_it(two, connect):
    async def accept(server: GoalServer, goal: UUID, text: str) -> str:
        arrived.set()
        return await asyncio.get_running_loop().create_future()

    arrived = asyncio.Event()
    async with serving(two, connect, accept) as (server, client):
        sent = client.send("reach", goal="kept")
        await arrived.wait()
        server.vanish()
        next_node = RosThread("next", namespace=two[0].node.get_namespace())
        successor = GoalServer(next_node, TYPE, "reach", lambda *_: accept(successor, *_), lambda _: None)
        await successor.open([sent.id])
        await sent.accepted()
        successor.end(sent.id, *DONE)
        assert (await sent.ended()).kind is OutcomeKind.SUCCEEDED
        await successor.close()
        await asyncio.to_thread(next_node.close)


async def test_a_goal_is_rejected_for_a_reason_or_an_error_and_the_next_one_is_not(two, connect, caplog):
    async def accept(server: GoalServer, goal: UUID, text: str) -> str:
        if text == "error":
            raise ValueError("no such thing")
        return "" if text == "good" else "it is bad"

    async with serving(two, connect, accept) as (_, client):
        for text in ("bad", "error"):
            assert (await client.send("reach", goal=text).ended()).kind is OutcomeKind.REJECTED
        await client.send("reach", goal="good").accepted()
    assert "a goal for reach is rejected: it is bad" in caplog.text
    assert "a goal for reach is rejected: ValueError: no such thing" in caplog.text
