"""What lives in other processes: global knowledge, or a person. Run as a module; prints "ready" and then what it hears.

knowledge NAME      keeps variables; the one called "slow" is never answered, "broken" is no JSON, "no" is refused;
                    with "deaf", the first request of each service is never answered either
person NAME WAY     answers questions: "reversed" two at a time, the second first; "never"; "late" once withdrawn, again and again;
                    "deaf" what is asked twice; "wrong" with what is no JSON, with answers to nothing, and then as it should
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from typing import Any

import rclpy
from pnm_interfaces.msg import Answer, Question
from pnm_interfaces.srv import QueryKnowledge, UpdateKnowledge
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.task import Future

from tests.support.processes import say_json
from tests.support.ros.child_process import spin


class RemoteKnowledge:
    """Keeps the JSON texts it is sent."""

    def __init__(self, node: Any, name: str, way: str = "") -> None:
        self.values: dict[str, str] = {"broken": "{"}
        self.ignored = set() if way == "deaf" else {"query", "update"}
        group = ReentrantCallbackGroup()  # what is never answered holds up nothing else
        node.create_service(QueryKnowledge, f"{name}/query", self.query, callback_group=group)
        node.create_service(UpdateKnowledge, f"{name}/update", self.update, callback_group=group)

    async def query(self, request: Any, response: Any) -> Any:
        say_json(["query", request.layer, request.name, request.meta, bytes(request.goal_id.uuid).hex()])
        if request.name == "slow" or self.ignores("query"):
            await Future()
        response.success = request.name != "no"
        response.message = "" if response.success else "not for you"
        response.value = self.values.get(request.name, "")
        response.found = request.name in self.values
        return response

    async def update(self, request: Any, response: Any) -> Any:
        say_json(["update", request.layer, request.name, request.value])
        if self.ignores("update"):
            await Future()
        response.success = request.name != "no"
        self.values[request.name] = request.value
        return response

    def ignores(self, service: str) -> bool:
        first = service not in self.ignored
        self.ignored.add(service)
        return first


class RemotePerson:
    """Answers in one of the ways."""

    def __init__(self, node: Any, name: str, way: str) -> None:
        self.way: Callable[[Any], None] = getattr(self, way)
        self.waiting: list[Any] = []
        self.node = node
        self.answers = node.create_publisher(Answer, f"{name}/answers", 100)
        latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        node.create_subscription(Question, f"{name}/questions", self.hear, latched)

    def hear(self, question: Any) -> None:
        known = next((one for one in self.waiting if one.id == question.id), question)
        say_json([("ask", "withdraw", "tell")[question.kind], known.name, question.text, question.plan, question.meta, question.value])
        self.way(question)

    def never(self, question: Any) -> None:
        self.waiting.append(question)

    def reversed(self, question: Any) -> None:
        if question.kind != Question.ASK:
            return
        self.waiting = [one for one in self.waiting if one.id != question.id] + [question]
        if len(self.waiting) == 2:
            for one in reversed(self.waiting):
                self.answer(one.id, f'"{one.name} it is"')

    def late(self, question: Any) -> None:
        self.waiting.append(question)
        if question.kind == Question.WITHDRAW:  # whoever is to hear of it may not have discovered us yet
            self.node.create_timer(0.1, partial(self.answer, question.id, "1"))

    def deaf(self, question: Any) -> None:
        if any(one.id == question.id for one in self.waiting):
            self.answer(question.id, "1")
        self.waiting.append(question)

    def wrong(self, question: Any) -> None:
        if question.kind == Question.ASK:
            self.answer("nobody", "1")
            self.answer(question.id, "[1")
            self.answers.publish(Answer(id=question.id, value="ignored", unknown=True))
            self.answer(question.id, "2")

    def answer(self, own: str, value: str) -> None:
        self.answers.publish(Answer(id=own, value=value))


def main(kind: str, name: str, *rest: str) -> None:
    rclpy.init()
    node = rclpy.create_node(f"somewhere_{name}")
    kept = RemoteKnowledge(node, name, *rest) if kind == "knowledge" else RemotePerson(node, name, *rest)
    spin(node)
    del kept


if __name__ == "__main__":
    main(*sys.argv[1:])
