"""Tasks as goals of the actions ``achieve_goal`` and ``execute_plan``, and of one action for every plan that is loaded.

The id of a task is that of its goal. A goal SUCCEEDED only if its task ended with `Code.GOAL_REACHED`; it is CANCELED only if
somebody asked for that and its task has ended so; in all other cases it is ABORTED, and the result says why. A goal goes on
when its client disappears.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final
from uuid import UUID

from pnm.errors import InputError
from pnm.ros.action_server.goal_server import FEEDBACK, BeginGoal, GoalCallbacks, GoalResult, GoalServer, GoalStatus
from pnm.ros.node.ros_thread import RosThread
from pnm.ros.node.throttle import Throttle
from pnm.ros.tasks.executor_topics import ahead
from pnm.ros.tasks.task_messages import (
    Fields,
    goal_ending_fields,
    plan_ending_fields,
    run_ending_fields,
    run_feedback_fields,
    task_feedback_fields,
    wanted_goal,
    wanted_plan,
    wanted_run,
)
from pnm.tasks import Code, TaskEnding, TaskListener, TaskRefused, Tasks, TaskStatus, TaskStep, Wanted


@dataclass(frozen=True, slots=True)
class _Kind:
    """An action: its type, what reads its goals, and what writes their results and the feedback."""

    type: str
    read: Callable[[UUID, Any], Wanted]
    write: Callable[[TaskEnding, float], Fields]
    tell: Callable[[TaskStatus, Iterable[TaskStep]], Fields] = task_feedback_fields


_KINDS: Final = {
    "achieve_goal": _Kind("pnm_interfaces/action/AchieveGoal", wanted_goal, goal_ending_fields),
    "execute_plan": _Kind("pnm_interfaces/action/ExecutePlan", wanted_plan, plan_ending_fields),
}
NAMES: Final = tuple(_KINDS)

_log = logging.getLogger(__name__)


class TaskServers(TaskListener):
    """The action servers.

    The mutable state is, by task, the action whose goal it is; the tasks that somebody wants cancelled; and those of which there
    is feedback to be sent.

    Args:
        plans: the plans that have an action server of their own, and its full name.
        closed: says why no goals are taken; empty while they are.
    """

    def __init__(self, ros: RosThread, tasks: Tasks, plans: Mapping[str, str], closed: Callable[[], str]) -> None:
        self._ros = ros
        self._tasks = tasks
        self._loop = asyncio.get_running_loop()
        self._kinds = _KINDS | {
            name: _Kind("pnm_interfaces/action/RunPlan", partial(wanted_run, plan), run_ending_fields, run_feedback_fields)
            for plan, name in plans.items()
        }
        self._servers = {
            name: GoalServer(ros, kind.type, name, GoalCallbacks(partial(self._accept, name), self._cancel))
            for name, kind in self._kinds.items()
        }
        self._closed = closed
        self._open: dict[UUID, str] = {}
        self._asked: set[UUID] = set()
        self._noted: set[UUID] = set()
        self._feedback: Throttle[None] = Throttle(self._loop, FEEDBACK, self._feed)
        self._cancelling: set[asyncio.Task[None]] = set()
        self._stop: Callable[[], None] = lambda: None

    def __repr__(self) -> str:
        return f"<TaskServers {len(self._open)} goals>"

    async def open(self) -> None:
        """Bring the servers up."""
        self._stop = self._tasks.listen(self)
        for server in self._servers.values():
            await server.open()

    async def close(self) -> None:
        """Answer those whose tasks have not ended, and take the servers down once all answers are sent."""
        for goal in tuple(self._open):
            self.ended(goal, TaskEnding(Code.CANCELLED, "the node is shut down; what the task runs has not confirmed that it is cancelled"))
        await asyncio.gather(*(server.close() for server in self._servers.values()))
        self._stop()
        self._stop = lambda: None
        self._feedback.close()
        for task in self._cancelling:
            task.cancel()

    def wish_cancelled(self, task: UUID | None) -> None:
        """Note that somebody wants a task to be cancelled, or all."""
        self._asked |= self._open.keys() & ({task} if task else self._open.keys())

    # goals for tasks

    def _accept(self, name: str, request: Any) -> BeginGoal | str:
        return self._closed() or partial(self._begin, name, request)

    def _begin(self, name: str, request: Any, id: UUID) -> None:
        try:
            if id in self._open or not id.int:
                raise InputError(f"the id {id} is that of another task, or of none; expected a new one")
            wanted = self._kinds[name].read(id, request)
        except InputError as error:
            self._answer(name, id, TaskEnding(Code.INVALID_GOAL, str(error)), is_asked=False)
            return
        self._open[id] = name
        try:
            self._tasks.begin(wanted)
        except Exception as error:
            _log.exception("a task cannot begin")
            self.ended(id, TaskEnding(Code.ERROR, f"{type(error).__name__}: {error}"))

    def _cancel(self, goal: UUID) -> None:
        if goal in self._open:
            self._asked.add(goal)
            task = self._loop.create_task(self._have_cancelled(goal))
            self._cancelling.add(task)
            task.add_done_callback(self._cancelling.discard)

    async def _have_cancelled(self, goal: UUID) -> None:
        try:
            await self._tasks.cancel(goal, why="its client has cancelled it")
        except TaskRefused as refusal:
            _log.info("a goal cannot be cancelled: %s", refusal)
        except Exception:
            _log.exception("a goal cannot be cancelled")

    # what happens to tasks

    def changed(self, task: UUID) -> None:
        """Have feedback sent."""
        if task in self._open:
            self._noted.add(task)
            self._feedback.note(None)

    def planned(self, task: UUID) -> None:
        """Have feedback sent."""
        self.changed(task)

    def ended(self, task: UUID, ending: TaskEnding) -> None:
        """Answer the goal of the task."""
        if task in self._open:
            is_asked = task in self._asked
            self._asked.discard(task)
            self._noted.discard(task)
            self._answer(self._open.pop(task), task, ending, is_asked)

    def _answer(self, name: str, goal: UUID, ending: TaskEnding, is_asked: bool) -> None:
        status = status_of(ending.code, is_asked)
        self._servers[name].end(goal, lambda: GoalResult(status, self._kinds[name].write(ending, ahead(self._ros, self._loop))))

    def _feed(self, _: None) -> None:
        noted, self._noted = self._noted, set()
        for status in self._tasks.status():
            if status.id in noted and status.id in self._open:
                name = self._open[status.id]
                self._servers[name].feed(status.id, self._kinds[name].tell(status, self._tasks.plan(status.id)[1]))


def status_of(code: Code, is_asked: bool) -> GoalStatus:
    """Return the status of a goal in ROS 2."""
    if code is Code.GOAL_REACHED:
        return GoalStatus.SUCCEEDED
    return GoalStatus.CANCELED if code is Code.CANCELLED and is_asked else GoalStatus.ABORTED
