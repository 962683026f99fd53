"""Sensors in a process of their own. Run as a module: each argument is one, as JSON; prints "ready", and what services are asked.

{"topic": NAME, "type": TYPE, "fields": {...}}    published every 0.1 s; "once": true for once and no more
    "reliable", "latched": true or false          true by default
{"service": NAME, "type": TYPE, "fields": {...}}  the response; "deaf": true never answers
"""

from __future__ import annotations

import json
import sys
from typing import Any

import rclpy
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.task import Future

from pnm.ros.node.messages import import_type, to_data, to_message
from tests.support.processes import say_json
from tests.support.ros.child_process import spin


def publish(
    node: Any, topic: str, type: str, fields: dict[str, Any], reliable: bool = True, latched: bool = True, once: bool = False
) -> None:
    kind = import_type(type)
    profile = QoSProfile(
        depth=1,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )
    publisher = node.create_publisher(kind, topic, profile)
    message = to_message(kind, fields)
    publisher.publish(message)
    if not once:
        node.create_timer(0.1, lambda: publisher.publish(message))


def offer(node: Any, service: str, type: str, fields: dict[str, Any], deaf: bool = False) -> None:
    kind = import_type(type)

    async def answer(request: Any, response: Any) -> Any:
        say_json({name: value for name, value in to_data(request).items() if value})
        if deaf:
            await Future()
        return to_message(kind.Response, fields)

    node.create_service(kind, service, answer, callback_group=ReentrantCallbackGroup())


def main(*sensors: str) -> None:
    rclpy.init()
    node = rclpy.create_node("sensors")
    for sensor in map(json.loads, sensors):
        (publish if "topic" in sensor else offer)(node, **sensor)
    spin(node)


if __name__ == "__main__":
    main(*sys.argv[1:])
