"""Listens to `/rosout` and `/diagnostics` as rqt does, and prints what it hears, a JSON object per line. Run as a module."""

from __future__ import annotations

from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Log
from rclpy.qos import DurabilityPolicy, QoSProfile

from tests.support.processes import say_event
from tests.support.ros.child_process import spin


def log(message: Any) -> None:
    stamp = message.stamp.sec + message.stamp.nanosec * 1e-9
    say_event("log", level=message.level, name=message.name, text=message.msg, stamp=stamp, file=message.file)


def diagnose(message: Any) -> None:
    for status in message.status:
        values = {value.key: value.value for value in status.values}
        say_event("diagnosis", level=status.level[0], name=status.name, message=status.message, hardware=status.hardware_id, values=values)


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("listener", enable_rosout=False)
    node.create_subscription(Log, "/rosout", log, QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    node.create_subscription(DiagnosticArray, "/diagnostics", diagnose, 10)
    spin(node)


if __name__ == "__main__":
    main()
