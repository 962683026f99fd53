"""The virtual clock jumps to timers however late they are; the time of a loop that follows another clock stands still with it."""

from __future__ import annotations

import asyncio
import gc
import math
import selectors
import threading
from weakref import ref

import pytest
from hypothesis import example, given, strategies as st

from pnm.clock import FollowingLoop, VirtualTimeLoop, collect_if_due, follow_real_time, in_own_thread, short_pauses
from tests.support.processes import LIMIT


def in_virtual_time(main):
    """Run a coroutine under virtual time; one that hangs is cancelled."""

    async def watched():
        loop, task = asyncio.get_running_loop(), asyncio.current_task()
        watch = threading.Timer(LIMIT, lambda: loop.call_soon_threadsafe(task.cancel))
        watch.daemon = True
        watch.start()
        try:
            return await main()
        finally:
            watch.cancel()

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        return runner.run(watched())


@pytest.mark.parametrize("late", [0.1, 2.0**24 - 0.1, 2.0**24, 1.7e7, 3e9 + 0.3, 1e15, 1e17, 1e300])
def test_no_time_is_too_late_for_a_timer(late):
    async def main():
        loop, moments = asyncio.get_running_loop(), []
        await asyncio.sleep(late)
        moments.append(loop.time())
        for seconds in (0.0, 1e-9, 1.0):
            due = loop.time() + seconds
            fired = loop.create_future()
            loop.call_at(due, fired.set_result, None)
            await fired
            assert loop.time() == pytest.approx(due, abs=1e-9)
        await asyncio.wait((asyncio.create_task(asyncio.sleep(2.0)), asyncio.create_task(asyncio.sleep(1.0))))
        return moments

    assert in_virtual_time(main) == [late]


@pytest.mark.parametrize("loop_factory", [VirtualTimeLoop, FollowingLoop])
@given(at=st.floats(0.0, 1e9))
@example(at=0.0)
def test_no_timer_goes_off_before_its_time(loop_factory, at):
    async def main():
        loop, now = asyncio.get_running_loop(), at
        if isinstance(loop, FollowingLoop):
            loop.follow(lambda: now)
        loop.continue_from(at)
        due, fired = math.nextafter(at, math.inf), loop.create_future()
        loop.call_at(due, lambda: fired.set_result(loop.time()))
        for _ in range(3):  # turns of the loop, in which its time stands still
            await asyncio.sleep(0)
        assert not fired.done()
        now = due
        assert await fired == due

    with asyncio.Runner(loop_factory=loop_factory) as runner:
        runner.run(main())


def test_however_much_takes_long_there_are_threads_for_what_is_short():
    async def main():
        is_free = threading.Event()
        long = [asyncio.create_task(in_own_thread(lambda: is_free.wait(LIMIT))) for _ in range(50)]
        await asyncio.sleep(0)
        await asyncio.to_thread(is_free.set)
        assert await asyncio.gather(*long) == [True] * 50

    in_virtual_time(main)


def in_real_time(main):
    with asyncio.Runner(loop_factory=FollowingLoop) as runner:
        return runner.run(main())


def test_timers_follow_the_clock_that_is_followed_and_time_never_goes_back():
    async def main():
        loop, seconds, fired = asyncio.get_running_loop(), [500.0], []
        before = loop.time()
        loop.follow(lambda: seconds[0])
        assert 0.0 <= loop.time() - before < LIMIT, "it goes on from where it was"
        start = loop.time()
        loop.call_later(3600.0, fired.append, "late")
        loop.call_later(10.0, fired.append, "soon")

        async def at(time):
            seconds[0] = time
            for _ in range(3):  # turns of the loop
                await asyncio.sleep(0)
            return round(loop.time() - start, 6), list(fired)  # differences of large numbers are not exact

        assert await at(500.0) == (0.0, [])
        assert await at(509.0) == (9.0, [])
        assert await at(400.0) == (9.0, []), "a simulation that was reset"
        assert await at(401.0) == (10.0, ["soon"]), "limits go on after that"
        assert await at(1e6) == (1e6 - 391.0, ["soon", "late"])

    in_real_time(main)


@given(
    st.lists(st.integers(-1_000_000, 1_000_000), min_size=1).flatmap(lambda shown: st.tuples(st.just(shown), st.integers(0, len(shown))))
)
def test_time_is_what_a_clock_has_gone_ahead_however_it_is_set_meanwhile(case: tuple[list[int], int]) -> None:
    (first, *shown), restarted = case

    async def main() -> None:
        loop, now = asyncio.get_running_loop(), first
        loop.follow(lambda: float(now))
        start = loop.time()
        ahead, last = 0, first
        for index, now in enumerate(shown):
            ahead, last = ahead + max(0, now - last), now
            assert loop.time() - start == pytest.approx(ahead, abs=1e-3)
            if index == restarted:  # as another process was
                loop.continue_from(1e6)
                start = 1e6 - ahead

    in_real_time(main)


def test_time_is_real_again_from_where_the_followed_clock_has_left_it():
    async def main():
        loop = asyncio.get_running_loop()
        loop.follow(lambda: 500.0)
        still = loop.time()
        ended = loop.create_future()
        loop.call_later(0.01, ended.set_result, None)
        follow_real_time()
        assert 0.0 <= loop.time() - still < LIMIT
        await asyncio.wait_for(ended, LIMIT)

    in_real_time(main)


def test_timers_that_only_rounding_tells_apart_go_off_together_and_none_before_its_time() -> None:
    async def main() -> list[float]:
        loop, times = asyncio.get_running_loop(), []
        for when in (15.0, 16.0, math.nextafter(15.0, 0.0), 15.00001):
            loop.call_at(when, lambda: times.append(loop.time()))
        await asyncio.sleep(20.0)
        return times

    assert in_virtual_time(main) == [15.0, 15.0, 15.00001, 16.0]


def test_time_does_not_go_on_while_the_process_is_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    """A limit does not end while nothing can be heard: what was reported meanwhile is taken in before."""
    clock, wait = [0.0], selectors.DefaultSelector.select

    def stopped_for_a_minute(selector, timeout=None):
        clock[0] += timeout + 60.0 if timeout else 0.0
        return wait(selector, 0)

    async def main() -> list[float]:
        loop, times = asyncio.get_running_loop(), list[float]()
        for when in (1.0, 2.0, 5.0):
            loop.call_at(when, lambda: times.append(loop.time()))
        await asyncio.sleep(6.0)
        return times

    with asyncio.Runner(loop_factory=lambda: FollowingLoop(lambda: clock[0])) as runner:
        runner.get_loop()
        with monkeypatch.context() as patch:
            patch.setattr(selectors.DefaultSelector, "select", stopped_for_a_minute)
            times = runner.run(main())
    assert times == pytest.approx([1.0, 2.0, 5.0])


def test_garbage_is_collected_while_there_is_nothing_else_to_do() -> None:
    collect_if_due()
    with short_pauses():
        few = [[number] for number in range(1_000)]
        collect_if_due()
        assert gc.get_count()[0] >= 0.9 * len(few)  # other threads may free some
        kept = [[number] for number in range(30_000)]
        assert gc.get_count()[0] >= 0.9 * len(kept)  # not by itself
        collect_if_due()
        assert gc.get_count()[0] < len(few)


def test_older_garbage_is_collected_in_its_turn() -> None:
    class Node:
        def __init__(self) -> None:
            self.own = self

    with short_pauses():
        node = Node()
        gone = ref(node)
        gc.collect(1)
        gc.collect(1)  # it is among the oldest now
        del node
        while gc.get_count()[2] <= gc.get_threshold()[2]:
            gc.collect(1)
        kept = [[number] for number in range(30_000)]
        collect_if_due()
        assert gone() is None
        assert kept
