"""Action servers that know nothing of this project, of types that are not ours. Run as a module.

``count`` returns Fibonacci numbers, ``measure`` a number twice that of its goal, ``search`` a cup of the room. Each goal received is
printed as a JSON object: what the servers say of it is the truth.
"""

from __future__ import annotations

from typing import Any

import rclpy
from pyrobosim_msgs.action import DetectObjects
from pyrobosim_msgs.msg import ObjectState
from rclpy.action import ActionServer
from test_msgs.action import Fibonacci, NestedMessage

from tests.support.processes import say_json
from tests.support.ros.child_process import spin
from tests.support.ros.server import fibonacci


def count(handle: Any) -> Fibonacci.Result:
    say_json({"server": "count", "order": handle.request.order})
    return fibonacci(handle)


def measure(handle: Any) -> NestedMessage.Result:
    number = handle.request.nested_field.int32_value
    say_json({"server": "measure", "number": number})
    result = NestedMessage.Result()
    result.nested_field.int32_value = 2 * number
    handle.succeed()
    return result


def search(handle: Any) -> DetectObjects.Result:
    say_json({"server": "search", "object": handle.request.target_object})
    handle.succeed()
    return DetectObjects.Result(detected_objects=[ObjectState(name=f"{handle.request.target_object} cup")])


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("foreign")
    ActionServer(node, Fibonacci, "count", count)
    ActionServer(node, NestedMessage, "measure", measure)
    ActionServer(node, DetectObjects, "search", search)
    spin(node)


if __name__ == "__main__":
    main()
