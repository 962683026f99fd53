"""Everything that a node offers about tasks: actions, services and topics, which are brought up and taken down together."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Iterable, Mapping
from typing import Any, Final
from uuid import UUID

from pnm.errors import InputError
from pnm.ros.node.graph import server_name
from pnm.ros.node.ros_thread import RosThread
from pnm.ros.node.service_server import Fields, RequestServices
from pnm.ros.tasks.executor_topics import TaskTopics
from pnm.ros.tasks.goal_actions import NAMES, TaskServers
from pnm.ros.tasks.plan_action import NAME as PLAN
from pnm.ros.tasks.plan_action import PlanningServer
from pnm.tasks import Make, ServedWorld, TaskRefused, Tasks, TaskState

ACTIONS: Final = (*NAMES, PLAN)

_log = logging.getLogger(__name__)


class TaskNode:
    """Offers tasks to whoever knows ROS 2. It takes goals between `activate` and `deactivate`.

    The mutable state is why no goals are taken, whether somebody has paused all tasks or which one by one, and whether we have.

    Args:
        tasks: what is done.
        make: finds plans that nobody carries out.
        world: what others may ask and tell, and whose changes are told.
        plans: the plans that have an action server of their own, and its full name.
    """

    def __init__(self, ros: RosThread, tasks: Tasks, make: Make, world: ServedWorld, plans: Mapping[str, str] | None = None) -> None:
        self._ros = ros
        self._tasks = tasks
        self._world = world
        self._closed = "the node is inactive"
        self._is_paused = False
        self._paused: set[UUID] = set()
        self._is_stopped = False
        self._servers = TaskServers(ros, tasks, plans or {}, lambda: self._closed)
        self._planning = PlanningServer(ros, make, lambda: self._closed)
        self._topics = TaskTopics(ros, tasks, world, lambda: self._is_paused)
        self._services = RequestServices(ros)

    def __repr__(self) -> str:
        return f"<TaskNode {self._closed or 'active'}>"

    async def open(self) -> None:
        """Bring everything up; goals are rejected until the node is activated."""
        # topics first: they are told of the end of a task before its client is
        await self._topics.open()
        await self._servers.open()
        await self._planning.open()
        await self._services.open(
            {
                "executor/pause": ("pnm_interfaces/srv/PauseTask", self._pause),
                "executor/resume": ("pnm_interfaces/srv/ResumeTask", self._resume),
                "executor/cancel": ("pnm_interfaces/srv/CancelTask", self._cancel),
                "knowledge/query": ("pnm_interfaces/srv/QueryFacts", self._query),
                "knowledge/update": ("pnm_interfaces/srv/UpdateFacts", self._update),
                "problem/get": ("pnm_interfaces/srv/GetProblem", self._get),
                "problem/save": ("pnm_interfaces/srv/SaveProblem", self._save),
                "problem/load": ("pnm_interfaces/srv/LoadProblem", self._load),
            }
        )

    async def activate(self) -> None:
        """Take goals, and let those tasks go on that were running when the node was deactivated."""
        self._closed = ""
        if self._is_stopped and not self._is_paused:
            await self._tasks.resume(None, but=self._paused)
        self._is_stopped = False
        self._topics.note()

    async def deactivate(self) -> None:
        """Reject goals, and pause all tasks at once: what is under way is cancelled, and has confirmed it."""
        self._closed = "the node is inactive"
        self._is_stopped = True
        await self._tasks.pause(None, at_once=True, why=self._closed)

    async def close(self, limit: float) -> None:
        """Cancel all tasks, wait so many seconds until that is confirmed, tell everybody, and take everything down."""
        self._closed = "the node is shut down"
        try:
            async with asyncio.timeout(limit):
                await self._tasks.cancel(None, why=self._closed)
        except TimeoutError:
            _log.debug("tasks have not ended within %g s", limit)
        except TaskRefused:
            _log.debug("there are no tasks to cancel")
        finally:  # who asks twice for the end does not wait
            for status in self._tasks.status():
                if status.state is not TaskState.OVER:
                    _log.warning("%s has not ended; what it runs is left alone", status.goal)
        await self._planning.close()
        await self._servers.close()
        await self._services.close()
        await self._topics.close()

    # the services

    async def _pause(self, request: Any) -> Fields:
        task = _id(request.task)
        self._refuse_inactive()
        if task is None:
            self._is_paused = True
        else:
            self._paused = {one.id for one in self._tasks.status() if one.id in {*self._paused, task}}
        await self._tasks.pause(task, at_once=request.at_once)
        self._topics.note()
        return {}

    async def _resume(self, request: Any) -> Fields:
        task = _id(request.task)
        self._refuse_inactive()
        if task is None:
            self._is_paused = False
            self._paused.clear()
        else:
            self._paused.discard(task)
        await self._tasks.resume(task)
        self._topics.note()
        return {}

    async def _cancel(self, request: Any) -> Fields:
        task = _id(request.task)
        self._servers.wish_cancelled(task)
        await self._tasks.cancel(task)
        return {}

    async def _query(self, request: Any) -> Fields:
        found = await self._world.query(request.questions)
        return {"facts": [question for question, _ in found], "values": [answer for _, answer in found]}

    async def _update(self, request: Any) -> Fields:
        return {"changed": await self._world.update(request.add, request.remove, request.forget)}

    async def _get(self, _request: Any) -> Fields:
        domain, problem = await self._world.get()
        return {"domain": domain, "problem": problem}

    async def _save(self, request: Any) -> Fields:
        return {"path": await self._world.save(request.file)}

    async def _load(self, request: Any) -> Fields:
        await self._world.load(request.domain, request.problem)
        return {}

    def _refuse_inactive(self) -> None:
        if self._closed:
            raise TaskRefused(f"{self._closed}: all tasks are paused until it is activated")


def action_names(ros: RosThread, plans: Iterable[str]) -> tuple[tuple[str, ...], dict[str, str]]:
    """Return the full names of the actions, and those of each plan; only on the ROS thread.

    Raises:
        InputError: the name of a plan cannot be a name in ROS, or is that of another action.
    """
    own = tuple(server_name(ros.node, name) for name in ACTIONS)
    found: dict[str, str] = {}
    for plan in plans:
        name = server_name(ros.node, plan)
        if name in own:
            raise InputError(f"the plan {plan} would have the action server {name}, which the node offers for all tasks")
        if name in found.values():
            raise InputError(f"two plans would both have the action server {name}; names in ROS have _ for -")
        found[plan] = name
    return own, found


def _id(message: Any) -> UUID | None:
    found = UUID(bytes=bytes(message.uuid))
    return found if found.int else None
