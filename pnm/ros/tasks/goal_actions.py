"""Tasks as goals of the actions ``achieve_goal`` and ``execute_plan``, and of one action for every plan that is loaded.

The id of a task is that of its goal. A goal SUCCEEDED if its task ended with `Code.GOAL_REACHED`; it is CANCELED if
cancellation was requested and its task has ended so; in all other cases it is ABORTED, and the result has the reason. A
task goes on when the client of its goal disappears.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final
from uuid import UUID

from pnm.errors import InputError
from pnm.ros.action_server.goal_server import FEEDBACK, GoalCallbacks, GoalResult, GoalServer, GoalStatus
from pnm.ros.node.publisher import Throttle
from pnm.ros.node.ros_thread import RosThread
from pnm.ros.tasks.executor_topics import clock_offset
from pnm.ros.tasks.task_messages import (
    Fields,
    goal_ending_fields,
    made_fields,
    plan_ending_fields,
    run_ending_fields,
    run_feedback_fields,
    seconds,
    task_feedback_fields,
    wanted_goal,
    wanted_plan,
    wanted_run,
)
from pnm.tasks import (
    SHORT,
    Code,
    KeptTasks,
    MadePlan,
    Make,
    TaskEnding,
    TaskListener,
    TaskRefused,
    Tasks,
    TaskStatus,
    TaskStep,
    TraceEvent,
    TraceKind,
    Wanted,
)


@dataclass(frozen=True, slots=True)
class _TaskAction:
    """An action for tasks: its type, the reader of its goals, and the writers of results and feedback."""

    type: str
    read: Callable[[UUID, Any], Wanted]
    write: Callable[[TaskEnding, float], Fields]
    feedback: Callable[[TaskStatus, Iterable[TaskStep]], Fields] = task_feedback_fields


_ACTIONS: Final = {
    "achieve_goal": _TaskAction("pnm_interfaces/action/AchieveGoal", wanted_goal, goal_ending_fields),
    "execute_plan": _TaskAction("pnm_interfaces/action/ExecutePlan", wanted_plan, plan_ending_fields),
}
NAMES: Final = tuple(_ACTIONS)

_log = logging.getLogger(__name__)


class TaskServers(TaskListener):
    """The action servers for tasks; goals are rejected while `closed` returns a reason.

    `plans` are those that have an action server of their own, with its full name; `kept` are tasks that another process has accepted,
    and how they have ended, if they have.
    The mutable state is, by task, the name of the action whose goal it is; the tasks whose cancellation was requested; and those
    for which feedback is due.
    """

    def __init__(self, ros: RosThread, tasks: Tasks, plans: Mapping[str, str], closed: Callable[[], str], kept: KeptTasks = ()) -> None:
        self._ros = ros
        self._tasks = tasks
        self._loop = asyncio.get_running_loop()
        self._actions = _ACTIONS | {
            name: _TaskAction("pnm_interfaces/action/RunPlan", partial(wanted_run, plan), run_ending_fields, run_feedback_fields)
            for plan, name in plans.items()
        }
        self._servers = {
            name: GoalServer(ros, action.type, name, GoalCallbacks(partial(self._accept, name), self._cancel))
            for name, action in self._actions.items()
        }
        self._closed = closed
        self._kept = [(wanted, ending) for wanted, ending in kept if wanted.server in self._servers]
        self._open = {wanted.id: wanted.server for wanted, _ in self._kept}
        self._cancel_asked: set[UUID] = set()
        self._feedback_due: set[UUID] = set()
        self._feedback: Throttle[None] = Throttle(self._loop, FEEDBACK, self._feed)
        self._work: set[asyncio.Task[Any]] = set()
        self._stop: Callable[[], None] = lambda: None

    def __repr__(self) -> str:
        return f"<TaskServers {len(self._open)} goals>"

    async def open(self) -> None:
        """Bring the servers up."""
        self._stop = self._tasks.listen(self)
        for name, server in self._servers.items():
            await server.open(wanted.id for wanted, _ in self._kept if wanted.server == name)
        for wanted, ending in self._kept:
            if ending is not None:
                self.ended(wanted.id, ending)

    async def close(self) -> None:
        """End the goals whose tasks have not ended, and take the servers down once all results are sent."""
        for goal in tuple(self._open):
            self.ended(goal, TaskEnding(Code.CANCELLED, "the node is shut down; calls of the task have not confirmed the cancellation"))
        await asyncio.gather(*(server.close() for server in self._servers.values()))
        self._stop()
        self._stop = lambda: None
        self._feedback.close()
        for task in self._work:
            task.cancel()

    def note_cancel(self, task: UUID | None) -> None:
        """Note that the cancellation of a task, or of all, was requested by other means than its goal."""
        self._cancel_asked |= self._open.keys() & ({task} if task else self._open.keys())

    def restored(self) -> None:
        """Cancel the tasks of another process whose clients have asked for that before they went on here."""
        for goal in self._cancel_asked & self._open.keys():
            self._cancel(goal)

    # goals for tasks

    async def _accept(self, name: str, goal: UUID, request: Any) -> str:
        """Begin the task of a goal, unless the node is closed: it is kept then. What is wrong with the goal is said in its result."""
        if reason := self._closed():
            return reason
        if goal in self._open or not goal.int:
            taken = f"the id {goal} is that of another task, or of none; expected a new one"
            self._end(name, goal, TaskEnding(Code.INVALID_GOAL, taken), is_cancel_asked=False)
            return ""
        self._open[goal] = name
        read = partial(self._actions[name].read, goal, request)
        texts = (getattr(request, field) for field in ("goal", "plan", "parameters") if hasattr(request, field))
        try:
            wanted = replace(read() if sum(map(len, texts)) <= SHORT else await asyncio.to_thread(read), server=name)
            if goal in self._cancel_asked:  # while it was read
                self.ended(goal, TaskEnding(Code.CANCELLED, "its client has cancelled it"))
            elif goal in self._open:
                self._tasks.begin(wanted)
        except InputError as error:
            self.ended(goal, TaskEnding(Code.INVALID_GOAL, str(error)))
        except Exception as error:
            _log.exception("a task cannot begin")
            self.ended(goal, TaskEnding(Code.ERROR, f"{type(error).__name__}: {error}"))
        return ""

    def _cancel(self, goal: UUID) -> None:
        if goal in self._open:
            self._cancel_asked.add(goal)
            task = self._loop.create_task(self._cancel_task(goal))
            self._work.add(task)
            task.add_done_callback(self._work.discard)

    async def _cancel_task(self, goal: UUID) -> None:
        try:
            await self._tasks.cancel(goal, why="its client has cancelled it")
        except TaskRefused as refusal:
            _log.info("a goal cannot be cancelled: %s", refusal)
        except Exception:
            _log.exception("a goal cannot be cancelled")

    # events of tasks

    def changed(self, task: UUID) -> None:
        """Make feedback due."""
        if task in self._open:
            self._feedback_due.add(task)
            self._feedback.note(None)

    def planned(self, task: UUID) -> None:
        """Make feedback due."""
        self.changed(task)

    def happened(self, moment: TraceEvent) -> None:
        """Make feedback due that passes on what the server of a call says."""
        if moment.kind is TraceKind.FEEDBACK:
            self.changed(moment.task)

    def ended(self, task: UUID, ending: TaskEnding) -> None:
        """End the goal of the task."""
        if task in self._open:
            is_cancel_asked = task in self._cancel_asked
            self._cancel_asked.discard(task)
            self._feedback_due.discard(task)
            self._end(self._open.pop(task), task, ending, is_cancel_asked)

    def _end(self, name: str, goal: UUID, ending: TaskEnding, is_cancel_asked: bool) -> None:
        status = status_of(ending.code, is_cancel_asked)
        self._servers[name].end(goal, lambda: GoalResult(status, self._actions[name].write(ending, clock_offset(self._ros, self._loop))))

    def _feed(self, _: None) -> None:
        due, self._feedback_due = self._feedback_due, set()
        for status in self._tasks.status():
            if status.id in due and status.id in self._open:
                name = self._open[status.id]
                self._servers[name].feed(status.id, self._actions[name].feedback(status, self._tasks.plan(status.id)[1]))


def status_of(code: Code, is_cancel_asked: bool) -> GoalStatus:
    """Return the status of a goal whose task ended with this code."""
    if code is Code.GOAL_REACHED:
        return GoalStatus.SUCCEEDED
    return GoalStatus.CANCELED if code is Code.CANCELLED and is_cancel_asked else GoalStatus.ABORTED


# --- plans without execution -----------------------------------------------------------
# The action ``plan``: answers plan requests, from the current state, without execution.


NAME: Final = "plan"
SECOND: Final = 1.0
"""Seconds between two feedback messages about a search."""


class PlanningServer:
    """The action server for plan requests, which are rejected while `closed` returns a reason.

    The mutable state is the searches by goal, and those whose clients have cancelled them.
    """

    def __init__(self, ros: RosThread, make: Make, closed: Callable[[], str]) -> None:
        self._make = make
        self._loop = asyncio.get_running_loop()
        self._searches: dict[UUID, asyncio.Task[MadePlan]] = {}
        self._cancel_asked: set[UUID] = set()
        self._closed = closed
        self._server = GoalServer(ros, "pnm_interfaces/action/MakePlan", NAME, GoalCallbacks(self._accept, self._cancel))

    def __repr__(self) -> str:
        return f"<PlanningServer {len(self._searches)} searches>"

    async def open(self) -> None:
        """Bring the server up."""
        await self._server.open()

    async def close(self) -> None:
        """Cancel all searches, and take the server down."""
        for search in self._searches.values():
            search.cancel()
        if self._searches:
            await asyncio.wait(self._searches.values())
        await self._server.close()

    async def _accept(self, goal: UUID, request: Any) -> str:
        if reason := self._closed():
            return reason
        search = self._loop.create_task(self._search(request))
        feeding = self._loop.create_task(self._feed(goal))
        self._searches[goal] = search
        search.add_done_callback(partial(self._end, goal, feeding))
        return ""

    def _cancel(self, goal: UUID) -> None:
        if goal in self._searches:
            self._cancel_asked.add(goal)
            self._searches[goal].cancel()

    async def _search(self, request: Any) -> MadePlan:
        try:
            return await self._make(request.goal.strip(), request.planner.strip(), seconds("timeout", request.timeout))
        except InputError as error:
            return MadePlan(Code.INVALID_GOAL, str(error))
        except Exception as error:
            _log.exception("a plan cannot be looked for")
            return MadePlan(Code.ERROR, f"{type(error).__name__}: {error}")

    def _end(self, goal: UUID, feeding: asyncio.Task[None], search: asyncio.Task[MadePlan]) -> None:
        feeding.cancel()
        del self._searches[goal]
        made = MadePlan(Code.CANCELLED, "the search was given up") if search.cancelled() else search.result()
        status = status_of(made.code, goal in self._cancel_asked)
        self._cancel_asked.discard(goal)
        self._server.end(goal, lambda: GoalResult(status, made_fields(made)))

    async def _feed(self, goal: UUID) -> None:
        began = self._loop.time()
        while True:
            await asyncio.sleep(SECOND)
            self._server.feed(goal, {"seconds": self._loop.time() - began})
