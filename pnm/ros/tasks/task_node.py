"""The ROS 2 interface of a task executor: its actions, services and topics, brought up and taken down together."""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any, Final
from uuid import UUID

from pnm.core.machine.requests import OutcomeKind
from pnm.errors import InputError
from pnm.ros.action_server.goal_server import FEEDBACK, GoalServer
from pnm.ros.node.graph import server_name
from pnm.ros.node.ros_thread import RosThread
from pnm.ros.node.services import Fields, RequestServices, Throttle
from pnm.ros.tasks.executor_topics import (
    TaskTopics,
    clock_offset,
    goal_ending_fields,
    made_fields,
    plan_ending_fields,
    read_seconds,
    run_ending_fields,
    run_feedback_fields,
    task_feedback_fields,
    wanted_goal,
    wanted_plan,
    wanted_run,
)
from pnm.tasks import (
    PROPOSED,
    SHORT,
    Code,
    KeptTasks,
    MadePlan,
    ServedWorld,
    TaskEnding,
    TaskListener,
    TaskRefused,
    Tasks,
    TaskState,
    TaskStatus,
    TaskStep,
    TraceEvent,
    TraceKind,
    Wanted,
)

_log = logging.getLogger(__name__)
_SAID: Final = ("by", "reason")
"""What a person may say who takes a robot over."""
_ASKED: Final = 20
"""So many requests of people are known who take robots over or give them back: one that is repeated is not carried out twice."""


class TaskNode:
    """Offers tasks over ROS 2. Goals are accepted between `activate` and `deactivate`.

    The mutable state is why goals are rejected, whether a client has paused all tasks or which of them, whether `deactivate` has paused
    them, and the last requests of people who take robots over or give them back. `plans` have an action server of their own, with
    this full name; `kept` are the tasks of another process, whose clients are still waiting.
    """

    def __init__(
        self, ros: RosThread, tasks: Tasks, world: ServedWorld, plans: Mapping[str, str] | None = None, kept: KeptTasks = ()
    ) -> None:
        self._ros = ros
        self._tasks = tasks
        self._world = world
        self._closed = "the node is inactive"
        self._is_paused = False
        self._paused: set[UUID] = set()
        self._is_deactivated = False
        self._hands: dict[UUID, asyncio.Task[Fields]] = {}
        self._servers = TaskServers(ros, tasks, plans or {}, lambda: self._closed, kept)
        self._planning = PlanningServer(ros, world, lambda: self._closed)
        self._topics = TaskTopics(ros, tasks, world, lambda: self._is_paused)
        self._services = RequestServices(ros)

    async def open(self) -> None:
        """Bring everything up; goals are rejected until `activate`."""
        # Topics listen first, so that subscribers can read the end of a task before its client has the result.
        await self._topics.open()
        await self._servers.open()
        await self._planning.open()
        await self._services.open(
            {
                "executor/pause": ("pnm_interfaces/srv/PauseTask", lambda request: self.pause(_id(request.task), at_once=request.at_once)),
                "executor/resume": ("pnm_interfaces/srv/ResumeTask", lambda request: self.resume(_id(request.task))),
                "executor/cancel": ("pnm_interfaces/srv/CancelTask", lambda request: self.cancel(_id(request.task))),
                "executor/hands/query": ("pnm_interfaces/srv/QueryKnowledge", self._query_hands),
                "executor/hands/update": ("pnm_interfaces/srv/UpdateKnowledge", self._update_hands),
                "executor/answer": ("pnm_interfaces/srv/UpdateKnowledge", self._answer),
                "knowledge/query": ("pnm_interfaces/srv/QueryFacts", self._query),
                "knowledge/update": ("pnm_interfaces/srv/UpdateFacts", self._update),
                "problem/get": ("pnm_interfaces/srv/GetProblem", self._get),
                "problem/save": ("pnm_interfaces/srv/SaveProblem", self._save),
                "problem/load": ("pnm_interfaces/srv/LoadProblem", lambda request: self._world.load(request.domain, request.problem)),
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

    async def take(self, name: str, /, *, reason: str = "", by: str = "") -> str:
        """Leave something to a person, also while the node is inactive."""
        return await self._tasks.take(name, reason=reason, by=by)

    async def give(self, name: str, /) -> None:
        """Use again what a person has had."""
        await self._tasks.give(name)

    # the services

    async def _query_hands(self, request: Any) -> Fields:
        hands = [asdict(hand) for hand in self._tasks.hands() if request.name in ("", hand.name)]
        return {"found": bool(hands), "value": json.dumps(hands)}

    async def _update_hands(self, request: Any) -> Fields:
        """Take or give once, however often the request arrives: its client repeats it until it is answered."""
        asked = UUID(bytes=bytes(request.goal_id.uuid))
        if not asked.int or (work := self._hands.get(asked)) is None:
            work = asyncio.ensure_future(self._put(request.name, request.value))
            self._hands = dict([*self._hands.items(), (asked, work)][-_ASKED:])
        return await asyncio.shield(work)

    async def _put(self, name: str, value: str) -> Fields:
        try:
            said = json.loads(value or "{}")
        except ValueError as error:
            raise InputError(f"value: no JSON: {error}") from error
        if said is None:
            await self.give(name)
            return {}
        if not isinstance(said, dict) or said.keys() - _SAID or not all(isinstance(text, str) for text in said.values()):
            raise InputError(f"value: expected null, or texts under {' and '.join(_SAID)}; found {value[:100]}")
        return {"message": await self.take(name, **said)}

    async def _query(self, request: Any) -> Fields:
        answers = await self._world.query(request.questions)
        return {"facts": [question for question, _ in answers], "values": [answer for _, answer in answers]}

    async def _update(self, request: Any) -> Fields:
        return {"changed": await self._world.update(request.add, request.remove, request.forget)}

    async def _answer(self, request: Any) -> None:
        if (task := _id(request.goal_id)) is None:
            raise TaskRefused("expected the id of a task as goal_id")
        self._tasks.answer_of(task, request.name, request.value)

    async def _get(self, _request: Any) -> Fields:
        domain, problem = await self._world.get()
        return {"domain": domain, "problem": problem}

    async def _save(self, request: Any) -> Fields:
        return {"path": await self._world.save(request.file)}

    def _refuse_inactive(self) -> None:
        if self._closed:
            raise TaskRefused(f"{self._closed}: all tasks are paused until it is activated")


def action_names(ros: RosThread, plans: Iterable[str]) -> tuple[tuple[str, ...], dict[str, str]]:
    """Return the full names of the actions for tasks, and of the action of each plan; only on the ROS thread.

    Raises `InputError` if the name of a plan is not valid in ROS, or is that of another action.
    """
    own = tuple(server_name(ros.node, name) for name in (*_ACTIONS, PLAN))
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


# --- tasks as goals of actions -------------------------------------------------------------
# Of the actions ``achieve_goal``, ``propose_goal`` and ``execute_plan``, and of one action for every plan that is loaded.
#
# The id of a task is that of its goal. A goal SUCCEEDED if its task ended with `Code.GOAL_REACHED`; it is CANCELED if
# cancellation was requested and its task has ended so; in all other cases it is ABORTED, and the result has the reason. A
# task goes on when the client of its goal disappears.


@dataclass(frozen=True, slots=True)
class _TaskAction:
    """An action for tasks: its type, the reader of its goals, and the writers of results and feedback."""

    type: str
    read: Callable[[UUID, Any], Wanted]
    write: Callable[[TaskEnding, float], Fields]
    feedback: Callable[[TaskStatus, Iterable[TaskStep]], Fields] = task_feedback_fields


_GOALS: Final = _TaskAction("pnm_interfaces/action/AchieveGoal", wanted_goal, goal_ending_fields)
_ACTIONS: Final = {
    "achieve_goal": _GOALS,
    PROPOSED: _GOALS,
    "execute_plan": _TaskAction("pnm_interfaces/action/ExecutePlan", wanted_plan, plan_ending_fields),
}


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
        kind, write, feedback = "pnm_interfaces/action/RunPlan", run_ending_fields, run_feedback_fields
        runs = {name: _TaskAction(kind, partial(wanted_run, plan), write, feedback) for plan, name in plans.items()}
        self._actions = _ACTIONS | runs
        self._servers = {
            name: GoalServer(ros, action.type, name, partial(self._accept, name), self._cancel) for name, action in self._actions.items()
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
        async def cancel() -> None:
            try:
                await self._tasks.cancel(goal, why="its client has cancelled it")
            except TaskRefused as refusal:
                _log.info("a goal cannot be cancelled: %s", refusal)
            except Exception:
                _log.exception("a goal cannot be cancelled")

        if goal in self._open:
            self._cancel_asked.add(goal)
            task = self._loop.create_task(cancel())
            self._work.add(task)
            task.add_done_callback(self._work.discard)

    # events of tasks

    def changed(self, task: UUID) -> None:
        """Make feedback due."""
        if task in self._open:
            self._feedback_due.add(task)
            self._feedback.note(None)

    planned = changed

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
        def fields() -> Fields:
            return self._actions[name].write(ending, clock_offset(self._ros, self._loop))

        self._servers[name].end(goal, outcome_of(ending.code), fields, is_cancel_asked=is_cancel_asked)

    def _feed(self, _: None) -> None:
        due, self._feedback_due = self._feedback_due, set()
        for status in self._tasks.status():
            if status.id in due and status.id in self._open:
                name = self._open[status.id]
                self._servers[name].feed(status.id, self._actions[name].feedback(status, self._tasks.plan(status.id)[1]))


def outcome_of(code: Code) -> OutcomeKind:
    """Return the end of a goal whose task ended with this code."""
    return {Code.GOAL_REACHED: OutcomeKind.SUCCEEDED, Code.CANCELLED: OutcomeKind.CANCELED}.get(code, OutcomeKind.ABORTED)


# --- plans without execution -----------------------------------------------------------
# The action ``plan``: answers plan requests, from the current state, without execution.

PLAN: Final = "plan"
"""The name of the action."""
SECOND: Final = 1.0
"""Seconds between two feedback messages about a search."""


class PlanningServer:
    """The action server for plan requests, which are rejected while `closed` returns a reason.

    The mutable state is the searches by goal.
    """

    def __init__(self, ros: RosThread, world: ServedWorld, closed: Callable[[], str]) -> None:
        self._world = world
        self._loop = asyncio.get_running_loop()
        self._searches: dict[UUID, asyncio.Task[MadePlan]] = {}
        self._closed = closed
        self._server = GoalServer(ros, "pnm_interfaces/action/MakePlan", PLAN, self._accept, self._cancel)

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
            self._searches[goal].cancel()

    async def _search(self, request: Any) -> MadePlan:
        try:
            goal, planner, seconds = request.goal.strip(), request.planner.strip(), read_seconds("timeout", request.timeout)
            return await self._world.make(goal, planner, seconds, with_new_plans=request.with_new_plans)
        except InputError as error:
            return MadePlan(Code.INVALID_GOAL, str(error))
        except Exception as error:
            _log.exception("a plan cannot be looked for")
            return MadePlan(Code.ERROR, f"{type(error).__name__}: {error}")

    def _end(self, goal: UUID, feeding: asyncio.Task[None], search: asyncio.Task[MadePlan]) -> None:
        feeding.cancel()
        del self._searches[goal]
        made = MadePlan(Code.CANCELLED, "the search was given up") if search.cancelled() else search.result()
        self._server.end(goal, outcome_of(made.code), lambda: made_fields(made))

    async def _feed(self, goal: UUID) -> None:
        began = self._loop.time()
        while True:
            await asyncio.sleep(SECOND)
            self._server.feed(goal, {"seconds": self._loop.time() - began})
