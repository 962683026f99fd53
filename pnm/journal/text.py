"""Records of a journal in words, for people."""

from __future__ import annotations

from typing import assert_never
from uuid import UUID

from pnm.core.execution.events import (
    Answered,
    Begin,
    Event,
    KnowledgeChanged,
    Pause,
    ResourcesChanged,
    Restarted,
    Resume,
    Send,
    Settled,
    SingleStep,
    Stop,
    Tick,
)
from pnm.core.knowledge_base import statement_text
from pnm.core.machine.requests import Accepted, Ended, Feedback, Postponed
from pnm.errors import counted
from pnm.journal.records import (
    EndConfirmed,
    Happened,
    KnowledgeBegan,
    KnowledgeDelta,
    RunMade,
    RunRetired,
    RunSucceeded,
    SharedBegan,
    TaskAccepted,
    TaskEntered,
    TaskHeld,
    TaskNoted,
    TaskOver,
    TimeCounted,
)
from pnm.journal.replay import Replay, ReplayStep


def words(step: ReplayStep, replay: Replay) -> tuple[str, ...]:
    """Return what a record says, a line for everything that has come of it; `replay` has replayed it just now."""
    record = step.record
    match record:
        case SharedBegan():
            return ("the world begins",)
        case KnowledgeBegan(base, facts, variables):
            return (f"knowledge of {_base(base)}: {len(facts)} facts, {len(variables)} variables",)
        case KnowledgeDelta():
            return (f"reported {delta_text(record)}",)
        case RunMade(_, _, name):
            run = replay.runs[record.run].run
            return (f"a machine for {name}: {counted(len(run.machine.plan.calls), 'call')}, {len(run.machine.net.places)} places",)
        case Happened(run_id, event):
            sent = (f"  sends {command.request.action}" for command in step.commands if isinstance(command, Send))
            return (event_text(event, replay), *(f"  fires {name}" for name in step.fired), *_changes(record), *sent)
        case RunSucceeded(run_id, successor):
            return (f"the run {run_id.hex[:8]} is succeeded by {successor.hex[:8]}",)
        case RunRetired(run_id):
            return (f"the run {run_id.hex[:8]} has ended",)
        case EndConfirmed(request):
            return (f"{request.hex[:8]} has ended at last: its resources are free",)
        case TaskAccepted(wanted):
            return (f"accepted {wanted.text or 'the goal of the problem'}",)
        case TaskHeld(task, is_held):
            return (f"{'paused' if is_held else 'resumed'} {'all' if task is None else task.hex[:8]}",)
        case TaskEntered(task, state, reason):
            return (f"{task.hex[:8]} is {state.word}{f': {reason}' if reason else ''}",)
        case TaskNoted(_, note):
            return (str(note) if type(note).__str__ is not object.__str__ else f"noted {type(note).__name__}",)
        case TimeCounted(of, used):
            return (
                f"the time of {of.hex[:8]} {'stops' if used.since is None else 'counts'}: {used.used:.2f} s of {used.limit:g} s are used",
            )
        case TaskOver(_, ending):
            return (f"over: {ending.code.word}: {ending.message}",)
        case _:
            assert_never(record)


def event_text(event: Event, replay: Replay) -> str:
    """Return an event in words; requests by the calls that they belong to."""
    match event:
        case Begin():
            return "begin"
        case Restarted():
            return "go on in another process"
        case KnowledgeChanged():
            return "facts have changed"
        case ResourcesChanged():
            return "resources have changed"
        case Tick():
            return "a time has come"
        case Stop(cancel, reason):
            return f"stop{', cancelling what runs' if cancel else ''}: {reason}"
        case Pause(at_once):
            return f"pause{' at once' if at_once else ''}"
        case Resume():
            return "resume"
        case SingleStep():
            return "step: one call may begin"
        case Settled(request, kind):
            return f"a person says how {_name(request, replay)} ends: {kind.value}"
        case Answered(_, value, message):
            return f"answer {message or repr(value)}"
        case Accepted(request):
            return f"accepted {_name(request, replay)}"
        case Postponed(request):
            return f"postponed {_name(request, replay)}"
        case Feedback(request, text):
            return f"feedback {_name(request, replay)}: {text}"
        case Ended(request, outcome):
            message = f": {outcome.message}" if outcome.message else ""
            return f"ended {_name(request, replay)}: {outcome.kind.value}{message}"
        case _:
            assert_never(event)


def delta_text(delta: KnowledgeDelta) -> str:
    """Return changes of knowledge in words."""
    facts = [statement_text(fluent, value) for fluent, value in delta.facts.items()]
    variables = [f"{name} = {value!r}" for name, value in delta.variables.items()]
    return f"{', '.join((*facts, *variables)) or 'nothing'}{f' for {_base(delta.base)}' if delta.base else ''}"


def _base(number: int) -> str:
    return f"run {number}" if number else "the world"


def _changes(record: Happened) -> tuple[str, ...]:
    return tuple(f"  writes {delta_text(delta)}" for delta in record.deltas if delta.facts or delta.variables)


def _name(request: UUID, replay: Replay) -> str:
    return str(replay.requests[request].action) if request in replay.requests else request.hex[:8]
