"""Simulation time: limits and timers follow /clock, heard over ROS 2."""

from __future__ import annotations

import asyncio

import pytest
from builtin_interfaces.msg import Time
from rosgraph_msgs.msg import Clock

from pnm.clock import FollowingLoop
from pnm.errors import InputError, RosError
from pnm.ros import sim_time
from pnm.ros.node.ros_thread import RosThread
from pnm.ros.sim_time import USE_SIM_TIME, follow_sim_time


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


def test_limits_pass_with_the_simulation_and_stand_still_with_it(ros, follower):
    async def main():
        publisher = await ros.ask(lambda: ros.node.create_publisher(Clock, "/clock", 1))

        def at(seconds):
            ros.call(lambda: publisher.publish(Clock(clock=Time(sec=seconds))))

        async def heard(seconds):
            """Publish the time until the loop has it: /clock is best effort."""
            while (now := loop.time() - start) < seconds:
                at(100 + seconds)
                await asyncio.to_thread(follower.wait, lambda: None)
            return now

        loop = asyncio.get_running_loop()
        following = asyncio.ensure_future(follow_sim_time(follower))
        while not following.done():
            at(100)
            await asyncio.wait((following,), timeout=0.1)
        following.result()
        start, hour = loop.time(), asyncio.Event()
        loop.call_at(start + 3600.0, hour.set)
        assert await heard(3599) == pytest.approx(3599.0)
        assert not hour.is_set()
        await heard(3601)
        await hour.wait()
        await ros.ask(lambda: ros.node.destroy_publisher(publisher))

    in_real_time(main)
