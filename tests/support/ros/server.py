"""A real action server to test against: each goal says how it is to end. Run as a module.

Of a GroundAction goal the action says what to do and the first argument how long, in seconds, or how many:

    succeed, abort, reject, raise, oddly (returns without an end)
    slow (1)         works for a while, and lets itself be cancelled
    stubborn (1)     the same, but refuses to be cancelled
    hang             works until it is cancelled
    chatter (N)      reports N times without a pause how far it is, then works until it is cancelled
    hesitate (1)     takes that long to accept, one goal after the other, then works until it is cancelled
    mute             works until it is cancelled, but its answer to the goal gets lost
    together (N)     waits until N goals are there, then all end at once
    block (1)        keeps its thread busy; with one thread the server answers nothing meanwhile

Of a Fibonacci goal the order is the length of the sequence. Prints "ready" once it serves.
"""

from __future__ import annotations

import argparse
import threading
import traceback
from collections.abc import Callable
from typing import Any

import rclpy
from action_msgs.msg import GoalInfo
from pnm_interfaces.action import GroundAction
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import await_or_execute
from rclpy.task import Future
from test_msgs.action import Fibonacci

from tests.support.ros.child_process import spin

NEVER = 3600.0


class Behaviour:
    """What the server does with GroundAction goals."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.answering = threading.Lock()
        self.arrived = 0
        self.complete = threading.Event()

    def accept(self, goal: Any) -> GoalResponse:
        if goal.action == "hesitate":
            with self.answering:
                threading.Event().wait(first_number(goal))
        return GoalResponse.REJECT if goal.action == "reject" else GoalResponse.ACCEPT

    def cancel(self, handle: Any) -> CancelResponse:
        return CancelResponse.REJECT if handle.request.action == "stubborn" else CancelResponse.ACCEPT

    def execute(self, handle: Any) -> GroundAction.Result:
        goal = handle.request
        match goal.action:
            case "abort":
                handle.abort()
                return GroundAction.Result(message="the door is shut")
            case "raise":
                raise RuntimeError("wheel came off")
            case "oddly":
                return GroundAction.Result(message="no end")
            case "together":
                self.meet(int(first_number(goal)))
            case "block":
                threading.Event().wait(first_number(goal))
            case "slow" | "stubborn":
                return self.work(handle, first_number(goal))
            case "chatter":
                count = int(first_number(goal))
                for number in range(count):
                    handle.publish_feedback(GroundAction.Feedback(progress=(number + 1) / count))
                while not handle.is_cancel_requested:
                    threading.Event().wait(0.05)
                handle.canceled()
            case "hang" | "hesitate" | "mute":
                return self.work(handle, NEVER)
        if handle.is_active:
            handle.succeed()
        return GroundAction.Result(message=f"did {' '.join([goal.action, *goal.arguments])}")

    def meet(self, count: int) -> None:
        with self.lock:
            self.arrived += 1
            if self.arrived == count:
                self.complete.set()
        self.complete.wait(60.0)

    def work(self, handle: Any, seconds: float) -> GroundAction.Result:
        pause = threading.Event()
        for step in range(int(seconds / 0.05)):
            if handle.is_cancel_requested:
                handle.canceled()
                return GroundAction.Result(message=f"stopped after {step} steps")
            handle.publish_feedback(GroundAction.Feedback(progress=min(1.0, step * 0.05 / seconds)))
            pause.wait(0.05)
        handle.succeed()
        return GroundAction.Result(message="done")


class LosingServer(ActionServer):  # type: ignore[misc]
    """An action server that loses its answer to a mute goal."""

    async def _execute_goal_request(self, received: Any) -> None:
        _, request = received
        if request.goal.action != "mute":
            await super()._execute_goal_request(received)
            return
        with self._lock:
            handle = ServerGoalHandle(self, GoalInfo(goal_id=request.goal_id, stamp=self._node.get_clock().now().to_msg()), request.goal)
        identity = bytes(request.goal_id.uuid)
        self._goal_handles[identity] = handle
        self._result_futures[identity] = Future()
        self.add_future(self._result_futures[identity])
        await await_or_execute(self._handle_accepted_callback, handle)


def first_number(goal: Any) -> float:
    """Return the first argument as a number, 1 without one."""
    return float(goal.arguments[0]) if goal.arguments else 1.0


def fibonacci(handle: Any) -> Fibonacci.Result:
    sequence = [0, 1]
    while len(sequence) < handle.request.order:
        sequence.append(sequence[-1] + sequence[-2])
    handle.succeed()
    return Fibonacci.Result(sequence=sequence[: handle.request.order])


def guarded(execute: Callable[[Any], Any], empty: Callable[[], Any]) -> Callable[[Any], Any]:
    """Have a failing callback abort its goal instead of ending the server."""

    def run(handle: Any) -> Any:
        try:
            return execute(handle)
        except Exception:
            traceback.print_exc()
            handle.abort()
            return empty()

    return run


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("names", nargs="*", help="names of the servers")
    parser.add_argument("--fibonacci", action="store_true", help="serve Fibonacci instead of GroundAction")
    parser.add_argument("--threads", type=int, default=40)
    options = parser.parse_args()

    rclpy.init()
    node = rclpy.create_node(f"server_{threading.get_native_id()}")
    behaviour = Behaviour()
    group = ReentrantCallbackGroup()
    for name in options.names:
        if options.fibonacci:
            ActionServer(node, Fibonacci, name, guarded(fibonacci, Fibonacci.Result), callback_group=group)
        else:
            LosingServer(
                node,
                GroundAction,
                name,
                guarded(behaviour.execute, GroundAction.Result),
                goal_callback=behaviour.accept,
                cancel_callback=behaviour.cancel,
                callback_group=group,
            )
    spin(node, threads=options.threads)


if __name__ == "__main__":
    main()
