"""A mobile robot with a gripper that knows nothing of this project. Run as a module; prints "ready", and what truly happens.

``navigate_to_pose`` drives, and aborts where the map ends. ``gripper`` closes around an object, or opens; its goals always
succeed, and the result has a code: the red cup slips whenever it is taken.
"""

from __future__ import annotations

import math
import threading
from contextlib import suppress
from typing import Any, Final

import rclpy
from porter_msgs.action import Grip, NavigateToPose
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor

from tests.support.processes import say, say_json

SECONDS: Final = 0.3
"""That anything takes."""
REACH: Final = 0.5
"""Metres."""
BORDER: Final = 10.0
"""Metres from the middle of the map to its end."""
SLIPPERY: Final = "red_cup"

Point = tuple[float, float]


class Porter:
    """The robot, and where things truly are."""

    def __init__(self) -> None:
        self.here: Point = (2.0, 1.0)
        self.things: dict[str, Point] = {"red_cup": (2.0, 1.0), "green_cup": (4.0, -1.0)}
        self.held = ""

    def drive(self, handle: Any) -> NavigateToPose.Result:
        """Be at the pose, if it is on the map."""
        pose = handle.request.pose
        goal = (pose.pose.position.x, pose.pose.position.y)
        turned = math.hypot(*(getattr(pose.pose.orientation, axis) for axis in "xyzw"))
        if pose.header.frame_id != "map" or not math.isclose(turned, 1.0, abs_tol=1e-3) or math.hypot(*goal) > BORDER:
            handle.abort()
            say_json({"drive": goal, "frame": pose.header.frame_id, "reached": False})
            return NavigateToPose.Result(error_code=NavigateToPose.Result.UNKNOWN, error_msg="no pose on the map")
        if not self.work(handle):
            return NavigateToPose.Result(error_code=NavigateToPose.Result.UNKNOWN, error_msg="cancelled")
        self.here = goal
        say_json({"drive": goal, "frame": pose.header.frame_id, "reached": True})
        return NavigateToPose.Result()

    def grip(self, handle: Any) -> Grip.Result:
        """Close or open the gripper; the code says whether that has brought about anything."""
        goal = handle.request
        if not self.work(handle):
            return Grip.Result()
        code = (self.pick if goal.close else self.release)(goal.object)
        say_json({"object": goal.object, "close": goal.close, "code": code, "held": self.held, "things": self.things})
        messages = {Grip.Result.SLIPPED: f"{goal.object} is wet", Grip.Result.OUT_OF_REACH: f"{goal.object} is not here"}
        return Grip.Result(code=code, message=messages.get(code, ""))

    def pick(self, thing: str) -> int:
        if self.held or math.dist(self.here, self.things.get(thing, (math.inf, 0.0))) > REACH:
            return int(Grip.Result.OUT_OF_REACH)
        if thing == SLIPPERY:
            return int(Grip.Result.SLIPPED)
        self.held = thing
        del self.things[thing]
        return int(Grip.Result.DONE)

    def release(self, thing: str) -> int:
        if thing != self.held:
            return int(Grip.Result.NOT_HELD)
        self.held = ""
        self.things[thing] = self.here
        return int(Grip.Result.DONE)

    def work(self, handle: Any) -> bool:
        """Take some time; return whether the goal was not cancelled meanwhile, and end it accordingly."""
        pause = threading.Event()
        for _ in range(10):
            if handle.is_cancel_requested:
                handle.canceled()
                return False
            pause.wait(SECONDS / 10)
        handle.succeed()
        return True


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("porter")
    porter, group = Porter(), ReentrantCallbackGroup()
    options: dict[str, Any] = {"callback_group": group, "cancel_callback": lambda _: CancelResponse.ACCEPT}
    servers = [
        ActionServer(node, NavigateToPose, "navigate_to_pose", porter.drive, **options),
        ActionServer(node, Grip, "gripper", porter.grip, **options),
    ]
    executor = MultiThreadedExecutor(4)
    executor.add_node(node)
    say(f"ready: {len(servers)} servers")
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        executor.spin()


if __name__ == "__main__":
    main()
