"""Simulation time: limits and timers follow /clock, heard over ROS 2."""

from __future__ import annotations

import asyncio
import threading

import pytest
from builtin_interfaces.msg import Time
from rosgraph_msgs.msg import Clock

from pnm.clock import FollowingLoop
from pnm.errors import InputError, RosError
from pnm.ros import sim_time
from pnm.ros.node.ros_thread import RosThread
from pnm.ros.sim_time import JUMP, PERIOD, STILL, USE_SIM_TIME, SimClock, follow_sim_time


def in_real_time(main):
    with asyncio.Runner(loop_factory=FollowingLoop) as runner:
        return runner.run(main())


@pytest.fixture
def follower():
    """A node that is to follow the simulation."""
    thread = RosThread("follower", args=USE_SIM_TIME)
    yield thread
    assert thread.close()


def test_a_simulation_that_is_not_there_is_said(follower, monkeypatch):
    monkeypatch.setattr(sim_time, "LIMIT", 0.1)
    with pytest.raises(RosError, match=r"nothing is heard on /clock within 0\.1 s; is the simulation running\?"):
        in_real_time(lambda: follow_sim_time(follower))


def test_an_event_loop_that_cannot_follow_is_said(follower):
    with pytest.raises(InputError, match="use_sim_time needs an event loop of ours"):
        asyncio.run(follow_sim_time(follower))


def test_without_the_parameter_time_is_real(ros):
    async def main():
        await follow_sim_time(ros)
        before = asyncio.get_running_loop().time()
        await asyncio.sleep(0.01)
        assert asyncio.get_running_loop().time() > before

    in_real_time(main)


def heard(*moves):
    """Have a clock heard at these real times; return it, and what it said of the last move."""
    clock, said = SimClock(), ""
    for shown, real in moves:
        said = clock.hear(shown, real)
    return clock, said


@pytest.mark.parametrize(
    ("moves", "said"),
    [
        ([(100.0, 0.0), (100.1, 0.1)], ""),
        ([(100.0, 0.0), (100.1, 0.1), (100.1, 0.2), (100.2, 0.3)], ""),
        ([(100.0, 0.0), (100.1, 0.1), (100.05, 0.2)], ""),
        ([(500.0, 0.0), (500.1, 0.1), (0.1, 0.2)], "/clock went back by 500 s, as if a simulation was reset: limits go on from there"),
        ([(100.0, 0.0), (100.1, 0.1), (3700.1, 0.2)], "/clock went ahead by 3600 s at once, which all limits have counted"),
        ([(0.0, 0.0), (30.0, 0.1), (60.0, 0.2), (360.0, 1.2)], ""),
    ],
    ids=["goes on", "is shown twice", "comes late", "reset", "set", "fast, and one second nothing was heard"],
)
def test_a_clock_that_is_set_is_told_from_one_that_is_fast(moves, said):
    assert heard(*moves)[1] == said


def test_a_clock_that_stands_still_is_told_once_and_when_it_goes_on():
    clock, _ = heard((100.0, 0.0), (100.1, 0.1))
    assert not clock.look(STILL, 1)
    assert not clock.trouble(STILL)
    assert (
        clock.look(STILL + 0.1, 1) == "/clock has stood still for 5 s, and all limits with it: is the simulation paused, or has it ended?"
    )
    assert not clock.look(STILL + 1.0, 0), "once"
    assert clock.trouble(100.0).startswith("/clock has stood still")
    assert not clock.hear(100.1, 11.0), "a simulation that is paused may still publish"
    assert clock.hear(100.2, 12.1) == "/clock goes on after 12 s"
    assert not clock.trouble(12.1)
    assert "nobody publishes it" in clock.look(20.0, 0)


def test_clocks_that_contradict_each_other_are_told_now_and_then():
    clock, _ = heard((100.0, 0.0))
    clock.look(0.0, 2)
    said = [clock.hear(100.0 + (number % 2) * 2 * JUMP, number * 0.02) for number in range(1, 101)]
    assert [one for one in said if one] == ["/clock went ahead by 120 s at once, which all limits have counted; 2 nodes publish it"]
    assert clock.trouble(2.0)
    assert not clock.trouble(PERIOD + 1.0)


def test_silence_and_jumps_are_logged_and_limits_go_on_after_a_reset(ros, follower, monkeypatch, caplog):
    monkeypatch.setattr(sim_time, "STILL", 0.5)

    async def main():
        publisher = await ros.ask(lambda: ros.node.create_publisher(Clock, "/clock", 1))
        loop = asyncio.get_running_loop()

        async def until(happens, *times):
            """Publish these times in turn until something has happened: /clock is best effort."""
            while not happens():
                for seconds in times:
                    ros.call(lambda seconds=seconds: publisher.publish(Clock(clock=Time(sec=seconds))))
                await asyncio.to_thread(threading.Event().wait, 0.02)  # in real time: the loop follows what stands still

        following = asyncio.ensure_future(follow_sim_time(follower))
        await until(following.done, 500)
        clock, limit = following.result(), asyncio.Event()
        await until(lambda: "stood still" in caplog.text)
        loop.call_later(60.0, limit.set)
        await until(lambda: clock.now == 7.0, 7)
        assert not limit.is_set()
        await until(limit.is_set, 68)
        await ros.ask(lambda: ros.node.destroy_publisher(publisher))

    in_real_time(main)
    assert "/clock went back by 493 s" in caplog.text
