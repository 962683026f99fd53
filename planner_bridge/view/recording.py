"""A journal as an MCAP file, which Foxglove and rosbag2 read: its records in words, states of tasks, and what each robot does."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import closing
from typing import Any, BinaryIO, Final, NamedTuple
from uuid import UUID

from planner_bridge.tasks.result import TASKS
from planner_bridge.view.spans import LONG, Spans
from pnm.core.execution.call_results import Sent
from pnm.core.machine.requests import Accepted, Ended, Feedback, OutcomeKind
from pnm.errors import not_installed, printable
from pnm.files.database.place import Place
from pnm.journal import records
from pnm.journal.replay import words
from pnm.journal.resume import steps_after
from pnm.journal.store import KeptJournal
from pnm.tasks import Wanted

_SHOWN: Final = 30
"""Tasks, and robots, that the layout shows at most."""
_INFO, _WARN, _ERROR = 20, 30, 40
"""Levels of `rcl_interfaces/msg/Log`."""
_LEVELS: Final = {"": _INFO, "end": _INFO, "replan": _WARN, "failure": _ERROR}
_TIME: Final = "int32 sec\nuint32 nanosec"
_TYPES: Final = {
    "log": (
        "rcl_interfaces/msg/Log",
        "builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\nstring file\nstring function\nuint32 line\n"
        f"{'=' * 80}\nMSG: builtin_interfaces/Time\n{_TIME}",
    ),
    "tasks": ("pnm_recording/msg/Task", "string id\nstring goal\nstring state\nstring reason"),
    "requests": (
        "pnm_recording/msg/Request",
        "string id\nstring task\nstring robot\nstring action\nstring server\nuint32 attempt\nstring state\nstring message",
    ),
}
"""The topics under ``/pnm``, and their types, whose definitions are in the file: nobody has to have them."""


class Message(NamedTuple):
    """A message of the recording: its topic under ``/pnm``, its time of day in seconds, and its fields."""

    topic: str
    time: float
    fields: dict[str, Any]


def record(place: Place, output: BinaryIO) -> str:
    """Write a journal as MCAP with messages of ROS 2, and return the layout of Foxglove for it, as JSON.

    Raises:
        InputError: an extra is not installed.
        PnmError: the journal cannot be read or replayed.
    """
    try:
        from mcap_ros2.writer import Writer
    except ModuleNotFoundError as error:
        raise not_installed("this", error, "telemetry") from error
    writer = Writer(output)
    types = {topic: writer.register_msgdef(*written) for topic, written in _TYPES.items()}
    tasks, robots = dict[str, None](), dict[str, None]()
    with closing(KeptJournal(place)) as kept:
        for number, message in enumerate(messages(kept)):
            nanoseconds = int(message.time * 1e9)
            writer.write_message(f"/pnm/{message.topic}", types[message.topic], message.fields, nanoseconds, nanoseconds, number)
            if message.topic == "tasks":
                tasks[message.fields["id"]] = None
            elif message.topic == "requests":
                robots[message.fields["robot"]] = None
    writer.finish()  # type: ignore[no-untyped-call]
    return json.dumps(layout([*tasks][:_SHOWN], [*robots][:_SHOWN]), indent=2) + "\n"


def messages(kept: KeptJournal) -> Iterator[Message]:
    """Yield what each record of a journal says, in the order of its records."""
    story, states, requests = Spans.of(kept, 0), dict[str, tuple[str, str]](), dict[str, tuple[str, str]]()
    for step in steps_after(kept, TASKS, story.apply, 0):
        time, marked = story.wall(story.time) or 0.0, story.events.get(step.number)
        stamp = {"sec": int(time), "nanosec": int(time % 1.0 * 1e9)}
        of = step.record.run if isinstance(step.record, records.Happened | records.RunMade) else None
        name = story.runs[of].made.name if of in story.runs else "pnm"
        text = _text("; ".join(map(str.strip, words(step, story.replay))))
        yield Message(
            "log",
            time,
            {
                "stamp": stamp,
                "level": _LEVELS[marked["mark"] if marked else ""],
                "name": _text(name),
                "msg": text,
                "file": str(kept.place),
                "function": "",
                "line": step.number,
            },
        )
        changed = _changed(step.record)
        for task in (story.tasks[id] for id in changed if id in story.tasks):
            id, state = str(task.accepted.wanted.id), (task.ending.code.word if task.ending else task.state.word, task.reason)
            if states.get(id) != state:
                states[id] = state
                yield Message("tasks", time, {"id": id, "goal": _text(task.name), "state": state[0], "reason": _text(state[1])})
        for request, attempt in ((id, story.attempts[id]) for id in changed if id in story.attempts):
            outcome, run = attempt.outcome, story.runs.get(attempt.sender)
            is_here = outcome is None or outcome.kind is not OutcomeKind.SUCCEEDED
            doing = outcome.kind.value if outcome else "accepted" if attempt.accepted is not None else "sent"
            now = (doing, outcome.message if outcome and is_here else attempt.feedback)
            if run is None or requests.get(id := str(request)) == now:
                continue
            requests[id] = now
            yield Message(
                "requests",
                time,
                {
                    "id": id,
                    "task": str(run.made.task),
                    "robot": _text(run.lane(attempt.action)),
                    "action": _text(str(attempt.action)),
                    "server": _text(run.server(attempt.action)),
                    "attempt": attempt.number,
                    "state": now[0],
                    "message": _text(now[1]),
                },
            )


def _changed(record: records.Record) -> dict[UUID, None]:
    """Return the tasks and requests that a record may change, in the order of their beginnings."""
    match record:
        case records.TaskAccepted(Wanted(id=id)) | records.TaskEntered(id) | records.TaskOver(id):
            return {id: None}
        case records.Happened(event=Accepted(id) | Feedback(id) | Ended(id), told=told):
            return dict.fromkeys((id, *(one.request for one in told if isinstance(one, Sent))))
        case records.Happened(told=told):
            return dict.fromkeys(one.request for one in told if isinstance(one, Sent))
        case _:
            return {}


def _text(text: str) -> str:
    return printable(text)[:LONG]


def layout(tasks: list[str], robots: list[str]) -> dict[str, Any]:
    """Return a layout of Foxglove: states of tasks and requests of robots above, records in words and the last request below."""

    def states(paths: list[tuple[str, str]]) -> dict[str, Any]:
        shown = [{"value": value, "label": label, "timestampMethod": "receiveTime"} for value, label in paths]
        return {"isSynced": True, "paths": shown}

    def filtered(topic: str, field: str, value: str, shown: str) -> str:
        return f"/pnm/{topic}{{{field}=={json.dumps(value, ensure_ascii=False)}}}.{shown}"

    return {
        "configById": {
            "StateTransitions!tasks": states([(filtered("tasks", "id", id, "state"), f"task {id[:8]}") for id in tasks]),
            "StateTransitions!robots": states(
                [(filtered("requests", "robot", name, shown), f"{name}: {shown}") for name in robots for shown in ("action", "state")]
            ),
            "RosOut!records": {"searchTerms": [], "minLogLevel": 1},
            "RawMessages!requests": {"topicPath": "/pnm/requests", "diffEnabled": False},
        },
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {
            "direction": "column",
            "first": {"direction": "column", "first": "StateTransitions!tasks", "second": "StateTransitions!robots", "splitPercentage": 40},
            "second": {"direction": "row", "first": "RosOut!records", "second": "RawMessages!requests", "splitPercentage": 65},
            "splitPercentage": 60,
        },
    }
