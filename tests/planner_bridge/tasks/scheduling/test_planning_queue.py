"""One after the other tries; who is slow is not waited for."""

from __future__ import annotations

import asyncio

from planner_bridge.tasks.context import SLOW, PlanningQueue
from pnm.clock import run_async


def test_who_is_overtaken_by_a_change_tries_again():
    async def scene() -> None:
        queue: PlanningQueue[str] = PlanningQueue(lambda who: (0, 0))
        for overtaken in (True, False):
            await queue.enter("a")
            if overtaken:
                queue.changed()
            queue.leave("a", failed=True)
            if not overtaken:
                asyncio.get_running_loop().call_later(10.0, queue.changed)
            began = asyncio.get_running_loop().time()
            async with asyncio.timeout(100.0):
                await queue.enter("a")
            assert asyncio.get_running_loop().time() == began + (0.0 if overtaken else 10.0)
            queue.leave("a")

    run_async(scene(), virtual=True)


def test_who_failed_beside_another_tries_again_when_that_one_has_planned_as_well():
    async def scene() -> None:
        queue: PlanningQueue[str] = PlanningQueue(lambda who: (0, ord(who)))
        await queue.enter("a")
        await queue.enter("b")
        queue.leave("b", failed=True)  # because of what a has in mind
        queue.leave("a", failed=True)  # and will not do
        async with asyncio.timeout(1.0):
            await queue.enter("b")

    run_async(scene(), virtual=True)


def test_those_who_are_slow_keep_nobody_waiting_but_for_a_moment():
    async def scene() -> list[tuple[str, float]]:
        queue: PlanningQueue[str] = PlanningQueue(lambda who: (0, ord(who)))
        await queue.enter("a")  # and does not leave
        through: list[tuple[str, float]] = []

        async def try_for(who: str, seconds: float) -> None:
            await queue.enter(who)
            through.append((who, asyncio.get_running_loop().time()))
            await asyncio.sleep(seconds)
            queue.leave(who)

        async with asyncio.timeout(100.0):
            await asyncio.gather(*(try_for(who, seconds) for who, seconds in (("b", 0.5), ("c", 5.0), ("d", 0.5), ("e", 0.5))))
        return through

    through = run_async(scene(), virtual=True)
    assert [who for who, _ in through] == ["b", "c", "d", "e"]
    times = [time - through[0][1] for _, time in through]
    assert times == [0.0, 0.5, 0.5 + SLOW, 1.0 + SLOW]


def test_after_a_change_everybody_has_a_turn_however_many_have_failed_before():
    async def scene() -> list[str]:
        queue: PlanningQueue[str] = PlanningQueue(lambda who: (0, ord(who)))
        tried: list[str] = []

        async def fail(who: str) -> None:
            await queue.enter(who)
            tried.append(who)
            queue.leave(who, failed=True)

        async with asyncio.timeout(100.0):
            await asyncio.gather(*map(fail, "abcdefghij"))
        return tried

    assert run_async(scene(), virtual=True) == [*"abcdefghij"]
