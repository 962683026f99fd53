"""One after the other tries; who is slow is not waited for."""

from __future__ import annotations

import asyncio

from planner_bridge.tasks.context import SLOW, PlanningQueue
from tests.support.runs.simulated import in_virtual_time


def queue_by_name() -> PlanningQueue[str]:
    return PlanningQueue(lambda who: (0, ord(who)))


@in_virtual_time
async def test_who_is_overtaken_by_a_change_tries_again():
    queue = queue_by_name()
    for overtaken in (True, False):
        await queue.enter("a")
        if overtaken:
            queue.changed()
        queue.leave("a", failed=True)
        if not overtaken:
            asyncio.get_running_loop().call_later(10.0, queue.changed)
        began = asyncio.get_running_loop().time()
        await queue.enter("a")
        assert asyncio.get_running_loop().time() == began + (0.0 if overtaken else 10.0)
        queue.leave("a")


@in_virtual_time
async def test_who_failed_beside_another_tries_again_when_that_one_has_planned_as_well():
    queue = queue_by_name()
    await queue.enter("a")
    await queue.enter("b")
    queue.leave("b", failed=True)  # because of what a has in mind
    queue.leave("a", failed=True)  # and will not do
    async with asyncio.timeout(1.0):
        await queue.enter("b")


@in_virtual_time
async def test_those_who_are_slow_keep_nobody_waiting_but_for_a_moment():
    queue, through = queue_by_name(), list[tuple[str, float]]()
    await queue.enter("a")  # and does not leave

    async def try_for(who: str, seconds: float) -> None:
        await queue.enter(who)
        through.append((who, asyncio.get_running_loop().time()))
        await asyncio.sleep(seconds)
        queue.leave(who)

    await asyncio.gather(*(try_for(who, seconds) for who, seconds in (("b", 0.5), ("c", 5.0), ("d", 0.5), ("e", 0.5))))
    times = {who: time - through[0][1] for who, time in through}
    assert [*times.items()] == [("b", 0.0), ("c", 0.5), ("d", 0.5 + SLOW), ("e", 1.0 + SLOW)]


@in_virtual_time
async def test_after_a_change_everybody_has_a_turn_however_many_have_failed_before():
    queue, tried = queue_by_name(), list[str]()

    async def fail(who: str) -> None:
        await queue.enter(who)
        tried.append(who)
        queue.leave(who, failed=True)

    await asyncio.gather(*map(fail, "abcdefghij"))
    assert tried == [*"abcdefghij"]
