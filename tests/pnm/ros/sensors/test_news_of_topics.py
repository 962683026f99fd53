"""Topics after an action has ended: what they have said before that is not taken for what the action has left."""

from __future__ import annotations

import asyncio
from contextlib import asynccontextmanager
from functools import partial
from typing import Any

import pytest

from pnm.ros.node.messages import import_type, to_message
from pnm.ros.node.ros_thread import profile
from tests.support.ros.child_process import bounded
from tests.support.ros.listening import becomes, opened

POINT = "geometry_msgs/msg/PointStamped"
BATTERY = ("battery", "r1")


@asynccontextmanager
async def published(ros, name, sensing, *, lag: float, latched: bool = False):
    """A sensor that has heard of 1.0 on its topic, and how to publish another number, stamped or not."""
    publisher = await ros.ask(lambda: ros.node.create_publisher(import_type(POINT), name, profile(9, latched=latched)))

    async def say(number: float, *, stamp: Any = None) -> None:
        header = {} if stamp is None else {"header": {"stamp": dict(zip(("sec", "nanosec"), stamp.seconds_nanoseconds(), strict=True))}}
        message = to_message(import_type(POINT), {"point": {"x": number}, **header})
        await ros.ask(partial(publisher.publish, message))
        await becomes(world, BATTERY, number)

    file = sensing(f"sensors: [{{topic: {name}, type: {POINT}, lag: {lag}, facts: [{{number: (battery r1), field: point.x}}]}}]")
    async with opened(ros, file) as (world, listener):
        await say(1.0)
        yield listener, say
    await ros.ask(lambda: ros.node.destroy_publisher(publisher))


@bounded
async def test_a_topic_is_waited_for_that_has_said_nothing_since_an_action_has_ended(ros, names, sensing):
    async with published(ros, names(), sensing, lag=1000.0) as (listener, say):
        await listener.refresh()
        before = ros.node.get_clock().now()
        listener.expect_news()
        refreshed = asyncio.create_task(listener.refresh())
        await asyncio.wait((refreshed,), timeout=0)
        assert not refreshed.done()
        await say(2.0, stamp=before)  # none of what was left
        await asyncio.wait((refreshed,), timeout=0)
        assert not refreshed.done()
        await say(3.0, stamp=ros.node.get_clock().now())
        await refreshed
        listener.expect_news()
        await say(4.0)
        await listener.refresh()


@bounded
@pytest.mark.parametrize(("lag", "latched"), [(0.05, False), (1000.0, True)])
async def test_no_longer_than_its_lag_and_not_if_it_is_latched(ros, names, sensing, lag, latched):
    async with published(ros, names(), sensing, lag=lag, latched=latched) as (listener, _):
        listener.expect_news()
        await listener.refresh()
