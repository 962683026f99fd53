"""Action servers that know nothing of this project, of types that are not ours. Run as a module.

``count`` returns Fibonacci numbers, ``measure`` a number twice that of its goal. Each goal received is
printed as a JSON object: what the servers say of it is the truth.
"""

from __future__ import annotations

import json
import sys
from contextlib import suppress
from typing import Any

import rclpy
from rclpy.action import ActionServer
from rclpy.executors import ExternalShutdownException
from test_msgs.action import Fibonacci, NestedMessage


def say(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def count(handle: Any) -> Fibonacci.Result:
    say(json.dumps({"server": "count", "order": handle.request.order}))
    sequence = [0, 1]
    while len(sequence) < handle.request.order:
        sequence.append(sequence[-1] + sequence[-2])
    handle.succeed()
    return Fibonacci.Result(sequence=sequence[: handle.request.order])


def measure(handle: Any) -> NestedMessage.Result:
    number = handle.request.nested_field.int32_value
    say(json.dumps({"server": "measure", "number": number}))
    result = NestedMessage.Result()
    result.nested_field.int32_value = 2 * number
    handle.succeed()
    return result


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("foreign")
    servers = [ActionServer(node, Fibonacci, "count", count), ActionServer(node, NestedMessage, "measure", measure)]
    say(f"ready: {len(servers)} servers")
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


if __name__ == "__main__":
    main()
