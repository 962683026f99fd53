"""Services that are asked when there is a reason: at the start, when the world may have changed, and when it must be known."""

from __future__ import annotations

import asyncio

from pnm.core.logic.expressions import UNKNOWN
from tests.support.ros.child_process import bounded
from tests.support.ros.listening import becomes, opened

KIND = "test_msgs/srv/BasicTypes"


def offered(name: str, **options: object) -> dict[str, object]:
    return {"service": name, "type": KIND, "fields": {"bool_value": True, "float64_value": 0.5}, **options}


@bounded
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


@bounded
async def test_a_dead_service_makes_unknown_what_it_reports_once_it_is_asked(ros, names, sensing, sensors, caplog):
    name = names()
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


@bounded
async def test_a_refresh_ends_although_a_service_is_not_there_does_not_answer_or_does_not_fit(ros, names, sensing, sensors):
    name = names()
    await asyncio.to_thread(sensors, offered(name, deaf=True))
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
