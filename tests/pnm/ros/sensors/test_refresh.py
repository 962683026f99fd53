"""What is asked, and what is waited for, when the world may have changed and when it must be known.

Services are asked at the start too; what topics have said before an action has ended is not taken for what it has left.
"""

from __future__ import annotations

import asyncio
from contextlib import asynccontextmanager
from functools import partial
from typing import Any

import pytest

from pnm.core.logic.expressions import UNKNOWN
from pnm.ros.node.messages import import_type, to_message
from pnm.ros.node.ros_thread import profile
from pnm.ros.node.services import until_true
from tests.support.ros.listening import becomes, opened

# --- services ---

KIND = "test_msgs/srv/BasicTypes"


def offered(name: str, **options: object) -> dict[str, object]:
    return {"service": name, "type": KIND, "fields": {"bool_value": True, "float64_value": 0.5}, **options}


async def test_a_service_that_is_never_polled_is_asked_for_every_reason_and_no_more(ros, names, sensing, sensors):
    name, polled = names(), names()
    await asyncio.to_thread(sensors, offered(name), offered(polled))
    file = sensing(f"""
        sensors:
          - {{service: {name}, every: never, limit: 5, facts: [{{number: (battery r1), field: float64_value}}]}}
          - {{service: {polled}, every: 0.01, facts: [{{number: (battery a1), field: float64_value}}]}}""")
    assert file.lags(1.0) == {"battery": 10.0}
    async with opened(ros, file) as (world, listener):
        await becomes(world, ("battery", "r1"), 0.5)
        for _ in range(3):
            world.update({("battery", "r1"): 9.0})
            await listener.refresh()
            assert world.value(("battery", "r1")) == 0.5
            world.update({("battery", "r1"): 9.0})
            for _ in range(20):
                world.update({("battery", "a1"): 9.0})
                await becomes(world, ("battery", "a1"), 0.5)
            assert world.value(("battery", "r1")) == 9.0


async def test_a_dead_service_makes_unknown_what_it_reports_once_it_is_asked(ros, name, names, sensing, sensors, caplog):
    process = await asyncio.to_thread(sensors, offered(name))
    file = sensing(f"""
        sensors:
          - {{service: {name}, every: never, limit: 0.5, stale: 0.3, facts: [{{fact: (dark), field: bool_value}}]}}
          - {{topic: {names()}, type: test_msgs/msg/BasicTypes, stale: 3, facts: [{{number: (battery r1), field: float64_value}}]}}""")
    async with opened(ros, file) as (world, listener):
        await becomes(world, ("dark",), True)
        await asyncio.to_thread(process.kill)
        await becomes(world, ("battery", "r1"), UNKNOWN)
        assert world.value(("dark",)) is True, "nothing is expected of a service that is not asked"
        await listener.refresh()
        await becomes(world, ("dark",), UNKNOWN)
        await asyncio.to_thread(sensors, offered(name))
        await becomes(world, ("dark",), True)
    assert f"nothing was heard on {name} for 0.3 s; its facts are unknown" in caplog.text


async def test_a_refresh_ends_although_a_service_is_not_there_does_not_answer_or_does_not_fit(ros, name, names, sensing, sensors):
    await asyncio.to_thread(sensors, offered(name, deaf=True))
    await until_true(ros, lambda: ros.node.count_services(name))
    file = sensing(f"""
        sensors:
          - {{service: {name}, every: never, limit: 0.2, facts: [{{fact: (dark), field: bool_value}}]}}
          - {{service: {names()}, every: never, limit: 0.2, facts: [{{number: (battery r1), field: float64_value}}]}}
          - {{service: {name}, limit: 0.2, facts: [{{number: (battery a1), field: flaot64_value}}]}}""")
    async with opened(ros, file) as (_, listener):
        await listener.refresh()
        *fitting, unfit = (use.refused for use in listener.uses())
        assert fitting == [None, None]
        assert "BasicTypes_Response has no field 'flaot64_value'" in str(unfit)
    await listener.refresh()


# --- topics ---

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


@pytest.mark.parametrize(("lag", "latched"), [(0.05, False), (1000.0, True)])
async def test_no_longer_than_its_lag_and_not_if_it_is_latched(ros, names, sensing, lag, latched):
    async with published(ros, names(), sensing, lag=lag, latched=latched) as (listener, _):
        listener.expect_news()
        await listener.refresh()
