"""A task node over ROS 2 whose tasks do as their goals say, and a client of it."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Any

import pytest

from pnm.core.knowledge_base import KnowledgeBase
from pnm.ros.node import services as request_services
from pnm.ros.node.ros_thread import RosThread
from pnm.ros.tasks.task_node import TaskNode
from tests.support.ros.task_client import SentGoal, TaskClient
from tests.support.tasks.fake_tasks import FakeTasks, FakeWorld


@dataclass
class ServingNode:
    node: TaskNode
    tasks: FakeTasks
    knowledge: KnowledgeBase
    client: TaskClient

    async def goal(self, text: str, **fields: object) -> SentGoal:
        return await self.client.send("achieve_goal", goal=text, **fields)

    async def ended(self, text: str, **fields: object) -> tuple[int, dict[str, Any]]:
        return await (await self.goal(text, **fields)).result()


@asynccontextmanager
async def serving_node(two: tuple[RosThread, RosThread], *, is_active: bool = True) -> AsyncIterator[ServingNode]:
    knowledge, tasks = KnowledgeBase(), FakeTasks()
    node = TaskNode(two[0], tasks, FakeWorld(knowledge), {"running": "running_tour"})
    await node.open()
    if is_active:
        await node.activate()
    one = ServingNode(node, tasks, knowledge, TaskClient(two[1]))
    try:
        yield one
    finally:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(request_services, "ARRIVAL", 0.0)  # nobody waits for an answer any more
            await node.close(5.0)
        await one.client.close()
        assert not tasks.listeners
