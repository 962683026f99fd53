"""Our action client beside that of `rclpy`: what servers do is reported alike."""

from __future__ import annotations

import asyncio
from uuid import uuid4

import pytest
from hypothesis import HealthCheck, example, given, settings, strategies as st
from pnm_interfaces.action import GroundAction

from pnm.core.machine.bindings import Binding
from pnm.core.machine.requests import Accepted, Ended, Feedback, OutcomeKind
from pnm.ros.action_client.action_services import ActionServices
from pnm.ros.action_client.goal import OVER
from tests.support.ros.child_process import run_bounded
from tests.support.ros.task_client import StockClient

ENDS = ("succeed", "abort", "reject", "raise", "oddly")
GOALS = st.one_of(
    st.tuples(st.sampled_from(ENDS), st.just(("0.2",)), st.booleans()),
    st.tuples(st.sampled_from(["slow", "stubborn"]), st.sampled_from([("0.1",), ("0.3",)]), st.just(False)),
    st.tuples(st.just("stubborn"), st.just(("0.3",)), st.just(True)),
    st.tuples(st.sampled_from(["hang", "hesitate"]), st.just(("0.1",)), st.just(True)),
)
"""What a goal has its server do, and whether it is cancelled. Only those are that end alike whenever the server hears of it."""


@pytest.fixture(scope="module")
def stock(ros, shared):
    client = StockClient(ros, GroundAction, shared)
    yield client
    client.destroy()


async def our_outcome(client, action, arguments, *, cancel):
    """Send a goal, and cancel it when it is accepted; return whether it was accepted, and how it ended."""
    sent, was_accepted = client.send("act", action=action, arguments=[*arguments]), False
    while not isinstance(report := await sent.reports.get(), Ended):
        assert not (isinstance(report, Feedback) and not was_accepted)
        if isinstance(report, Accepted):
            assert not was_accepted
            was_accepted = True
            if cancel:
                client.cancel(sent)
    assert sent.reports.empty()
    kind, message = report.outcome.kind, report.outcome.message
    return was_accepted, kind, "" if kind is OutcomeKind.REJECTED else message.partition(" after")[0]


async def their_outcome(stock, action, arguments, *, cancel):
    """The same; for how long it was at work is left out by both."""
    sent = await stock.send({"action": action, "arguments": [*arguments]})
    if not sent.handle.accepted:
        return False, OutcomeKind.REJECTED, ""
    if cancel:
        await sent.cancel()
    status, result = await sent.result()
    return True, OVER[status], result["message"].partition(" after")[0]


@settings(max_examples=11, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(GOALS, min_size=1, max_size=8))
@example([*((action, ("0.2",), False) for action in ENDS), ("stubborn", ("0.3",), True), ("hang", ("0.1",), True)])
def test_what_a_server_does_is_reported_as_by_rclpy(connect, stock, shared, goals):
    async def scenario():
        client = connect(act=Binding(server=shared))
        await stock.met()
        ours, theirs = [
            await asyncio.gather(*(outcome(of, action, arguments, cancel=cancel) for action, arguments, cancel in goals))
            for outcome, of in ((our_outcome, client), (their_outcome, stock))
        ]
        assert ours == theirs

    run_bounded(scenario())


async def test_an_answer_that_cannot_be_used_keeps_no_others_away(ros, shared, caplog):
    loop, answered = asyncio.get_running_loop(), asyncio.Event()
    services = await ros.ask(lambda: ActionServices(ros.node, GroundAction, f"/{shared}", answered_twice=print))

    def ask():
        services.ask_result(uuid4(), lambda response: 1 / 0)
        services.ask_result(uuid4(), lambda response: loop.call_soon_threadsafe(answered.set))

    while not answered.is_set():
        if await ros.ask(services.is_served):  # it may not have discovered us yet
            await ros.ask(ask)
        await asyncio.sleep(0.1)
    await ros.ask(services.destroy)
    assert "cannot be used" in caplog.text
