"""A client of a node that offers tasks, which knows only ROS 2 and the interfaces; every wait has a limit."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any
from uuid import UUID, uuid4

from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from rclpy.qos import QoSProfile
from unique_identifier_msgs import msg

from pnm.ros.node.messages import import_type, to_data, to_message
from pnm.ros.node.ros_thread import RosThread, call_on_loop, profile
from pnm.ros.node.services import ServiceClient, until_true
from tests.support.processes import LIMIT

SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
TYPES = {"achieve_goal": "AchieveGoal", "propose_goal": "AchieveGoal", "execute_plan": "ExecutePlan", "plan": "MakePlan"}
SERVICES = {
    "executor/pause": "PauseTask",
    "executor/resume": "ResumeTask",
    "executor/cancel": "CancelTask",
    "executor/hands/query": "QueryKnowledge",
    "executor/hands/update": "UpdateKnowledge",
    "knowledge/query": "QueryFacts",
    "knowledge/update": "UpdateFacts",
    "problem/get": "GetProblem",
    "problem/save": "SaveProblem",
    "problem/load": "LoadProblem",
}
TOPICS = {
    "executor/status": "ExecutorStatus",
    "executor/plan": "Plans",
    "executor/net": "Nets",
    "executor/marking": "Marking",
    "executor/trace": "TraceEvent",
    "knowledge/changes": "KnowledgeChange",
}
LATCHED = ("executor/status", "executor/plan", "executor/net")


@dataclass
class SentGoal:
    """A goal, and what is heard of it."""

    ros: RosThread
    id: UUID
    feedback: asyncio.Queue[dict[str, Any]] = field(default_factory=asyncio.Queue)
    handle: Any = None
    """That of `rclpy`, once the goal is accepted or rejected."""
    over: asyncio.Future[tuple[int, dict[str, Any]]] = field(default_factory=lambda: asyncio.get_running_loop().create_future())
    """Its status and result, once it is accepted."""

    async def cancel(self) -> int:
        """Ask for it to be cancelled; return how many goals are being cancelled."""
        return len((await answer(self.ros, self.handle.cancel_goal_async)).goals_canceling)

    async def result(self) -> tuple[int, dict[str, Any]]:
        return await asyncio.wait_for(self.over, LIMIT)

    async def hears(self, found: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
        """Wait for such feedback."""
        async with asyncio.timeout(LIMIT):
            while True:
                told = await self.feedback.get()
                if found(told):
                    return told

    async def is_in(self, state: int) -> dict[str, Any]:
        return await self.hears(lambda told: told["status"]["state"] == state)


async def answer(ros: RosThread, ask: Callable[[], Any], limit: float | None = LIMIT) -> Any:
    """Have the ROS thread ask for something, and await the future of `rclpy` that this returns."""
    loop = asyncio.get_running_loop()
    answered: asyncio.Future[Any] = loop.create_future()

    def take(found: Any) -> None:
        if not answered.done():
            answered.set_result(found)

    await ros.ask(lambda: ask().add_done_callback(lambda future: call_on_loop(loop, take, future.result())))
    return await asyncio.wait_for(answered, limit)


class StockClient:
    """The action client of `rclpy`; nothing is sent before the server has answered something harmless."""

    def __init__(self, ros: RosThread, kind: Any, name: str) -> None:
        self._ros = ros
        self._kind = kind
        deep = {f"{service}_service_qos_profile": QoSProfile(depth=1000) for service in ("goal", "result", "cancel")}
        self._client: Any = ros.submit(lambda: ActionClient(ros.node, kind, name, **deep)).result(LIMIT)

    async def met(self) -> None:
        """Ask for the result of a goal that nobody has, until that is answered."""
        await until_true(self._ros, self._client.server_is_ready)
        nobody = ClientGoalHandle(self._client, msg.UUID(uuid=list(uuid4().bytes)), None)
        while True:
            with suppress(TimeoutError):
                return await answer(self._ros, nobody.get_result_async, 1.0)

    async def send(self, goal: Mapping[str, Any], id: UUID | None = None) -> SentGoal:
        """Send a goal, and wait until it is accepted or rejected."""
        sent, loop = SentGoal(self._ros, id or uuid4()), asyncio.get_running_loop()
        message = to_message(self._kind.Goal, goal)
        heard = {
            "feedback_callback": lambda told: call_on_loop(loop, sent.feedback.put_nowait, to_data(told.feedback)),
            "goal_uuid": msg.UUID(uuid=list(sent.id.bytes)),
        }
        sent.handle = await answer(self._ros, lambda: self._client.send_goal_async(message, **heard))
        if sent.handle.accepted:
            sent.over = asyncio.ensure_future(self._over(sent))
        return sent

    async def _over(self, sent: SentGoal) -> tuple[int, dict[str, Any]]:
        response = await answer(self._ros, sent.handle.get_result_async, None)
        return response.status, to_data(response.result)

    def destroy(self) -> None:
        self._ros.submit(self._client.destroy).result(LIMIT)


class TaskClient:
    """Goals, requests and subscriptions of a client."""

    def __init__(self, ros: RosThread) -> None:
        self._ros = ros
        self._actions: dict[str, StockClient] = {}
        self._services: dict[str, ServiceClient] = {}
        self._subscriptions: list[Any] = []

    async def send(self, action: str, id: UUID | None = None, **goal: object) -> SentGoal:
        """Send a goal; an action whose type is not known is that of a plan."""
        await self.meet(action)
        return await self._actions[action].send(goal, id)

    async def meet(self, action: str) -> None:
        """Connect to an action server."""
        if action not in self._actions:
            kind = import_type(f"pnm_interfaces/action/{TYPES.get(action.rpartition('/')[2], 'RunPlan')}")
            self._actions[action] = StockClient(self._ros, kind, action)
            await asyncio.wait_for(self._actions[action].met(), LIMIT)

    async def call(self, name: str, type_name: str = "", /, **request: object) -> dict[str, Any]:
        if name not in self._services:
            self._services[name] = ServiceClient(self._ros, type_name or f"pnm_interfaces/srv/{SERVICES[name]}", name)
        return to_data(await self._services[name].call(request, LIMIT))

    async def subscribe(self, topic: str) -> asyncio.Queue[dict[str, Any]]:
        heard, loop = asyncio.Queue[dict[str, Any]](), asyncio.get_running_loop()
        kind, qos = import_type(f"pnm_interfaces/msg/{TOPICS[topic]}"), profile(100, latched=topic in LATCHED)

        def receive(message: Any) -> None:
            call_on_loop(loop, heard.put_nowait, to_data(message))

        self._subscriptions.append(await self._ros.ask(lambda: self._ros.node.create_subscription(kind, topic, receive, qos)))
        return heard

    async def close(self) -> None:
        for service in self._services.values():
            await service.close()
        for client in self._actions.values():
            client.destroy()
        await self._ros.ask(lambda: [self._ros.node.destroy_subscription(subscription) for subscription in self._subscriptions])
