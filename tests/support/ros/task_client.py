"""A client of a node that offers tasks, which knows only ROS 2 and the interfaces; every wait has a limit."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any
from uuid import UUID, uuid4

from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from rclpy.qos import DurabilityPolicy, QoSProfile
from unique_identifier_msgs import msg

from pnm.ros.node.messages import import_type, to_data, to_message
from pnm.ros.node.ros_thread import RosThread
from pnm.ros.node.services import ServiceClient, until_true
from tests.support.processes import LIMIT

SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
TYPES = {"achieve_goal": "AchieveGoal", "execute_plan": "ExecutePlan", "plan": "MakePlan"}
SERVICES = {
    "executor/pause": "PauseTask",
    "executor/resume": "ResumeTask",
    "executor/cancel": "CancelTask",
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


def uuid_data(uuid: UUID) -> dict[str, Any]:
    return {"uuid": list(uuid.bytes)}


@dataclass
class SentGoal:
    """A goal, and what is heard of it."""

    id: UUID
    accepted: asyncio.Future[bool]
    over: asyncio.Future[tuple[int, dict[str, Any]]]
    feedback: asyncio.Queue[dict[str, Any]] = field(default_factory=asyncio.Queue)
    handle: Any = None

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


class TaskClient:
    """Its goals, requests and subscriptions; nothing is sent before the servers have answered something harmless."""

    def __init__(self, ros: RosThread) -> None:
        self._ros = ros
        self._loop = asyncio.get_running_loop()
        self._actions: dict[str, Any] = {}
        self._services: dict[str, ServiceClient] = {}
        self._subscriptions: list[Any] = []

    async def send(self, action: str, id: UUID | None = None, **goal: object) -> SentGoal:
        """Send a goal; an action whose type is not known is that of a plan."""
        await self.meet(action)
        sent = SentGoal(id or uuid4(), self._loop.create_future(), self._loop.create_future())
        kind = _type(action)
        await self._ros.ask(partial(self._send, action, to_message(kind.Goal, goal), sent))
        assert await asyncio.wait_for(asyncio.shield(sent.accepted), LIMIT) in (True, False)
        return sent

    async def cancel(self, sent: SentGoal) -> int:
        """Ask for a goal to be cancelled; return how many goals are being cancelled."""
        answer = await self._future(lambda: sent.handle.cancel_goal_async())
        return len(answer.goals_canceling)

    async def call(self, name: str, type_name: str = "", **request: object) -> dict[str, Any]:
        if name not in self._services:
            self._services[name] = ServiceClient(self._ros, type_name or f"pnm_interfaces/srv/{SERVICES[name]}", name)
        return to_data(await self._services[name].call(request, LIMIT))

    async def subscribe(self, topic: str) -> asyncio.Queue[dict[str, Any]]:
        heard: asyncio.Queue[dict[str, Any]] = asyncio.Queue()
        kind = import_type(f"pnm_interfaces/msg/{TOPICS[topic]}")
        durability = DurabilityPolicy.TRANSIENT_LOCAL if topic in LATCHED else DurabilityPolicy.VOLATILE
        qos = QoSProfile(depth=100, durability=durability)
        receive = partial(self._receive, heard)
        self._subscriptions.append(await self._ros.ask(lambda: self._ros.node.create_subscription(kind, topic, receive, qos)))
        return heard

    async def close(self) -> None:
        for service in self._services.values():
            await service.close()
        await self._ros.ask(self._destroy)

    async def meet(self, action: str) -> None:
        """Ask for the result of a goal that nobody has, until that is answered."""
        if action in self._actions:
            return
        await self._ros.ask(partial(self._connect, action))
        client = self._actions[action]
        async with asyncio.timeout(LIMIT):
            await until_true(self._ros, client.server_is_ready)
            while True:
                with suppress(TimeoutError):
                    await self._future(partial(_ask_for_nothing, client), 1.0)
                    return

    async def _future(self, start: Callable[[], Any], limit: float = LIMIT) -> Any:
        answered: asyncio.Future[Any] = self._loop.create_future()
        await self._ros.ask(lambda: self._hand_over(start(), answered))
        return await asyncio.wait_for(answered, limit)

    # on the ROS thread

    def _connect(self, action: str) -> None:
        kind, deep = _type(action), QoSProfile(depth=1000)
        self._actions[action] = ActionClient(
            self._ros.node, kind, action, goal_service_qos_profile=deep, result_service_qos_profile=deep, cancel_service_qos_profile=deep
        )

    def _send(self, action: str, goal: Any, sent: SentGoal) -> None:
        def feed(message: Any) -> None:
            self._loop.call_soon_threadsafe(sent.feedback.put_nowait, to_data(message.feedback))

        def answered(future: Any) -> None:
            sent.handle = future.result()
            self._loop.call_soon_threadsafe(sent.accepted.set_result, sent.handle.accepted)
            if sent.handle.accepted:
                sent.handle.get_result_async().add_done_callback(ended)

        def ended(future: Any) -> None:
            answer = future.result()
            self._loop.call_soon_threadsafe(self._over, sent, (answer.status, to_data(answer.result)))

        uuid = msg.UUID(uuid=list(sent.id.bytes))
        self._actions[action].send_goal_async(goal, feedback_callback=feed, goal_uuid=uuid).add_done_callback(answered)

    def _hand_over(self, future: Any, answered: asyncio.Future[Any]) -> None:
        def take(found: Any) -> None:
            if not answered.done():
                answered.set_result(found)

        future.add_done_callback(lambda future: self._loop.call_soon_threadsafe(take, future.result()))

    def _over(self, sent: SentGoal, answer: tuple[int, dict[str, Any]]) -> None:
        if not sent.over.done():
            sent.over.set_result(answer)

    def _receive(self, heard: asyncio.Queue[dict[str, Any]], message: Any) -> None:
        with suppress(RuntimeError):
            self._loop.call_soon_threadsafe(heard.put_nowait, to_data(message))

    def _destroy(self) -> None:
        for client in self._actions.values():
            client.destroy()
        for subscription in self._subscriptions:
            self._ros.node.destroy_subscription(subscription)


def _type(action: str) -> Any:
    return import_type(f"pnm_interfaces/action/{TYPES.get(action.rpartition('/')[2], 'RunPlan')}")


def _ask_for_nothing(client: Any) -> Any:
    return ClientGoalHandle(client, msg.UUID(uuid=list(uuid4().bytes)), None).get_result_async()
