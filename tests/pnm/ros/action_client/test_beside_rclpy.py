"""Our action client beside that of `rclpy`: what servers do is reported alike."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Any
from uuid import uuid4

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from pnm_interfaces.action import GroundAction
from rclpy.action import ActionClient

from pnm.core.machine.bindings import Binding
from pnm.core.machine.requests import Accepted, Ended, Feedback, OutcomeKind
from pnm.ros.action_client.action_services import ActionServices
from pnm.ros.action_client.goal import OVER
from pnm.ros.node.ros_thread import RosThread, call_on_loop
from tests.support.processes import LIMIT

GOALS = st.one_of(
    st.tuples(st.sampled_from(["succeed", "abort", "reject", "raise", "oddly"]), st.just(("0.2",)), st.booleans()),
    st.tuples(st.sampled_from(["slow", "stubborn"]), st.sampled_from([("0.1",), ("0.3",)]), st.just(False)),
    st.tuples(st.just("stubborn"), st.just(("0.3",)), st.just(True)),
    st.tuples(st.sampled_from(["hang", "hesitate"]), st.just(("0.1",)), st.just(True)),
)
"""What a goal has its server do, and whether it is cancelled. Only those are that end alike whenever the server hears of it."""


class StockClient:
    """The action client of `rclpy`, of one server of GroundAction goals."""

    def __init__(self, ros: RosThread, server: str) -> None:
        self._ros = ros
        self._client: Any = ros.wait(lambda: ActionClient(ros.node, GroundAction, server))

    async def there(self) -> None:
        async with asyncio.timeout(LIMIT):
            while not await self._ros.ask(self._client.server_is_ready):  # noqa: ASYNC110 - the graph has no event
                await asyncio.sleep(0.02)

    async def outcome(self, goal: Mapping[str, Any], *, cancel: bool) -> tuple[bool, OutcomeKind, str]:
        """Send a goal, and cancel it when it is accepted; return whether it was accepted, and how it ended."""
        handle = await self._heard(lambda: self._client.send_goal_async(GroundAction.Goal(**goal)))
        if not handle.accepted:
            return False, OutcomeKind.REJECTED, ""
        if cancel:
            await self._heard(handle.cancel_goal_async)
        response = await self._heard(handle.get_result_async)
        return True, OVER[response.status], response.result.message

    async def _heard(self, ask: Callable[[], Any]) -> Any:
        loop = asyncio.get_running_loop()
        heard: asyncio.Future[Any] = loop.create_future()
        await self._ros.ask(lambda: ask().add_done_callback(lambda future: call_on_loop(loop, heard.set_result, future.result())))
        return await asyncio.wait_for(heard, LIMIT)

    def destroy(self) -> None:
        self._ros.wait(self._client.destroy)


@pytest.fixture(scope="module")
def stock(ros, shared):
    client = StockClient(ros, shared)
    yield client
    client.destroy()


async def outcome(client, action, arguments, *, cancel):
    """Send a goal, and cancel it when it is accepted; return whether it was accepted, and how it ended."""
    sent, was_accepted = client.send("act", action=action, arguments=[*arguments]), False
    async with asyncio.timeout(LIMIT):
        while not isinstance(report := await sent.reports.get(), Ended):
            assert not (isinstance(report, Feedback) and not was_accepted)
            if isinstance(report, Accepted):
                assert not was_accepted
                was_accepted = True
                if cancel:
                    client.cancel(sent)
    assert sent.reports.empty()
    kind, message = report.outcome.kind, report.outcome.message
    return was_accepted, kind, "" if kind is OutcomeKind.REJECTED else message


def steady(ended):
    """Leave out for how long it was at work."""
    was_accepted, kind, message = ended
    return was_accepted, kind, message.partition(" after")[0]


@settings(max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(GOALS, min_size=1, max_size=8))
def test_what_a_server_does_is_reported_as_by_rclpy(with_client, stock, shared, goals):
    async def scenario(client):
        await stock.there()
        ours = await asyncio.gather(*(outcome(client, action, arguments, cancel=cancel) for action, arguments, cancel in goals))
        theirs = await asyncio.gather(
            *(stock.outcome({"action": action, "arguments": [*arguments]}, cancel=cancel) for action, arguments, cancel in goals)
        )
        assert [*map(steady, ours)] == [*map(steady, theirs)]

    with_client(scenario, act=Binding(server=shared))


def test_an_answer_that_cannot_be_used_keeps_no_others_away(ros, shared, caplog):
    async def scenario():
        loop, answered = asyncio.get_running_loop(), asyncio.Event()
        services = await ros.ask(lambda: ActionServices(ros.node, GroundAction, f"/{shared}", answered_twice=print))

        def ask():
            services.ask_result(uuid4(), lambda response: 1 / 0)
            services.ask_result(uuid4(), lambda response: loop.call_soon_threadsafe(answered.set))

        async with asyncio.timeout(LIMIT):
            while not answered.is_set():
                if await ros.ask(services.is_served):  # it may not have discovered us yet
                    await ros.ask(ask)
                await asyncio.sleep(0.1)
        await ros.ask(services.destroy)

    asyncio.run(scenario())
    assert "cannot be used" in caplog.text
