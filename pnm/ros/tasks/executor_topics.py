"""The topics of the task executor: status, plans, nets, markings, trace events, changes of knowledge; diagnostics; their messages."""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import partial
from types import SimpleNamespace
from typing import Any, Final
from uuid import UUID

from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.net.net import Marking
from pnm.core.pictures.export import as_data
from pnm.core.readiness import Readiness, ReadyState
from pnm.errors import InputError, RosError, printable
from pnm.files.yaml_nodes import parse_value
from pnm.knowledge.source import SourceError, read_value, write_value
from pnm.ros.node.ros_thread import RosThread, call_on_loop
from pnm.ros.node.services import Publisher, Throttle
from pnm.tasks import (
    Code,
    MadePlan,
    OnConflict,
    ServedWorld,
    StepState,
    TaskEnding,
    TaskListener,
    TaskOdds,
    Tasks,
    TaskState,
    TaskStatus,
    TaskStep,
    TraceEvent,
    TraceKind,
    Wanted,
)

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


# --- messages -------------------------------------------------------------------------------------
# Goals are read from messages; status, plans, nets, markings and results become fields of messages.


TRACE: Final = 200
"""Trace events in a result: the last ones."""
MAX_LENGTH: Final = 100_000
"""Characters of a goal, a plan or its parameters: it is part of every message about tasks, long after its end."""
CAUSES: Final = (None, *Cause)
"""The causes of failures by their numbers in messages."""
Fields = dict[str, object]


def result_fields(code: Code, reason: str, message: str, results: Mapping[str, object]) -> Fields:
    """Return the fields of the result of a plan; values that JSON cannot express are left out, and named in the message.

    The reason is a word for programs, as the interface lists them; the message is for people.
    """
    written: list[str] = []
    for name, value in results.items():
        try:
            written.append(f"{write_value(name)}: {write_value(value)}")
        except SourceError as error:
            message += f"; {name} is left out: {error}"
    is_reached, text = code is Code.GOAL_REACHED, f"{{{', '.join(written)}}}"
    return {"success": is_reached, "code": int(code), "reason": reason, "message": printable(message), "results": text}


def read_parameters(text: str) -> dict[str, object]:
    """Read the parameters of a plan: a mapping as YAML or JSON, or nothing; raise an `InputError` if it is no mapping, or too long."""
    text = _text("text of the parameters", text)
    try:
        parameters = read_value(text)  # JSON first: not all of it means the same in YAML, such as 1e3 and escaped emoji
    except SourceError:
        parameters = parse_value(text, "parameters") if text else {}
    if not isinstance(parameters, dict):
        raise InputError(f"expected a mapping such as {{shop: bakery}} as parameters, found {text[:40]!r}")
    return parameters


def wanted_goal(id: UUID, request: Any) -> Wanted:
    """Read a goal of ``achieve_goal``; raise an `InputError` if a field is invalid in any state of the world."""
    if request.policy not in [*OnConflict]:
        known = ", ".join(f"{policy:d} ({policy.word})" for policy in OnConflict)
        raise InputError(f"there is no policy {request.policy}; expected one of {known}")
    return Wanted(id, _text("goal", request.goal), request.priority, read_seconds("deadline", request.deadline), OnConflict(request.policy))


def wanted_plan(id: UUID, request: Any) -> Wanted:
    """Read a goal of ``execute_plan``; raise an `InputError` if it has no plan, or a field is invalid."""
    plan = _text("plan", request.plan)
    if not plan:
        raise InputError("the plan is empty; expected the name of a plan, or a plan with an action a line")
    parameters = read_parameters(request.parameters)
    deadline = read_seconds("deadline", request.deadline)
    return Wanted(id, plan, request.priority, deadline, parameters=parameters, is_plan=True)


def wanted_run(plan: str, id: UUID, request: Any) -> Wanted:
    """Read a goal of the action of a plan."""
    return Wanted(id, plan, parameters=read_parameters(request.parameters), is_plan=True)


def read_seconds(name: str, value: float) -> float | None:
    """Read a number of seconds, 0 for None; raise an `InputError` if it is negative, or no number."""
    if not 0 <= value < math.inf:
        raise InputError(f"{name} is {value:g}; expected a number of seconds, or 0 for none")
    return value or None


def _text(name: str, text: str) -> str:
    if len(text) > MAX_LENGTH:
        raise InputError(f"the {name} has {len(text)} characters; expected {MAX_LENGTH} at most")
    return text.strip()


def status_fields(status: TaskStatus) -> Fields:
    """Return the fields of a ``TaskStatus``."""
    return {
        "id": status.id,
        "goal": printable(status.goal),
        "priority": status.priority,
        "state": int(status.state),
        "code": int(status.code or 0),
        "reason": printable(status.reason),
        **_running_fields(status),
        "replans": status.replans,
        "odds": odds_fields(status.odds),
    }


def task_as_json(message: Any) -> dict[str, Any]:
    """Read a ``TaskStatus``, as programs get it."""
    return {
        "id": str(UUID(bytes=bytes(message.id.uuid))),
        "goal": message.goal,
        "priority": message.priority,
        "state": TaskState(message.state).word,
        "code": Code(message.code).word if message.state == TaskState.OVER else None,
        "reason": message.reason,
        "running": list(message.running),
        "feedback": list(message.feedback),
        "ended": message.ended,
        "replans": message.replans,
        "odds": odds.as_json() if (odds := odds_of(message.odds)) else None,
    }


def odds_of(message: Any) -> TaskOdds | None:
    """Read ``Odds``; None where they are not known."""
    return TaskOdds(message.chance, message.median, message.ninety_percent, message.rests_on) if message.chance >= 0.0 else None


def odds_fields(odds: TaskOdds | None) -> Fields:
    """Return the fields of ``Odds``."""
    if odds is None:
        return {"chance": -1.0}
    return {"chance": odds.chance, "median": odds.median, "ninety_percent": odds.ninety_percent, "rests_on": printable(odds.rests)}


def task_feedback_fields(status: TaskStatus, steps: Iterable[TaskStep]) -> Fields:
    """Return the fields of the feedback of ``achieve_goal`` and ``execute_plan``."""
    return {"status": status_fields(status), "plan": remaining(steps)}


def run_feedback_fields(status: TaskStatus, _steps: Iterable[TaskStep]) -> Fields:
    """Return the fields of the feedback of the action of a plan."""
    return {**_running_fields(status), "restarts": status.restarts}


def _running_fields(status: TaskStatus) -> Fields:
    calls, feedback = map(printable, status.running), map(printable, status.feedback)
    return {"running": [*calls], "feedback": [*feedback], "ended": status.ended}


def plan_fields(task: UUID, goal: str, number: int, steps: Iterable[TaskStep], offset: float = 0.0) -> Fields:
    """Return the fields of a ``Plan``; the offset is that from the event loop's clock to the node's."""
    step_fields = [
        {
            "action": step.action,
            "arguments": [printable(argument) for argument in step.arguments],
            "start": step.start,
            "duration": step.duration,
            "state": int(step.state),
            "after": list(step.after),
            "started": 0.0 if step.started is None else step.started + offset,
            "ended": 0.0 if step.ended is None else step.ended + offset,
            "attempts": step.attempts,
            "limit": step.limit,
            "cause": CAUSES.index(step.cause),
            "reason": step.cause or "",
        }
        for step in steps
    ]
    return {"task": task, "goal": printable(goal), "number": number, "steps": step_fields}


def remaining(steps: Iterable[TaskStep]) -> list[str]:
    """Return the calls of a plan that have not ended."""
    return [printable(str(step)) for step in steps if step.state in (StepState.WAITING, StepState.RUNNING)]


def net_fields(task: UUID, number: int, machine: PetriNetMachine) -> Fields:
    """Return the fields of a ``Net``."""
    return {"task": task, "number": number, "machine": json.dumps(as_data(machine), ensure_ascii=False)}


def marking_fields(task: UUID, number: int, marking: Marking) -> Fields:
    """Return the fields of a ``Marking``."""
    return {"task": task, "number": number, "places": list(marking), "tokens": list(marking.values())}


def moment_fields(moment: TraceEvent, offset: float) -> Fields:
    """Return the fields of a ``TraceEvent``; the offset is that from the event loop's clock to the node's."""
    return {
        "stamp": moment.time + offset,
        "task": moment.task,
        "kind": int(moment.kind),
        "word": moment.kind.word,
        "subject": printable(moment.subject),
        "text": printable(moment.text),
    }


def ending_fields(ending: TaskEnding, offset: float) -> Fields:
    """Return the fields that the results of all tasks have."""
    trace = [moment_fields(moment, offset) for moment in ending.trace[-TRACE:]]
    return {"code": int(ending.code), "reason": ending.code.word, "message": printable(ending.message), "trace": trace}


def goal_ending_fields(ending: TaskEnding, offset: float) -> Fields:
    """Return the fields of the result of ``achieve_goal``."""
    return {**ending_fields(ending, offset), "replans": ending.replans}


def plan_ending_fields(ending: TaskEnding, offset: float) -> Fields:
    """Return the fields of the result of ``execute_plan``."""
    fields = result_fields(ending.code, ending.code.word, ending.message, ending.results)
    return {**ending_fields(ending, offset), "message": fields["message"], "results": fields["results"]}


def run_ending_fields(ending: TaskEnding, _offset: float) -> Fields:
    """Return the fields of the result of the action of a plan."""
    reason = {Code.GOAL_REACHED: "goal", Code.INVALID_GOAL: "parameters"}.get(ending.code, ending.cause or ending.code.word)
    return result_fields(ending.code, reason, ending.message, ending.results)


def made_of(result: Mapping[str, Any]) -> MadePlan:
    """Read the result of ``plan``, which has no plan if the action has not been carried out; raise a `RosError` then."""
    if "plan" not in result:
        raise RosError("the node makes no plans now: it is inactive, or stands by")
    plan = result["plan"]
    steps = tuple(
        TaskStep(step["action"], tuple(step["arguments"]), step["start"], step["duration"], StepState.WAITING, tuple(step["after"]))
        for step in plan["steps"]
    )
    odds = odds_of(SimpleNamespace(**result["odds"]))
    return MadePlan(Code(result["code"]), result["message"], plan["goal"], steps, odds)


def made_fields(made: MadePlan) -> Fields:
    """Return the fields of the result of ``plan``."""
    plan, odds = plan_fields(UUID(int=0), made.goal, 0, made.steps), odds_fields(made.odds)
    return {"code": int(made.code), "reason": made.code.word, "message": printable(made.message), "plan": plan, "odds": odds}
