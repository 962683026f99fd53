"""A robot of a fleet that knows nothing of this project: three action servers and some sensors. Run as a module: NAME FILE.

``navigate`` drives to a pose, ``enter`` goes through the door, ``gripper`` closes around the sample. FILE holds, as JSON, what a
test does to the world: whether the door is open (``door``), how full the battery is (``r1/battery``), that a drive of the robot reports
success and goes nowhere (``r1/lies``), that the door shuts while the robot enters (``r1/shut``), and that it is unplugged then
(``r1/unplug``). The robot reads it whenever it looks, and writes what the door does.
"""

from __future__ import annotations

import json
import math
import os
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import rclpy
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from porter_msgs.action import Grip, NavigateToPose
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Bool, Float32, String

from tests.support.processes import say, say_json

PLACES: Final = {"store": (0.0, 0.0), "hall": (4.0, 0.0), "lab": (8.0, 2.0)}
SECONDS: Final = 0.5
"""That anything takes; sensors report five times as often."""


class Robot:
    """The robot, and where it truly is."""

    def __init__(self, name: str, world: Path) -> None:
        self.name, self.world, self.place = name, world, "store"
        self.node = rclpy.create_node("robot", namespace=name)
        group = ReentrantCallbackGroup()
        options: dict[str, Any] = {"callback_group": group, "cancel_callback": lambda _: CancelResponse.ACCEPT}
        served = {"navigate": (NavigateToPose, self.drive), "enter": (NavigateToPose, self.enter), "gripper": (Grip, self.grip)}
        self.servers = [ActionServer(self.node, kind, server, does, **options) for server, (kind, does) in served.items()]
        self.topics = [
            self.node.create_publisher(*about, 10)
            for about in ((String, "place"), (Float32, "battery"), (Bool, "/lab_door"), (PoseStamped, "pose"))
        ]
        once = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.amcl = self.node.create_publisher(PoseWithCovarianceStamped, "amcl_pose", once)
        self.arrive()
        self.node.create_timer(SECONDS / 5, self.report, callback_group=group)

    def told(self, word: str, default: Any = None) -> Any:
        return json.loads(self.world.read_text()).get(word, default)

    def report(self) -> None:
        place, battery, door, pose = self.topics
        place.publish(String(data=self.place))
        battery.publish(Float32(data=float(self.told(f"{self.name}/battery", 0.9))))
        door.publish(Bool(data=self.told("door", True)))
        here = PoseStamped()
        here.header.frame_id, here.pose.orientation.w = "map", 1.0
        here.pose.position.x, here.pose.position.y = PLACES[self.place]
        pose.publish(here)

    def arrive(self) -> None:
        """Say where it is as Nav2 does: once, for whoever comes later."""
        here = PoseWithCovarianceStamped()
        here.header.frame_id, here.pose.pose.orientation.w = "map", 1.0
        here.pose.pose.position.x, here.pose.pose.position.y = PLACES[self.place]
        self.amcl.publish(here)

    def drive(self, handle: Any) -> NavigateToPose.Result:
        return self.move(handle, "")

    def enter(self, handle: Any) -> NavigateToPose.Result:
        if self.told(f"{self.name}/unplug"):
            say_json({"unplugged": self.name})
            os._exit(0)
        if self.told(f"{self.name}/shut"):
            self.world.write_text(json.dumps({**json.loads(self.world.read_text()), "door": False}))
        return self.move(handle, "the door is shut")

    def move(self, handle: Any, through: str) -> NavigateToPose.Result:
        """Be at the place of the pose; as long as the door is open, if the way leads through it."""
        pose = handle.request.pose.pose.position
        wanted = next((name for name, spot in PLACES.items() if math.dist(spot, (pose.x, pose.y)) < 0.1), "")
        for _ in range(10):
            threading.Event().wait(SECONDS / 10)
            if handle.is_cancel_requested:
                handle.canceled()
                return NavigateToPose.Result(error_code=NavigateToPose.Result.UNKNOWN, error_msg="cancelled")
        if not wanted or (through and not self.told("door", True)):
            handle.abort()
            return NavigateToPose.Result(error_code=NavigateToPose.Result.UNKNOWN, error_msg=through or "no such place")
        if not self.told(f"{self.name}/lies"):
            self.place = wanted
            self.arrive()
        say_json({"robot": self.name, "says": wanted, "is": self.place})
        handle.succeed()
        return NavigateToPose.Result()

    def grip(self, handle: Any) -> Grip.Result:
        """Close the gripper around the sample, which is in the lab; the code says whether that has succeeded."""
        handle.succeed()
        has = self.place == "lab"
        say_json({"robot": self.name, "grips": has})
        return Grip.Result(code=Grip.Result.DONE if has else Grip.Result.OUT_OF_REACH, message="" if has else "nothing is here")


def main() -> None:
    rclpy.init()
    robot = Robot(sys.argv[1], Path(sys.argv[2]))
    executor = MultiThreadedExecutor(6)
    executor.add_node(robot.node)
    say(f"ready: {len(robot.servers)} servers")
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        executor.spin()


if __name__ == "__main__":
    main()
