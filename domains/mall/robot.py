"""The robot of the mall: plain ROS 2 action servers, which know nothing of plans and tasks. Run as a script.

    robot.py [SPEED]      SPEED times faster than real time

Goals are of the type GroundAction. What the robot does is published on the topic mall/doings and printed, a JSON object
per line; what it knows is published on knowledge/sensed. A message on mall/visitor says who comes: all that was told to
the others is forgotten. Nobody but those who send goals sees to it that the robot has one voice and one arm: it says when
they do not.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from contextlib import suppress

import rclpy
from pnm_interfaces.action import GroundAction
from pnm_interfaces.msg import State, TraceEvent
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile

USES = {"point_at": "arm", "describe_route": "voice", "ask_understood": "voice", "say": "voice"}
"""What an action needs of the robot; those that are not here need nothing."""
EFFECTS = {
    "look_up": "route_known",
    "point_at": "pointed_out",
    "describe_route": "described",
    "ask_understood": "asked",
    "hear_answer": "understood",
}
"""What is so after an action, of the visitor and the shop that it is about."""
SECONDS = {"look_up": 0.5, "point_at": 3.0, "describe_route": 2.0, "ask_understood": 1.0, "hear_answer": 0.2, "say": 1.5}
"""How long each action takes."""
STEP = 0.005
"""Seconds between two looks at whether a goal is to be cancelled."""


class Robot:
    """The action servers. The mutable state is what is known, what is going on, and how many reports were made."""

    def __init__(self, node, speed: float) -> None:
        self.speed = speed
        self.facts: set[str] = set()
        self.busy: dict[str, str] = {}
        self.sequence = 0
        self.lock = threading.Lock()
        group = ReentrantCallbackGroup()
        latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.sensed = node.create_publisher(State, "knowledge/sensed", latched)
        self.doings = node.create_publisher(TraceEvent, "mall/doings", QoSProfile(depth=1000))
        node.create_subscription(TraceEvent, "mall/visitor", self.welcome, 10, callback_group=group)
        many = QoSProfile(depth=100)
        self.servers = [
            ActionServer(
                node,
                GroundAction,
                name,
                self.perform,
                callback_group=group,
                cancel_callback=lambda _: CancelResponse.ACCEPT,
                goal_service_qos_profile=many,
                result_service_qos_profile=many,
                cancel_service_qos_profile=many,
            )
            for name in SECONDS
        ]
        self.learn()

    def perform(self, handle):
        """Do what a goal says, unless it is cancelled first."""
        name, told = handle.request.action, list(handle.request.arguments)
        call = f"{name}({', '.join(told)})"
        self.take(name, call)
        done = self.work(SECONDS[name] / self.speed, handle)
        if done and name == "hear_answer":
            done = told[2].startswith("yes")
        self.learn(*self.effects(name, told, done), forget=self.undone(name, told, done))
        # what is done is done, also when it is cancelled a moment later: it will not be asked for again
        outcome = "succeeded" if done else "canceled" if handle.is_cancel_requested else "aborted"
        self.give(name, call, outcome)
        getattr(handle, {"canceled": "canceled", "succeeded": "succeed", "aborted": "abort"}[outcome])()
        return GroundAction.Result(message="" if done else "she has not understood" if outcome == "aborted" else "cancelled")

    def work(self, seconds: float, handle) -> bool:
        """Take the time; tell whether all of it was there."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            if handle.is_cancel_requested:
                return False
            time.sleep(min(left, STEP))
        return not handle.is_cancel_requested

    def effects(self, name: str, told: list[str], done: bool) -> tuple[str, ...]:
        """Return what is so after an action."""
        return (f"({EFFECTS[name]} {' '.join(told[:2])})",) if done and name in EFFECTS else ()

    def undone(self, name: str, told: list[str], done: bool) -> tuple[str, ...]:
        """Return what is no longer so after an action: who has not understood needs it described once more."""
        if name != "hear_answer" or done:
            return ()
        return tuple(f"({fact} {' '.join(told[:2])})" for fact in ("pointed_out", "described", "asked"))

    def take(self, name: str, call: str) -> None:
        """Say that an action begins, and whether what it needs is taken already."""
        with self.lock:
            needed = USES.get(name, "")
            clash = self.busy.get(needed, "") if needed else ""
            self.busy[needed] = call
            self.tell("start", call, uses=needed, **({"clash": clash} if clash else {}))

    def give(self, name: str, call: str, outcome: str) -> None:
        """Say that an action has ended."""
        with self.lock:
            self.busy.pop(USES.get(name, ""), None)
            self.tell("end", call, uses=USES.get(name, ""), outcome=outcome)

    def learn(self, *facts: str, forget: tuple[str, ...] = ()) -> None:
        """Note and report what is so now."""
        with self.lock:
            self.facts = (self.facts - set(forget)) | set(facts)
            self.sequence += 1
            self.sensed.publish(State(names=list(EFFECTS.values()), facts=sorted(self.facts), sequence=self.sequence))

    def welcome(self, message) -> None:
        """Forget what was told to others than whoever comes."""
        self.learn(forget=tuple(fact for fact in self.facts if message.subject not in fact))

    def tell(self, event: str, call: str, **fields: str) -> None:
        """Publish and print what is done."""
        self.doings.publish(TraceEvent(word=event, subject=call, text=fields.get("outcome", "")))
        sys.stdout.write(json.dumps({"time": round(time.time(), 4), "event": event, "call": call, **fields}) + "\n")
        sys.stdout.flush()


def main(speed: str = "1") -> None:
    """Serve until interrupted."""
    rclpy.init()
    node = rclpy.create_node("mall_robot")
    robot = Robot(node, float(speed))
    executor = MultiThreadedExecutor(8)
    executor.add_node(node)
    sys.stdout.write(f"ready: {len(robot.servers)} action servers\n")
    sys.stdout.flush()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        executor.spin()


if __name__ == "__main__":
    main(*sys.argv[1:])
