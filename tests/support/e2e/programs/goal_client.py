"""A client of `achieve_goal` and of the life cycle that knows only ROS 2; prints what it hears, a JSON object per line. Run as a module.

goal_client.py send GOAL...            sends the goals, all at once, and waits for their results
goal_client.py change LABEL...         asks the node /pnm for transitions, one after the other
"""

from __future__ import annotations

import sys
from typing import Any
from uuid import uuid4

import rclpy
from lifecycle_msgs.srv import ChangeState, GetState
from pnm_interfaces.action import AchieveGoal
from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from rclpy.qos import QoSProfile
from unique_identifier_msgs.msg import UUID

from tests.support.processes import LIMIT, say_event


class GoalSender:
    def __init__(self, node: Any) -> None:
        deep = QoSProfile(depth=1000)
        self.client = ActionClient(node, AchieveGoal, "achieve_goal", goal_service_qos_profile=deep, result_service_qos_profile=deep)
        self.handles: list[Any] = []  # rclpy keeps them weakly
        self.waiting = 0

    def send(self, number: int, goal: str) -> None:
        self.waiting += 1
        sent = self.client.send_goal_async(AchieveGoal.Goal(goal=goal), lambda message: self.hear(number, message.feedback))
        sent.add_done_callback(lambda future: self.answered(number, future.result()))

    def hear(self, number: int, feedback: Any) -> None:
        say_event("feedback", goal=number, state=feedback.status.state)

    def answered(self, number: int, handle: Any) -> None:
        say_event("answered", goal=number, accepted=handle.accepted)
        if not handle.accepted:
            self.waiting -= 1
            return
        self.handles.append(handle)
        handle.get_result_async().add_done_callback(lambda future: self.ended(number, future.result()))

    def ended(self, number: int, answer: Any) -> None:
        say_event("result", goal=number, status=answer.status, reason=answer.result.reason, message=answer.result.message)
        self.waiting -= 1


def meet(node: Any, client: Any) -> None:
    """Ask for the result of a goal that nobody has until there is an answer: what a server answers before it knows us gets lost."""
    for _ in range(30):
        handle = ClientGoalHandle(client, UUID(uuid=list(uuid4().bytes)), AchieveGoal.Impl.SendGoalService.Response())
        future = handle.get_result_async()
        rclpy.spin_until_future_complete(node, future, timeout_sec=1.0)
        if future.done():
            return
    raise TimeoutError("the server never answers")


def send(node: Any, *goals: str) -> None:
    sender = GoalSender(node)
    assert sender.client.wait_for_server(LIMIT)
    meet(node, sender.client)
    for number, goal in enumerate(goals):
        sender.send(number, goal)
    while sender.waiting:
        rclpy.spin_once(node)


def change_state(node: Any, *labels: str) -> None:
    asked, ask = node.create_client(GetState, "/pnm/get_state"), node.create_client(ChangeState, "/pnm/change_state")
    assert asked.wait_for_service(LIMIT)
    assert ask.wait_for_service(LIMIT)
    say_event("state", label=wait(node, asked.call_async(GetState.Request())).current_state.label)
    for label in labels:
        request = ChangeState.Request()
        request.transition.label = label
        say_event("changed", label=label, success=wait(node, ask.call_async(request)).success)


def wait(node: Any, future: Any) -> Any:
    rclpy.spin_until_future_complete(node, future, timeout_sec=LIMIT)
    return future.result()


def main(what: str, *arguments: str) -> None:
    rclpy.init()
    node = rclpy.create_node("goal_client")
    {"send": send, "change": change_state}[what](node, *arguments)


if __name__ == "__main__":
    main(*sys.argv[1:])
