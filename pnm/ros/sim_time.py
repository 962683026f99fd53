"""Simulation time: with the parameter ``use_sim_time`` the event loop follows ``/clock``, and with it all limits and timers."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import Any, Final

from pnm.clock import FollowingLoop
from pnm.errors import InputError, RosError
from pnm.ros.node.messages import import_type
from pnm.ros.node.ros_thread import RosThread, call_on_loop

USE_SIM_TIME: Final = ("--ros-args", "-p", "use_sim_time:=true")
"""Arguments for a node that follows ``/clock``."""
LIMIT: Final = 10.0
"""Seconds of real time for a simulation to be heard."""


@dataclass
class _Clock:
    """The last time that was heard, in seconds; written on the ROS thread, read on that of the event loop."""

    now: float = 0.0


async def follow_sim_time(ros: RosThread) -> None:
    """Have the event loop follow ``/clock`` from now on if the node's parameter ``use_sim_time`` is set.

    A simulation that is paused pauses all limits, and one that is reset makes time stand still until it has caught up.

    Raises:
        InputError: the event loop is one that cannot.
        RosError: nothing is heard on ``/clock``.
    """
    if not await ros.ask(lambda: ros.node.get_parameter("use_sim_time").value):
        return
    loop = asyncio.get_running_loop()
    if not isinstance(loop, FollowingLoop):
        raise InputError("use_sim_time needs an event loop of ours: `pnm run`, `pnm serve` or `achieve`")
    clock, heard = _Clock(), asyncio.Event()

    def receive(message: Any) -> None:
        clock.now = message.clock.sec + message.clock.nanosec / 1e9
        call_on_loop(loop, heard.set)  # each time, so that the loop looks whether a timer is due

    from rclpy.qos import QoSProfile, ReliabilityPolicy  # here, because rclpy is an extra

    kind, latest = import_type("rosgraph_msgs/msg/Clock"), QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    await ros.ask(lambda: ros.node.create_subscription(kind, "/clock", receive, latest))
    try:
        await asyncio.wait_for(heard.wait(), LIMIT)
    except TimeoutError as error:
        raise RosError(f"use_sim_time is set, and nothing is heard on /clock within {LIMIT:g} s; is the simulation running?") from error
    loop.follow(lambda: clock.now)
