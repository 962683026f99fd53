"""A client of a node's action servers that knows only ROS 2 and their types; prints what it hears, a JSON object per line. Run as a module.

    client.py goals GOAL...                        sends goals to be achieved, all at once, and waits for their results
    client.py plan PLAN CANCEL_ON PARAMETERS...    sends a goal to the plan for each of the parameters
    client.py cancel SERVER                        cancels whatever goals an action server has
    client.py change LABEL...                      asks the node /pnm for transitions, one after the other

A goal of a plan is cancelled as soon as feedback says that a call of the name CANCEL_ON is under way, if that is not empty.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any
from uuid import uuid4

import rclpy
from action_msgs.srv import CancelGoal
from lifecycle_msgs.srv import ChangeState, GetState
from pnm_interfaces.action import AchieveGoal, RunPlan
from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from rclpy.qos import QoSProfile
from unique_identifier_msgs.msg import UUID

from tests.support.processes import LIMIT, say_event


def fields_of_plan(result: Any) -> dict[str, object]:
    return {"success": result.success, "results": json.loads(result.results or "null")}


@dataclass
class Sender:
    """Sends goals and says what becomes of them. The mutable state is what has a default."""

    client: ActionClient
    hear: Callable[[int, Any], None]
    more: Callable[[Any], dict[str, object]] = lambda result: {}
    handles: dict[int, Any] = field(default_factory=dict)
    doomed: set[int] = field(default_factory=set)
    waiting: int = 0

    def carry_out(self, node: Any, goals: Iterable[Any]) -> None:
        """Send the goals and wait for their results."""
        assert self.client.wait_for_server(LIMIT), "there is no such action server"
        self.meet(node)
        for number, goal in enumerate(goals):
            self.waiting += 1
            sent = self.client.send_goal_async(goal, lambda message, number=number: self.hear(number, message.feedback))
            sent.add_done_callback(lambda future, number=number: self.answered(number, future.result()))
        while self.waiting:
            rclpy.spin_once(node)

    def meet(self, node: Any) -> None:
        """Ask for the result of a goal that nobody has until there is an answer: what a server answers before it knows us gets lost."""
        implementation = self.client._action_type.Impl
        for _ in range(30):
            handle = ClientGoalHandle(self.client, UUID(uuid=list(uuid4().bytes)), implementation.SendGoalService.Response())
            future = handle.get_result_async()
            rclpy.spin_until_future_complete(node, future, timeout_sec=1.0)
            if future.done():
                return
        raise TimeoutError("the server never answers")

    def answered(self, number: int, handle: Any) -> None:
        say_event("answered", goal=number, accepted=handle.accepted)
        if not handle.accepted:
            self.waiting -= 1
            return
        self.handles[number] = handle
        if number in self.doomed:  # feedback may come before the answer
            handle.cancel_goal_async()
        handle.get_result_async().add_done_callback(lambda future: self.ended(number, future.result()))

    def cancel(self, number: int) -> None:
        """Cancel a goal, once."""
        if number not in self.doomed and number in self.handles:
            self.handles[number].cancel_goal_async()
        self.doomed.add(number)

    def ended(self, number: int, answer: Any) -> None:
        told = answer.result
        say_event("result", goal=number, status=answer.status, reason=told.reason, message=told.message, **self.more(told))
        self.waiting -= 1


def send_goals(node: Any, *goals: str) -> None:
    deep = QoSProfile(depth=1000)
    client = ActionClient(node, AchieveGoal, "achieve_goal", goal_service_qos_profile=deep, result_service_qos_profile=deep)
    sender = Sender(client, lambda number, feedback: say_event("feedback", goal=number, state=feedback.status.state))
    sender.carry_out(node, [AchieveGoal.Goal(goal=goal) for goal in goals])


def send_to_plan(node: Any, plan: str, cancel_on: str, *parameters: str) -> None:
    def hear(number: int, feedback: Any) -> None:
        running = list(feedback.running)
        say_event("feedback", goal=number, running=running, ended=feedback.ended, restarts=feedback.restarts)
        if cancel_on and any(f"{cancel_on}(" in call for call in running):
            sender.cancel(number)

    sender = Sender(ActionClient(node, RunPlan, plan), hear, fields_of_plan)
    sender.carry_out(node, [RunPlan.Goal(parameters=text) for text in parameters])


def answer_to(node: Any, kind: Any, name: str, request: Any) -> Any:
    client = node.create_client(kind, name)
    assert client.wait_for_service(LIMIT)
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future, timeout_sec=LIMIT)
    return future.result()


def cancel_all(node: Any, server: str) -> None:
    answer_to(node, CancelGoal, f"{server}/_action/cancel_goal", CancelGoal.Request())


def change_state(node: Any, *labels: str) -> None:
    say_event("state", label=answer_to(node, GetState, "/pnm/get_state", GetState.Request()).current_state.label)
    for label in labels:
        request = ChangeState.Request()
        request.transition.label = label
        say_event("changed", label=label, success=answer_to(node, ChangeState, "/pnm/change_state", request).success)


def main(what: str, *arguments: str) -> None:
    rclpy.init()
    node = rclpy.create_node("plain_client")
    {"goals": send_goals, "plan": send_to_plan, "cancel": cancel_all, "change": change_state}[what](node, *arguments)


if __name__ == "__main__":
    main(*sys.argv[1:])
