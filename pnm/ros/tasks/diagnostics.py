"""The topic ``/diagnostics``: the node, its tasks, the action servers and sensors that it needs, once a second while somebody listens."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import partial
from typing import Any, Final

from pnm.core.readiness import Readiness, ReadyState
from pnm.ros.node.publisher import Publisher
from pnm.ros.node.ros_thread import RosThread, call_on_loop
from pnm.tasks import Code, TaskState, TaskStatus

TOPIC: Final = "/diagnostics"
PERIOD: Final = 1.0
"""Seconds between two messages, in real time: a simulation that is paused is no silent node."""
_UNEVENTFUL: Final = frozenset({TaskState.QUEUED, TaskState.PLANNING, TaskState.RUNNING})


class Level(IntEnum):
    """How well a part is; the numbers are those of ``diagnostic_msgs/msg/DiagnosticStatus``."""

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
    """How one part is."""

    name: str
    level: Level
    message: str
    values: Mapping[str, object] = field(default_factory=dict)


def diagnosis_of(row: Readiness) -> Diagnosis:
    """Return how an action server or a sensor is."""
    name = f"{'sensor' if row.is_sensor else 'action'} {row.what} ({row.name})"
    there = "is heard" if row.is_sensor else "is there"
    return Diagnosis(name, _LEVELS[row.state], row.advice or there, {"state": row.state.value, "name": row.name, "type": row.type})


def diagnosis_of_tasks(tasks: Sequence[TaskStatus]) -> Diagnosis:
    """Return how the tasks are: an error if the one that ended last has failed, a warning if one does not go on as planned."""
    going_on = [task for task in tasks if task.state is not TaskState.OVER]
    last = next((task for task in reversed(tasks) if task.state is TaskState.OVER), None)
    counts = {state: sum(task.state is state for task in going_on) for state in TaskState}
    message = ", ".join(f"{count} {state.word}" for state, count in counts.items() if count) or "no tasks"
    level = Level.OK if all(task.state in _UNEVENTFUL for task in going_on) else Level.WARN
    if last is not None and last.code not in (None, Code.GOAL_REACHED, Code.CANCELLED):
        level, message = Level.ERROR, f"{message}; the last one failed: {last.code.word}: {last.reason}"
    return Diagnosis("tasks", level, message, {f"{task.id.hex[:8]} {task.goal}": said_of(task) for task in tasks})


def said_of(task: TaskStatus) -> str:
    """Return the state of a task, with what it does or why it is so."""
    state = task.code.word if task.code is not None else task.state.word
    return ": ".join(filter(None, (state, ", ".join(task.running) or task.reason)))


class Diagnostics:
    """Publishes diagnoses, which are made only while there are subscriptions. To be used on the event loop's thread.

    The mutable state is the timer, and the diagnosis that is being made.

    Args:
        diagnose: how all parts are.

    Raises:
        InputError: the type of the messages is not installed.
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
        await self._topic.open()
        self._timer = await self._ros.ask(lambda: self._ros.timer(PERIOD, partial(call_on_loop, self._loop, self._begin)))

    async def close(self) -> None:
        """Withdraw the topic."""
        await self._ros.ask(self._timer.destroy)
        if self._work is not None:
            self._work.cancel()
            await asyncio.wait((self._work,))
        await self._topic.close()

    def _begin(self) -> None:
        if self._topic.subscriptions and (self._work is None or self._work.done()):
            self._work = self._loop.create_task(self.publish())

    async def publish(self) -> None:
        """Publish how all parts are now."""
        diagnoses, node = tuple(await self._diagnose()), self._ros.node
        self._topic.publish(lambda: array_fields(diagnoses, node.get_fully_qualified_name(), node.get_clock().now().nanoseconds * 1e-9))


def array_fields(diagnoses: Iterable[Diagnosis], node: str, now: float) -> dict[str, object]:
    """Return the fields of a ``DiagnosticArray``."""
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
    return {"header": {"stamp": now}, "status": status}
