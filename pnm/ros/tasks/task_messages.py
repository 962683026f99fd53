"""Messages about tasks: goals are read from messages; status, plans, nets, markings and results become fields of messages."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from typing import Any, Final
from uuid import UUID

from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.net.net import Marking
from pnm.core.pictures.export import as_data
from pnm.errors import InputError, printable
from pnm.files.yaml_nodes import parse_value
from pnm.knowledge.source import SourceError, read_value, write_value
from pnm.tasks import Code, MadePlan, OnConflict, StepState, TaskEnding, TaskOdds, TaskStatus, TaskStep, TraceEvent, Wanted

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
    return Wanted(id, _text("goal", request.goal), request.priority, seconds("deadline", request.deadline), OnConflict(request.policy))


def wanted_plan(id: UUID, request: Any) -> Wanted:
    """Read a goal of ``execute_plan``; raise an `InputError` if it has no plan, or a field is invalid."""
    plan = _text("plan", request.plan)
    if not plan:
        raise InputError("the plan is empty; expected the name of a plan, or a plan with an action a line")
    parameters = read_parameters(request.parameters)
    deadline = seconds("deadline", request.deadline)
    return Wanted(id, plan, request.priority, deadline, parameters=parameters, is_plan=True)


def wanted_run(plan: str, id: UUID, request: Any) -> Wanted:
    """Read a goal of the action of a plan."""
    return Wanted(id, plan, parameters=read_parameters(request.parameters), is_plan=True)


def seconds(name: str, value: float) -> float | None:
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


def made_fields(made: MadePlan) -> Fields:
    """Return the fields of the result of ``plan``."""
    plan, odds = plan_fields(UUID(int=0), made.goal, 0, made.steps), odds_fields(made.odds)
    return {"code": int(made.code), "reason": made.code.word, "message": printable(made.message), "plan": plan, "odds": odds}
