"""Simulation time: with the parameter ``use_sim_time`` the event loop follows ``/clock``, and with it all limits and timers."""

from __future__ import annotations

import asyncio
import logging
from math import inf
from time import monotonic
from typing import Any, Final

from pnm.clock import FollowingLoop
from pnm.errors import InputError, RosError
from pnm.ros.node.messages import import_type
from pnm.ros.node.ros_thread import RosThread, call_on_loop

_log = logging.getLogger(__name__)
USE_SIM_TIME: Final = ("--ros-args", "-p", "use_sim_time:=true")
"""Arguments for a node that follows ``/clock``."""
LIMIT: Final = 10.0
"""Seconds of real time for a simulation to be heard."""
STILL: Final = 5.0
"""Seconds of real time without a move after which it is said that ``/clock`` stands still."""
JUMP: Final = 60.0
"""Seconds by which a clock is further than by its own pace when it is said that it went ahead."""
_BACK: Final = 1.0
"""The same for a clock that is set back, which may otherwise be one message that came late."""
PERIOD: Final = 10.0
"""Seconds of real time in which one jump is told."""


class SimClock:
    """A ``/clock`` as it is heard: its time, and what people should know of it, as it stands still, goes on or jumps.

    Times are in seconds; `real` ones are of a clock that nobody stops or sets.
    The mutable state is what it shows, the real time of its last move, since when its pace is measured, how many publish it, the last
    jump and when that was, and whether it stands still. It changes on the ROS thread.
    """

    def __init__(self) -> None:
        self.now = 0.0
        self._moved = 0.0
        self._since: tuple[float, float] | None = None
        """Its time when its pace began, and the real time of that; None until it is heard."""
        self._publishers = 1
        self._jump, self._jumped = "", -inf
        self._still = ""

    def follow(self) -> None:
        """Have the running event loop follow it from now on."""
        loop = asyncio.get_running_loop()
        assert isinstance(loop, FollowingLoop)
        loop.follow(lambda: self.now)

    def hear(self, shown: float, real: float) -> str:
        """Take in what it shows; return what is to be said of that, or nothing."""
        if self._since is None:
            self.now, self._moved, self._since = shown, real, (shown, real)
            return ""
        began, since = self._since
        step, paused = shown - self.now, real - self._moved
        if not step:
            return ""
        pace = (self.now - began) / (self._moved - since) if self._moved > since else 0.0
        self.now, self._moved = shown, real
        was_still, self._still = self._still, ""
        if step <= -_BACK:
            return self._tell_jump(f"/clock went back by {-step:g} s, as if a simulation was reset: limits go on from there", shown, real)
        if step - pace * paused >= JUMP:
            return self._tell_jump(f"/clock went ahead by {step:g} s at once, which all limits have counted", shown, real)
        return f"/clock goes on after {paused:.0f} s" if was_still else ""

    def look(self, real: float, publishers: int) -> str:
        """Take in how many publish it at this moment; return what is to be said of its silence, or nothing."""
        self._publishers = publishers
        if self._still or self._since is None or real - self._moved < STILL:
            return ""
        cause = "is the simulation paused, or has it ended?" if publishers else "nobody publishes it; has the simulation ended?"
        self._still = f"/clock has stood still for {real - self._moved:.0f} s, and all limits with it: {cause}"
        return self._still

    def trouble(self, real: float) -> str:
        """Return its present fault; empty if it goes on."""
        return self._still or (self._jump if real - self._jumped < PERIOD else "")

    def _tell_jump(self, what: str, shown: float, real: float) -> str:
        self._since = shown, real
        others = f"; {self._publishers} nodes publish it" if self._publishers > 1 else ""
        self._jump, before = f"{what}{others}", self._jumped
        if real - before < PERIOD:
            return ""
        self._jumped = real
        return self._jump


async def follow_sim_time(ros: RosThread) -> SimClock | None:
    """Have the event loop follow ``/clock`` from now on if the node's parameter ``use_sim_time`` is set, and return that clock.

    A simulation that is paused pauses all limits, and after one that is reset they go on. Both are logged, as is one that jumps.
    Raises `InputError` if the event loop is one that cannot, `RosError` if nothing is heard on ``/clock``.
    """
    if not await ros.ask(lambda: ros.node.get_parameter("use_sim_time").value):
        return None
    loop = asyncio.get_running_loop()
    if not isinstance(loop, FollowingLoop):
        raise InputError("use_sim_time needs an event loop of ours: `pnm run`, `pnm serve` or `achieve`")
    clock, heard = SimClock(), asyncio.Event()

    def say(words: str) -> None:
        if words and loop.is_following:  # else no limit depends on it
            _log.warning("%s", words)

    def receive(message: Any) -> None:
        say(clock.hear(message.clock.sec + message.clock.nanosec / 1e9, monotonic()))
        call_on_loop(loop, heard.set)  # each time, so that the loop looks whether a timer is due

    def look() -> None:
        say(clock.look(monotonic(), ros.node.count_publishers("/clock")))

    from rclpy.qos import QoSProfile, ReliabilityPolicy  # here, because rclpy is an extra

    kind, latest = import_type("rosgraph_msgs/msg/Clock"), QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    await ros.ask(lambda: ros.node.create_subscription(kind, "/clock", receive, latest))
    await ros.ask(lambda: ros.timer(1.0, look))
    try:
        await asyncio.wait_for(heard.wait(), LIMIT)
    except TimeoutError as error:
        raise RosError(f"use_sim_time is set, and nothing is heard on /clock within {LIMIT:g} s; is the simulation running?") from error
    clock.follow()
    return clock
