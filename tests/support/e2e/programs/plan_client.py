"""A client of a plan's action server that knows nothing of this project but the type of its goals. Run as a module.

    plan_client.py PLAN CANCEL_ON PARAMETERS...    sends a goal for each of the parameters, all at once
    plan_client.py --cancel-all SERVER             cancels whatever goals an action server has

A goal is cancelled as soon as feedback says that a call of the name CANCEL_ON is under way, if that is not empty.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import rclpy
from action_msgs.srv import CancelGoal
from pnm_interfaces.action import RunPlan
from rclpy.action import ActionClient

from tests.support.processes import LIMIT, say_event


class PlanSender:
    def __init__(self, node: Any, plan: str, cancel_on: str) -> None:
        self.client = ActionClient(node, RunPlan, plan)
        self.cancel_on = cancel_on
        self.handles: dict[int, Any] = {}
        self.doomed: set[int] = set()
        self.cancelled: set[int] = set()
        self.waiting = 0

    def send(self, number: int, parameters: str) -> None:
        self.waiting += 1
        goal = RunPlan.Goal(parameters=parameters)
        sent = self.client.send_goal_async(goal, lambda message: self.hear(number, message.feedback))
        sent.add_done_callback(lambda future: self.answered(number, future.result()))

    def answered(self, number: int, handle: Any) -> None:
        say_event("answered", goal=number, accepted=handle.accepted)
        if not handle.accepted:
            self.waiting -= 1
            return
        self.handles[number] = handle
        self.cancel(number)  # feedback may come before the answer
        handle.get_result_async().add_done_callback(lambda future: self.ended(number, future.result()))

    def hear(self, number: int, feedback: Any) -> None:
        running = list(feedback.running)
        say_event("feedback", goal=number, running=running, ended=feedback.ended, restarts=feedback.restarts)
        if self.cancel_on and any(f"{self.cancel_on}(" in call for call in running):
            self.doomed.add(number)
            self.cancel(number)

    def cancel(self, number: int) -> None:
        if number in self.doomed and number in self.handles and number not in self.cancelled:
            self.cancelled.add(number)
            self.handles[number].cancel_goal_async()

    def ended(self, number: int, answer: Any) -> None:
        told = answer.result
        say_event(
            "result",
            goal=number,
            status=answer.status,
            success=told.success,
            reason=told.reason,
            message=told.message,
            results=json.loads(told.results or "null"),
        )
        self.waiting -= 1


def cancel_all(node: Any, server: str) -> None:
    client = node.create_client(CancelGoal, f"{server}/_action/cancel_goal")
    assert client.wait_for_service(LIMIT)
    rclpy.spin_until_future_complete(node, client.call_async(CancelGoal.Request()), timeout_sec=LIMIT)


def main(plan: str, cancel_on: str, *parameters: str) -> None:
    rclpy.init()
    node = rclpy.create_node("plain_client")
    if plan == "--cancel-all":
        cancel_all(node, cancel_on)
        return
    sender = PlanSender(node, plan, cancel_on)
    assert sender.client.wait_for_server(LIMIT), f"there is no {plan}"
    for number, text in enumerate(parameters):
        sender.send(number, text)
    while sender.waiting:
        rclpy.spin_once(node)


if __name__ == "__main__":
    main(*sys.argv[1:])
