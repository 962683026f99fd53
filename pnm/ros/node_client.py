"""A client of a running node: asks and commands it, hears of its tasks, and sends it goals."""

from __future__ import annotations

import asyncio
import json
import os
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager
from functools import partial
from typing import Any, Final
from uuid import UUID, uuid4

from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Accepted, Ended, Outcome, Report, Request
from pnm.errors import InputError, RosError
from pnm.knowledge.source import SourceError
from pnm.ros.action_client.client import Ros2ActionClient
from pnm.ros.knowledge import DEPTH
from pnm.ros.node.graph import server_name, servers, snapshot
from pnm.ros.node.messages import import_type, to_message
from pnm.ros.node.ros_thread import RosThread, call_on_loop, profile
from pnm.ros.node.services import ServiceClient, until_true

LIMIT: Final = 10.0
"""Seconds for the node to be found, and to answer what takes it no time."""
ENDING: Final = 60.0
"""Seconds for what ends only when robots have confirmed that they stop."""
RETURN: Final = 120.0
"""Seconds for a node that has died to be back with its tasks."""
_NOBODY: Final = UUID(int=0)
"""The id that stands for all tasks."""


class NodeClient:
    """A client of `pnm serve`, over the services, topics and actions that the node has for all; its own node is in the same namespace."""

    def __init__(self, ros: RosThread) -> None:
        self._ros = ros

    async def status(self) -> Any:
        """Return the last ``ExecutorStatus``; raise a `RosError` if there is none."""
        async with self.hearing("pnm_interfaces/msg/ExecutorStatus", "executor/status", latched=True) as heard:
            try:
                return await asyncio.wait_for(heard.get(), LIMIT)
            except TimeoutError as error:
                raise RosError(await self._absence("nothing is heard on executor/status")) from error

    async def task(self, prefix: str) -> UUID:
        """Return the task whose id begins so, for an empty one the only task that is not over; raise `InputError` if there is not one."""
        status = await self.status()
        tasks = [UUID(bytes=bytes(task.id.uuid)) for task in status.tasks if prefix or task.state != task.OVER]
        fitting = [task for task in tasks if task.hex.startswith(prefix.replace("-", "").lower())]
        if len(fitting) == 1:
            return fitting[0]
        if not tasks:
            raise InputError("no task is going on")
        known = ", ".join(task.hex[:8] for task in fitting or tasks)
        if not fitting:
            raise InputError(f"no task has an id that begins with {prefix!r}; there are {known}")
        raise InputError(f"expected the beginning of the id of one task, or --all; there are {known}")

    async def hands(self) -> list[dict[str, Any]]:
        """Return what people have in their hands, each with its name, since when, by whom and why."""
        answer = await self.ask("pnm_interfaces/srv/QueryKnowledge", "executor/hands/query", {})
        return list(json.loads(answer.value))

    async def put(self, name: str, said: Mapping[str, str] | None) -> str:
        """Take a robot over, saying by whom and why, or give it back for None; return what may still be at work, in words."""
        fields = {"goal_id": uuid4(), "name": name, "value": json.dumps(said)}  # by the id, a request that is repeated counts once
        answer = await self.ask("pnm_interfaces/srv/UpdateKnowledge", "executor/hands/update", fields, ENDING)
        return str(answer.message)

    async def command(self, command: str, task: UUID | None, **fields: object) -> None:
        """Pause, resume or cancel a task, or all; raise a `RosError` with the node's reason if it does not."""
        kind = f"pnm_interfaces/srv/{command.capitalize()}Task"
        await self.ask(kind, f"executor/{command}", {"task": task or _NOBODY, **fields}, ENDING)

    async def ask(self, kind: str, service: str, request: Mapping[str, object], limit: float = LIMIT) -> Any:
        """Call a service of the node and return its response; raise a `RosError` if it is not there, or refuses."""
        client = ServiceClient(self._ros, kind, service)
        try:
            response = await client.call(request, limit)
        except SourceError as error:
            raise RosError(await self._absence(str(error))) from error
        finally:
            await client.close()
        if not response.success:
            raise RosError(response.message)
        return response

    async def achieve(self, goal: Mapping[str, object], task: UUID) -> Outcome:
        """Have a goal reached, as the task of this id; when cancelled, cancel it and wait until it is over."""
        return _outcome(await self._carry_out("achieve_goal", "AchieveGoal", goal, task))

    async def send(self, server: str, goal: Mapping[str, object], task: UUID) -> None:
        """Send a goal to an action that has goals reached, and leave it to the node; raise a `RosError` if that rejects it."""
        report = await self._carry_out(server, "AchieveGoal", goal, task, Accepted)
        if isinstance(report, Ended):
            raise RosError(f"the node has not accepted the goal: {report.outcome.message or report.outcome.kind.value}")

    async def execute(self, plan: str, parameters: str, goal: Mapping[str, object], task: UUID) -> Outcome:
        """Have a plan that the node has loaded carried out, as `achieve` does; its parameters are a mapping as JSON."""
        return _outcome(await self._carry_out("execute_plan", "ExecutePlan", {"plan": plan, "parameters": parameters, **goal}, task))

    async def has_plan(self, name: str) -> bool:
        """Return whether the node has loaded a plan of this name, which has an action server then."""
        await self._ros.settled()

        def look() -> bool:
            return "pnm_interfaces/action/RunPlan" in servers(self._ros.node).get(server_name(self._ros.node, name), ())

        return await self._ros.ask(look)

    async def plan(self, goal: str, *, with_new_plans: bool = True) -> Outcome:
        """Have a plan made for a goal, with its odds; they are with new plans after failures, unless that takes the node too long."""
        return _outcome(await self._carry_out("plan", "MakePlan", {"goal": goal, "with_new_plans": with_new_plans}, uuid4()))

    async def _carry_out(self, server: str, kind: str, goal: Mapping[str, object], id: UUID, until: type[Report] = Ended) -> Report:
        """Send a goal; return the first report of a kind, or that of its end."""
        loop, action = asyncio.get_running_loop(), GroundAction(server)
        binding = Binding(server=server, type=f"pnm_interfaces/action/{kind}")
        client = Ros2ActionClient(self._ros, Bindings({server: binding}), loop, grace=RETURN)
        over: asyncio.Future[Report] = loop.create_future()

        def hear(report: Report) -> None:
            if isinstance(report, (until, Ended)) and not over.done():
                over.set_result(report)

        try:
            if await client.prepare([action], LIMIT):
                raise RosError(await self._absence(f"there is no action server {server}"))
            client.send(Request(id, action, goal), hear)
            try:
                return await asyncio.shield(over)
            except asyncio.CancelledError:
                client.cancel(id)
                return await asyncio.wait_for(over, ENDING)
        finally:
            client.close()

    @asynccontextmanager
    async def answering(self) -> AsyncIterator[Callable[[str, str], Awaitable[None]]]:
        """Yield what answers a question to people, by its id; it raises a `RosError` if nobody hears it.

        The publisher is there from the beginning: what is published before both sides know each other may get lost.
        """
        from rclpy.duration import Duration  # here, because rclpy is an extra

        kind = import_type("pnm_interfaces/msg/Answer")
        topic = await self._ros.ask(lambda: self._ros.node.create_publisher(kind, "knowledge/answers", profile(DEPTH)))

        async def answer(question: str, text: str) -> None:
            def publish() -> bool:
                topic.publish(to_message(kind, {"id": question, "value": text}))
                return bool(topic.wait_for_all_acked(Duration(seconds=1)))

            try:
                async with asyncio.timeout(LIMIT):
                    await until_true(self._ros, topic.get_subscription_count)
                await self._ros.ask(publish)
            except TimeoutError as error:
                raise RosError(await self._absence("nobody listens on knowledge/answers")) from error

        try:
            yield answer
        finally:
            self._ros.call(lambda: self._ros.node.destroy_publisher(topic))

    @asynccontextmanager
    async def hearing(self, kind: str, topic: str, *, latched: bool = False, depth: int = 1) -> AsyncIterator[asyncio.Queue[Any]]:
        """Subscribe to a topic, whose messages are in the queue; of a latched one, so many of the last ones."""
        heard, qos = asyncio.Queue[Any](), profile(depth if latched else 1000, latched=latched)
        receive = partial(call_on_loop, asyncio.get_running_loop(), heard.put_nowait)
        subscription = await self._ros.ask(lambda: self._ros.node.create_subscription(import_type(kind), topic, receive, qos))
        try:
            yield heard
        finally:
            self._ros.call(lambda: self._ros.node.destroy_subscription(subscription))

    async def _absence(self, what: str) -> str:
        namespace = await self._ros.ask(self._ros.node.get_namespace)
        domain = os.environ.get("ROS_DOMAIN_ID", "0")
        return f"{what}; is `pnm serve` running, in the namespace {namespace} and with ROS_DOMAIN_ID={domain}?"


POSES: Final = ("geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped", "nav_msgs/msg/Odometry")
"""Types of messages with the pose of a robot."""


async def heard_pose(ros: RosThread, topic: str, limit: float) -> tuple[float, float, float, float, str]:
    """Return x and y of a robot's pose, z and w of its rotation and its frame, by the next message of a topic, or the latched one.

    Without the name of a topic it is the only one with such messages, or the one called ``amcl_pose``.

    Raises:
        InputError: there is no such topic, or there are several.
        RosError: nothing comes within so many seconds.
    """
    await ros.settled()
    there = await ros.ask(lambda: {name: types[0] for name, types in snapshot(ros.node).topics.items() if types[0] in POSES})
    wanted = [name for name in there if name.strip("/") == topic.strip("/")] if topic else [*there]
    chosen = [name for name in wanted if name.endswith("amcl_pose")] or wanted
    if len(chosen) != 1:
        kinds, among = " or ".join(kind.replace("/msg", "") for kind in POSES), ", ".join(there)
        raise InputError(f"expected --topic and one topic of {kinds}; there {f'are {among}' if there else 'is none (is the robot on?)'}")
    client, kind = NodeClient(ros), there[chosen[0]]
    async with client.hearing(kind, chosen[0]) as new, client.hearing(kind, chosen[0], latched=True) as latched:
        heard = [asyncio.ensure_future(queue.get()) for queue in (new, latched)]
        done, waiting = await asyncio.wait(heard, timeout=limit, return_when=asyncio.FIRST_COMPLETED)
        for task in waiting:
            task.cancel()
        if not done:
            raise RosError(f"nothing was heard on {chosen[0]} for {limit:g} s")
        message = done.pop().result()
    pose = message.pose if kind == POSES[0] else message.pose.pose
    turn = pose.orientation
    return pose.position.x, pose.position.y, turn.z, turn.w, message.header.frame_id or "map"


def _outcome(report: Report) -> Outcome:
    assert isinstance(report, Ended), "nothing else was waited for"
    return report.outcome
