"""A robot that publishes nothing: a service answers how it is. Run as a module; prints what it does and is asked.

``work`` and ``charge`` are Fibonacci servers; ``work`` takes three quarters of a full battery, ``charge`` fills it. ``battery`` answers
how full it is, and how often the robot has worked.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import rclpy
from rclpy.action import ActionServer
from rclpy.executors import ExternalShutdownException
from test_msgs.action import Fibonacci
from test_msgs.srv import BasicTypes

from tests.support.processes import say


class Robot:
    """The robot; its state is how full the battery is, and how often it has worked."""

    def __init__(self) -> None:
        self.worked = 0
        self.battery = 1.0

    def work(self, handle: Any) -> Fibonacci.Result:
        say("work")
        self.battery -= 0.75
        self.worked += 1
        handle.succeed()
        return Fibonacci.Result()

    def charge(self, handle: Any) -> Fibonacci.Result:
        say("charge")
        self.battery = 1.0
        handle.succeed()
        return Fibonacci.Result()

    def answer(self, _: Any, response: Any) -> Any:
        say(f"asked {self.battery:.2f}")
        response.float64_value = self.battery
        response.int32_value = self.worked
        return response


def main() -> None:
    rclpy.init()
    node, robot = rclpy.create_node("tired"), Robot()
    servers = [ActionServer(node, Fibonacci, "work", robot.work), ActionServer(node, Fibonacci, "charge", robot.charge)]
    node.create_service(BasicTypes, "battery", robot.answer)
    say(f"ready: {len(servers)} servers")
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


if __name__ == "__main__":
    main()
