"""A simulation that does nothing but publish /clock, so many times faster than real time. Run as a module: simulation_clock.py SPEED."""

from __future__ import annotations

import sys
from time import monotonic

import rclpy
from builtin_interfaces.msg import Time
from rosgraph_msgs.msg import Clock

from tests.support.ros.child_process import spin


def main(speed: float) -> None:
    rclpy.init()
    node, began = rclpy.create_node("simulation"), monotonic()
    publisher = node.create_publisher(Clock, "/clock", 1)

    def tick() -> None:
        seconds = 1000.0 + (monotonic() - began) * speed
        publisher.publish(Clock(clock=Time(sec=int(seconds), nanosec=int(seconds % 1.0 * 1e9))))

    node.create_timer(0.02, tick)
    spin(node)


main(float(sys.argv[1]))
