"""The ROS 2 interface of a task executor: its actions, services and topics, brought up and taken down together."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Collection, Iterable, Mapping
from typing import Any, Final
from uuid import UUID

from pnm.errors import InputError
from pnm.ros.node.graph import server_name
from pnm.ros.node.ros_thread import RosThread
from pnm.ros.node.services import Fields, RequestServices
from pnm.ros.tasks.executor_topics import TaskTopics
from pnm.ros.tasks.goal_actions import NAME as PLAN
from pnm.ros.tasks.goal_actions import NAMES, PlanningServer, TaskServers
from pnm.tasks import KeptTasks, Make, ServedWorld, TaskRefused, Tasks, TaskState, Wanted

ACTIONS: Final = (*NAMES, PLAN)

_log = logging.getLogger(__name__)


class TaskNode:
    """Offers tasks over ROS 2. Goals are accepted between `activate` and `deactivate`.

    The mutable state is why goals are rejected, whether a client has paused all tasks or which of them, and whether
    `deactivate` has paused them. `plans` have an action server of their own, with this full name; `kept` are the tasks of another
    process, whose clients are still waiting.
    """

    def __init__(
        self, ros: RosThread, tasks: Tasks, make: Make, world: ServedWorld, plans: Mapping[str, str] | None = None, kept: KeptTasks = ()
    ) -> None:
        self._ros = ros
        self._tasks = tasks
        self._world = world
        self._closed = "the node is inactive"
        self._is_paused = False
        self._paused: set[UUID] = set()
        self._is_deactivated = False
        self._servers = TaskServers(ros, tasks, plans or {}, lambda: self._closed, kept)
        self._planning = PlanningServer(ros, make, lambda: self._closed)
        self._topics = TaskTopics(ros, tasks, world, lambda: self._is_paused)
        self._services = RequestServices(ros)

    def __repr__(self) -> str:
        return f"<TaskNode {self._closed or 'active'}>"

    async def open(self) -> None:
        """Bring everything up; goals are rejected until `activate`."""
        # Topics listen first, so that subscribers can read the end of a task before its client has the result.
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
        """Accept goals, and resume the tasks that `deactivate` has paused."""
        self._closed = ""
        if self._is_deactivated and not self._is_paused:
            await self._tasks.resume(None, but=self._paused)
        self._is_deactivated = False
        self._topics.note()

    def restored(self, is_paused: bool, paused: Collection[UUID]) -> None:
        """Go on with the tasks of another process, of which all were paused, or some; cancel those whose clients asked for it meanwhile."""
        self._is_paused, self._paused = is_paused, {*paused}
        self._topics.note()
        self._servers.restored()

    async def deactivate(self) -> None:
        """Reject goals, and pause all tasks at once: running actions are cancelled; returns when they have confirmed it."""
        self._closed = "the node is inactive"
        self._is_deactivated = True
        await self._tasks.pause(None, at_once=True, why=self._closed, is_kept=False)

    async def close(self, limit: float) -> None:
        """Cancel all tasks, wait for `limit` seconds at most until they have ended, send all results, and take everything down."""
        self._closed = "the node is shut down"
        try:
            async with asyncio.timeout(limit):
                await self._tasks.cancel(None, why=self._closed)
        except TimeoutError:
            _log.debug("tasks have not ended within %g s", limit)
        except TaskRefused:
            _log.debug("there are no tasks to cancel")
        finally:  # also when the wait is cancelled, by a second signal
            for status in self._tasks.status():
                if status.state is not TaskState.OVER:
                    _log.warning("%s has not ended; its calls are left alone", status.goal)
        await self._planning.close()
        await self._servers.close()
        await self._services.close()
        await self._topics.close()

    # what is wanted of tasks, by the services and by others, as `pnm.tasks.TaskCommands`

    def begin(self, wanted: Wanted, /) -> None:
        """Begin a task that is no goal of the actions."""
        if self._closed:
            raise TaskRefused(f"{self._closed}: it takes no goals")
        self._tasks.begin(wanted)

    async def pause(self, task: UUID | None, /, *, at_once: bool) -> None:
        """Pause a task, or all."""
        self._refuse_inactive()
        if task is None:
            self._is_paused = True
        else:
            known = {status.id for status in self._tasks.status()}
            self._paused = known & {*self._paused, task}  # tasks that are over are forgotten
        await self._tasks.pause(task, at_once=at_once)
        self._topics.note()

    async def resume(self, task: UUID | None, /) -> None:
        """Let a task go on, or all."""
        self._refuse_inactive()
        if task is None:
            self._is_paused = False
            self._paused.clear()
        else:
            self._paused.discard(task)
        await self._tasks.resume(task)
        self._topics.note()

    async def cancel(self, task: UUID | None, /) -> None:
        """End a task, or all."""
        self._servers.note_cancel(task)
        await self._tasks.cancel(task)

    # the services

    async def _pause(self, request: Any) -> Fields:
        await self.pause(_id(request.task), at_once=request.at_once)
        return {}

    async def _resume(self, request: Any) -> Fields:
        await self.resume(_id(request.task))
        return {}

    async def _cancel(self, request: Any) -> Fields:
        await self.cancel(_id(request.task))
        return {}

    async def _query(self, request: Any) -> Fields:
        answers = await self._world.query(request.questions)
        return {"facts": [question for question, _ in answers], "values": [answer for _, answer in answers]}

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
    """Return the full names of the actions for tasks, and of the action of each plan; only on the ROS thread.

    Raises `InputError` if the name of a plan is not valid in ROS, or is that of another action.
    """
    own = tuple(server_name(ros.node, name) for name in ACTIONS)
    names: dict[str, str] = {}
    for plan in plans:
        name = server_name(ros.node, plan)
        if name in own:
            raise InputError(f"the plan {plan} would have the action server {name}, which the node offers for all tasks")
        if name in names.values():
            raise InputError(f"two plans would both have the action server {name}; names in ROS have _ for -")
        names[plan] = name
    return own, names


def _id(message: Any) -> UUID | None:
    task = UUID(bytes=bytes(message.uuid))
    return task if task.int else None  # for all tasks
