"""Goals for tasks, and what is told about tasks: messages to data and data to the fields of messages.

A goal for a plan: what comes in with it, and what goes out at its end.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final
from uuid import UUID

from pnm.core.machine.export import as_data
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.net.net import Marking
from pnm.errors import InputError
from pnm.files.yaml_nodes import parse_value
from pnm.knowledge.sources.memory import read_value, write_value
from pnm.knowledge.sources.person_text import printable
from pnm.knowledge.sources.source import SourceError
from pnm.ros.knowledge.knowledge_source import uuid_field
from pnm.tasks import Code, MadePlan, OnConflict, StepState, TaskEnding, TaskStatus, TaskStep, TraceEvent, Wanted


@dataclass(frozen=True, slots=True)
class Ending:
    """How a goal ended: the fields of its result."""

    success: bool
    reason: str
    """A word for programs, as the interface lists them."""
    message: str
    results: Mapping[str, object] = field(default_factory=dict)

    def fields(self) -> dict[str, object]:
        """Return the fields of the result as a message has them; values that JSON cannot say are told of in its message."""
        written: dict[str, str] = {}
        unsaid = ""
        for name, value in self.results.items():
            try:
                written[name] = f"{write_value(name)}: {write_value(value)}"
            except SourceError as error:
                unsaid += f"; {name} is left out: {error}"
        results = f"{{{', '.join(written.values())}}}"
        return {"success": self.success, "reason": self.reason, "message": printable(self.message + unsaid), "results": results}


def read_parameters(text: str) -> dict[str, object]:
    """Read what a goal says about the parameters of its plan: a mapping as YAML or JSON, or nothing.

    Raises:
        InputError: it is something else.
    """
    try:
        found = read_value(text)  # JSON first: not all of it means the same in YAML, such as 1e3 and escaped emoji
    except SourceError:
        found = parse_value(text, "parameters") if text.strip() else {}
    if not isinstance(found, dict):
        raise InputError(f"expected a mapping such as {{shop: bakery}} as parameters, found {text.strip()[:40]!r}")
    return found


TRACE: Final = 200
"""So many events at most stand in a result: the last ones."""
MAX_LENGTH: Final = 100_000
"""So many characters at most has what is wanted: it stands in every message about tasks, long after its end."""
_POLICIES: Final = (None, OnConflict.PLAN_AROUND, OnConflict.QUEUE, OnConflict.REFUSE)
"""What the numbers in goals mean."""

Fields = dict[str, object]


def wanted_goal(id: UUID, request: Any) -> Wanted:
    """Read a goal of ``achieve_goal``.

    Raises:
        InputError: what it says is no goal, whatever is known of the world.
    """
    if request.policy >= len(_POLICIES):
        known = "0 (default), 1 (plan around), 2 (queue), 3 (refuse)"
        raise InputError(f"there is no policy {request.policy}; expected one of {known}")
    return Wanted(id, _text("goal", request.goal), request.priority, seconds("deadline", request.deadline), _POLICIES[request.policy])


def wanted_plan(id: UUID, request: Any) -> Wanted:
    """Read a goal of ``execute_plan``.

    Raises:
        InputError: it has no plan, or its parameters are none.
    """
    plan = _text("plan", request.plan)
    if not plan:
        raise InputError("the plan is empty; expected the name of a plan, or a plan with an action a line")
    parameters = read_parameters(request.parameters)
    deadline = seconds("deadline", request.deadline)
    return Wanted(id, plan, request.priority, deadline, parameters=parameters, is_plan=True)


def wanted_run(plan: str, id: UUID, request: Any) -> Wanted:
    """Read a goal of the action of a plan.

    Raises:
        InputError: its parameters are none.
    """
    return Wanted(id, plan, parameters=read_parameters(request.parameters), is_plan=True)


def seconds(name: str, value: float) -> float | None:
    """Read a number of seconds, of which 0 means none.

    Raises:
        InputError: it is negative, or no number.
    """
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
        "id": uuid_field(status.id),
        "goal": printable(status.goal),
        "priority": status.priority,
        "state": int(status.state),
        "reason": printable(status.reason),
        "running": [printable(call) for call in status.running],
        "ended": status.ended,
        "replans": status.replans,
    }


def task_feedback_fields(status: TaskStatus, steps: Iterable[TaskStep]) -> Fields:
    """Return the fields of the feedback of ``achieve_goal`` and ``execute_plan``."""
    return {"status": status_fields(status), "plan": rest(steps)}


def run_feedback_fields(status: TaskStatus, _steps: Iterable[TaskStep]) -> Fields:
    """Return the fields of the feedback of the action of a plan."""
    return {"running": [printable(call) for call in status.running], "ended": status.ended, "restarts": status.restarts}


def plan_fields(task: UUID, goal: str, number: int, steps: Iterable[TaskStep]) -> Fields:
    """Return the fields of a ``Plan``."""
    return {"task": uuid_field(task), "goal": printable(goal), "number": number, "steps": [_step_fields(step) for step in steps]}


def _step_fields(step: TaskStep) -> Fields:
    return {
        "action": step.action,
        "arguments": [printable(argument) for argument in step.arguments],
        "start": step.start,
        "duration": step.duration,
        "state": int(step.state),
        "after": list(step.after),
    }


def rest(steps: Iterable[TaskStep]) -> list[str]:
    """Return what a plan still has to do."""
    return [printable(str(step)) for step in steps if step.state in (StepState.WAITING, StepState.RUNNING)]


def net_fields(task: UUID, number: int, machine: PetriNetMachine) -> Fields:
    """Return the fields of a ``Net``."""
    return {"task": uuid_field(task), "number": number, "machine": json.dumps(as_data(machine), ensure_ascii=False)}


def marking_fields(task: UUID, number: int, marking: Marking) -> Fields:
    """Return the fields of a ``Marking``."""
    return {"task": uuid_field(task), "number": number, "places": list(marking), "tokens": list(marking.values())}


def moment_fields(moment: TraceEvent, offset: float) -> Fields:
    """Return the fields of a ``TraceEvent``; the offset is what the clock of the node is ahead of that of the event loop."""
    return {
        "stamp": moment.time + offset,
        "task": uuid_field(moment.task),
        "kind": moment.kind,
        "subject": printable(moment.subject),
        "text": printable(moment.text),
    }


def ending_fields(ending: TaskEnding, offset: float) -> Fields:
    """Return the fields that the results of all tasks have."""
    told = [moment_fields(moment, offset) for moment in ending.trace[-TRACE:]]
    return {"code": int(ending.code), "reason": ending.code.word, "message": printable(ending.message), "trace": told}


def goal_ending_fields(ending: TaskEnding, offset: float) -> Fields:
    """Return the fields of the result of ``achieve_goal``."""
    return {**ending_fields(ending, offset), "replans": ending.replans}


def plan_ending_fields(ending: TaskEnding, offset: float) -> Fields:
    """Return the fields of the result of ``execute_plan``."""
    said = Ending(ending.code is Code.GOAL_REACHED, ending.code.word, ending.message, ending.results).fields()
    return {**ending_fields(ending, offset), "message": said["message"], "results": said["results"]}


def run_ending_fields(ending: TaskEnding, _offset: float) -> Fields:
    """Return the fields of the result of the action of a plan."""
    reason = {Code.GOAL_REACHED: "goal", Code.INVALID_GOAL: "parameters"}.get(ending.code, ending.cause or ending.code.word)
    return Ending(ending.code is Code.GOAL_REACHED, reason, ending.message, ending.results).fields()


def made_fields(made: MadePlan) -> Fields:
    """Return the fields of the result of ``plan``."""
    plan = plan_fields(UUID(int=0), made.goal, 0, made.steps)
    return {"code": int(made.code), "reason": made.code.word, "message": printable(made.message), "plan": plan}
