"""The topics of the task executor: status, plans, nets, markings, trace events, changes of knowledge; and diagnostics."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import partial
from typing import Any, Final
from uuid import UUID

from pnm.core.readiness import Readiness, ReadyState
from pnm.ros.node.publisher import Publisher, Throttle
from pnm.ros.node.ros_thread import RosThread, call_on_loop
from pnm.ros.tasks.task_messages import Fields, marking_fields, moment_fields, net_fields, plan_fields, status_fields
from pnm.tasks import Code, ServedWorld, TaskEnding, TaskListener, Tasks, TaskState, TaskStatus, TraceEvent, TraceKind

PERIOD: Final = 0.1
"""Seconds between two messages about all tasks, and between two markings of one net."""


class TaskTopics(TaskListener):
    """The topics under ``executor``, and ``knowledge/changes``.

    Nets and markings are large, so they are computed only while there are subscriptions. The mutable state is the messages
    that are due, the nets that were published, by task, and the number of knowledge changes.
    """

    def __init__(self, ros: RosThread, tasks: Tasks, world: ServedWorld, paused: Callable[[], bool]) -> None:
        def note_markings() -> None:
            for status in self._active():
                self._due_markings.note(status.id)

        self._ros = ros
        self._tasks = tasks
        self._world = world
        self._paused = paused
        self._loop = asyncio.get_running_loop()
        self._due: Throttle[Callable[[], None]] = Throttle(self._loop, PERIOD, lambda publish: publish())
        self._due_markings: Throttle[UUID] = Throttle(self._loop, PERIOD, self._publish_marking)
        self._nets: dict[UUID, tuple[int, Fields]] = {}
        self._changes = 0
        self._stops: list[Callable[[], None]] = []
        self._status = Publisher(ros, "pnm_interfaces/msg/ExecutorStatus", "executor/status", is_latched=True)
        self._plan = Publisher(ros, "pnm_interfaces/msg/Plans", "executor/plan", is_latched=True)
        self._net = Publisher(ros, "pnm_interfaces/msg/Nets", "executor/net", is_latched=True, matched=self._note_nets)
        self._marking = Publisher(ros, "pnm_interfaces/msg/Marking", "executor/marking", matched=note_markings)
        self._trace = Publisher(ros, "pnm_interfaces/msg/TraceEvent", "executor/trace")
        self._change = Publisher(ros, "pnm_interfaces/msg/KnowledgeChange", "knowledge/changes")
        self._topics = (self._status, self._plan, self._net, self._marking, self._trace, self._change)

    async def open(self) -> None:
        """Advertise the topics, and listen to tasks and knowledge."""
        for topic in self._topics:
            await topic.open()
        self._stops += [self._tasks.listen(self), self._world.follow(self._publish_changes)]
        self.note()

    async def close(self) -> None:
        """Withdraw the topics."""
        for stop in self._stops:
            stop()
        self._stops.clear()
        self._due.close()
        self._due_markings.close()
        for topic in self._topics:
            await topic.close()

    def note(self) -> None:
        """Make messages about status and plans due."""
        self._due.note(self._publish_status)
        self._due.note(self._publish_plans)

    # what happens to tasks

    def changed(self, task: UUID) -> None:
        """Make messages due; plans as well, because calls may have begun or ended."""
        self.note()

    def planned(self, task: UUID) -> None:
        """Make messages about plans and nets due."""
        self.note()
        self._note_nets()
        self._note_marking(task)

    def happened(self, moment: TraceEvent) -> None:
        """Publish a trace event; make a status message due that has the feedback."""
        if moment.kind is TraceKind.FEEDBACK and self._status.subscriptions:
            self._due.note(self._publish_status)
        if self._trace.subscriptions:
            self._trace.publish(lambda: moment_fields(moment, clock_offset(self._ros, self._loop)))

    def moved(self, task: UUID, moment: Callable[[], TraceEvent]) -> None:
        """Publish the event while somebody subscribes to events; make a message about the marking due."""
        if self._trace.subscriptions:
            self.happened(moment())
        self._note_marking(task)

    def ended(self, task: UUID, ending: TaskEnding) -> None:
        """Publish the status at once: a client that has the result of a task must not read afterwards that it is active."""
        self._due.at_once(self._publish_status)
        self._due.note(self._publish_plans)
        self._due_markings.forget(task)
        self._nets.pop(task, None)
        self._note_nets()

    # publishing

    def _note_marking(self, task: UUID) -> None:
        if self._marking.subscriptions:
            self._due_markings.note(task)

    def _note_nets(self) -> None:
        if self._net.subscriptions:
            self._due.note(self._publish_nets)

    def _active(self) -> tuple[TaskStatus, ...]:
        return tuple(status for status in self._tasks.status() if status.state is not TaskState.OVER)

    def _publish_status(self) -> None:
        tasks = [status_fields(status) for status in self._tasks.status()]
        paused = self._paused()
        self._status.publish(lambda: {"stamp": clock_offset(self._ros, self._loop) + self._loop.time(), "paused": paused, "tasks": tasks})

    def _publish_plans(self) -> None:
        plans = [(status, *self._tasks.plan(status.id)) for status in self._active()]

        def fields() -> Mapping[str, object]:
            offset = clock_offset(self._ros, self._loop)
            return {"plans": [plan_fields(status.id, status.goal, number, steps, offset) for status, number, steps in plans if steps]}

        self._plan.publish(fields)

    def _publish_nets(self) -> None:
        active = [status.id for status in self._active()]
        for task in active:
            if net := self._tasks.net(task):
                number, machine, _ = net
                if task not in self._nets or self._nets[task][0] != number:
                    self._nets[task] = number, net_fields(task, number, machine)
        self._net.publish({"nets": [self._nets[task][1] for task in active if task in self._nets]})

    def _publish_marking(self, task: UUID) -> None:
        if net := self._tasks.net(task):
            number, _, marking = net
            self._marking.publish(marking_fields(task, number, marking))

    def _publish_changes(self, changes: Mapping[str, object]) -> None:
        self._changes += 1
        fields, at = {**changes, "sequence": self._changes}, self._loop.time()
        self._change.publish(lambda: {**fields, "stamp": clock_offset(self._ros, self._loop) + at})


def clock_offset(ros: RosThread, loop: asyncio.AbstractEventLoop) -> float:
    """Return the seconds that the node's clock is ahead of the event loop's; only on the ROS thread."""
    return float(ros.node.get_clock().now().nanoseconds * 1e-9 - loop.time())


# --- the topic ``/diagnostics`` ------------------------------------------------------------
# The node, its tasks, the action servers and sensors that it needs, once a second while somebody listens.

TOPIC: Final = "/diagnostics"
DIAGNOSTICS_PERIOD: Final = 1.0
"""Seconds between two messages, in real time: a simulation that is paused is no silent node."""
_UNEVENTFUL: Final = frozenset({TaskState.QUEUED, TaskState.PLANNING, TaskState.RUNNING})


class Level(IntEnum):
    """The health of a part; the numbers are those of ``diagnostic_msgs/msg/DiagnosticStatus``."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


_LEVELS: Final = {
    ReadyState.READY: Level.OK,
    ReadyState.OPEN: Level.OK,
    ReadyState.SILENT: Level.WARN,
    ReadyState.ABSENT: Level.ERROR,
    ReadyState.SEVERAL: Level.ERROR,
    ReadyState.UNFIT: Level.ERROR,
    ReadyState.STALE: Level.STALE,
}


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """The state of one part."""

    name: str
    level: Level
    message: str
    values: Mapping[str, object] = field(default_factory=dict)


def diagnosis_of(row: Readiness) -> Diagnosis:
    """Return the state of an action server or a sensor."""
    name = f"{'sensor' if row.is_sensor else 'action'} {row.what} ({row.name})"
    there = "is heard" if row.is_sensor else "is there"
    return Diagnosis(name, _LEVELS[row.state], row.advice or there, {"state": row.state.value, "name": row.name, "type": row.type})


def diagnosis_of_tasks(tasks: Sequence[TaskStatus]) -> Diagnosis:
    """Return the state of the tasks: an error if the one that ended last has failed, a warning if one does not go on as planned."""
    going_on = [task for task in tasks if task.state is not TaskState.OVER]
    last = next((task for task in reversed(tasks) if task.state is TaskState.OVER), None)
    counts = {state: sum(task.state is state for task in going_on) for state in TaskState}
    message = ", ".join(f"{count} {state.word}" for state, count in counts.items() if count) or "no tasks"
    level = Level.OK if all(task.state in _UNEVENTFUL for task in going_on) else Level.WARN
    if last is not None and last.code not in (None, Code.GOAL_REACHED, Code.CANCELLED):
        level, message = Level.ERROR, f"{message}; the last one failed: {last.code.word}: {last.reason}"
    states = ((task, task.state.word if task.code is None else task.code.word, ", ".join(task.running) or task.reason) for task in tasks)
    said = {f"{task.id.hex[:8]} {task.goal}": f"{state}: {why}" if why else state for task, state, why in states}
    return Diagnosis("tasks", level, message, said)


class Diagnostics:
    """Publishes diagnoses of all parts, which are made only while there are subscriptions. To be used on the event loop's thread.

    The mutable state is the timer, and the diagnosis that is being made.
    Raises `InputError` if the type of the messages is not installed.
    """

    def __init__(self, ros: RosThread, diagnose: Callable[[], Awaitable[Iterable[Diagnosis]]]) -> None:
        self._ros = ros
        self._diagnose = diagnose
        self._loop = asyncio.get_running_loop()
        self._topic = Publisher(ros, "diagnostic_msgs/msg/DiagnosticArray", TOPIC)
        self._timer: Any = None
        self._work: asyncio.Task[None] | None = None

    async def open(self) -> None:
        """Advertise the topic."""

        def begin() -> None:
            if self._topic.subscriptions and (self._work is None or self._work.done()):
                self._work = self._loop.create_task(self.publish())

        await self._topic.open()
        self._timer = await self._ros.ask(lambda: self._ros.timer(DIAGNOSTICS_PERIOD, partial(call_on_loop, self._loop, begin)))

    async def close(self) -> None:
        """Withdraw the topic."""
        await self._ros.ask(self._timer.destroy)
        if self._work is not None:
            self._work.cancel()
            await asyncio.wait((self._work,))
        await self._topic.close()

    async def publish(self) -> None:
        """Publish how all parts are now."""
        diagnoses = tuple(await self._diagnose())

        def fields() -> Mapping[str, object]:
            node = self._ros.node.get_fully_qualified_name()
            status = [
                {
                    "level": int(diagnosis.level),
                    "name": f"{node.lstrip('/')}: {diagnosis.name}",
                    "message": diagnosis.message,
                    "hardware_id": node,
                    "values": [{"key": key, "value": str(value)} for key, value in diagnosis.values.items()],
                }
                for diagnosis in diagnoses
            ]
            return {"header": {"stamp": self._ros.node.get_clock().now().nanoseconds * 1e-9}, "status": status}

        self._topic.publish(fields)
