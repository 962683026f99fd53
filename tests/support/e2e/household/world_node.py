"""A world of PyRoboSim as a ROS 2 node, in the shape of PyRoboSim's own. Run as a module; prints "ready", and each action.

A goal of `execute_action` succeeds whatever has happened, and its result has a status; it is aborted only if the robot is busy or
unknown. `request_world_state` returns the state of everything, and `<robot>/robot_state` that of one robot, ten times a second.
On SIGTERM it prints whether the goal of the problem is reached, by the simulator's own state.
"""

from __future__ import annotations

import argparse
import signal
from contextlib import nullcontext, suppress
from functools import partial
from pathlib import Path
from threading import Thread
from typing import Any, Final

import rclpy
from pyrobosim.core import Robot, World
from pyrobosim.planning.actions import ExecutionStatus
from pyrobosim_msgs.action import ExecuteTaskAction
from pyrobosim_msgs.msg import RobotState
from pyrobosim_msgs.srv import RequestWorldState
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from pnm.ros.node.messages import to_data, to_message
from tests.support.e2e.household.simulator import has_reached, load_world, perform, robot_state, without_waiting, world_state
from tests.support.processes import say, say_json

STATE_PERIOD: Final = 0.1


class WorldNode:
    """The interfaces of a world."""

    def __init__(self, world: World, realtime_factor: float | None) -> None:
        self._world = world
        self._realtime_factor = realtime_factor
        self.node = rclpy.create_node("pyrobosim")
        options: dict[str, Any] = {"callback_group": ReentrantCallbackGroup()}
        self._server = ActionServer(self.node, ExecuteTaskAction, "execute_action", self._execute, cancel_callback=self._cancel, **options)
        self.node.create_service(RequestWorldState, "request_world_state", self._answer, **options)
        for robot in world.robots:
            publisher = self.node.create_publisher(RobotState, f"{robot.name}/robot_state", 10)
            self.node.create_timer(STATE_PERIOD, partial(self._publish, publisher, robot), **options)

    def _execute(self, handle: Any) -> Any:
        robot = self._world.get_robot_by_name(handle.request.action.robot)
        if robot is None or robot.is_busy():
            handle.abort()
            status, message = (
                (ExecutionStatus.INVALID_ACTION, "invalid robot name") if robot is None else (ExecutionStatus.CANCELED, "the robot is busy")
            )
            return _result(status, message)
        factor = handle.request.realtime_factor if self._realtime_factor is None else self._realtime_factor
        action = to_data(handle.request.action)
        result = perform(self._world, action, factor)
        say_json({"type": action["type"], "what": action["target_location"] or action["object"], "status": result.status.name})
        if handle.is_cancel_requested:
            handle.canceled()
        else:
            handle.succeed()
        return _result(result.status, result.message or "")

    def _cancel(self, handle: Any) -> CancelResponse:
        robot = self._world.get_robot_by_name(handle.request.action.robot)
        if robot is None or not robot.is_busy():
            return CancelResponse.REJECT
        Thread(target=robot.cancel_actions).start()
        return CancelResponse.ACCEPT

    def _answer(self, request: Any, response: Any) -> Any:
        return to_message(RequestWorldState.Response, {"state": world_state(self._world)})

    def _publish(self, publisher: Any, robot: Robot) -> None:
        publisher.publish(to_message(RobotState, robot_state(robot)))


def _result(status: ExecutionStatus, message: str) -> Any:
    return to_message(ExecuteTaskAction.Result, {"execution_result": {"status": int(status), "message": message}})


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("problem", type=int)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--worlds", type=Path, help="folder of the workshop's world1.yaml to world4.yaml; by default a house of this project"
    )
    parser.add_argument("--realtime-factor", type=float, help="in place of that of each goal; negative for as fast as possible")
    options = parser.parse_args()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    world = load_world(options.problem, options.seed, options.worlds)
    executor = MultiThreadedExecutor(4)
    executor.add_node(WorldNode(world, options.realtime_factor).node)
    signal.signal(signal.SIGTERM, lambda *_: executor.shutdown(0) or rclpy.try_shutdown())
    say("ready")
    with suppress(KeyboardInterrupt, ExternalShutdownException), without_waiting() if (options.realtime_factor or 1) < 0 else nullcontext():
        executor.spin()
    say_json({"goal_reached": has_reached(world, options.problem)})


if __name__ == "__main__":
    main()
