"""Timelines of tasks, as the history of a journal tells them."""

from __future__ import annotations

from planner_bridge.explanations.history import Attempt, JournalHistory, RunHistory, TaskHistory
from pnm.core.execution.call_results import CallResult, Failure
from pnm.core.machine.plan_graph import ActionCall
from pnm.core.machine.requests import CallOutcome
from pnm.core.pictures import timeline
from pnm.core.pictures.timeline import TimedCall, TimedPlan, Timeline
from pnm.files.database.place import Place, place_of


def timelines(journal: Place | str) -> tuple[Timeline, ...]:
    """Return the timelines of the tasks in a journal, in the order in which they were accepted.

    Raises:
        JournalError: it is no journal, or one of another version.
        ReplayDiffers: its runs do something else in this version.
        Undecodable: this version does not know what its records are made of.
    """
    history = JournalHistory.read(place_of(journal) if isinstance(journal, str) else journal)
    return tuple(_timeline(history, task) for task in history.tasks.values())


def _timeline(history: JournalHistory, task: TaskHistory) -> Timeline:
    began = min((task.time, *(run.time for run in task.runs)))
    words = f"{task.ending.code.word}: {task.ending.message}" if task.ending else ""
    end = history.time if task.ended is None else task.ended
    return Timeline(task.name, tuple(_plan(history, run, began) for run in task.runs), end - began, words)


def _plan(history: JournalHistory, run: RunHistory, began: float) -> TimedPlan:
    """Return the plan of a run in a task that has begun then."""
    results, origin = run.last_results, (run.time if run.origin is None else run.origin) - began
    calls = tuple(_call(history, run, call, results[call.index], origin, began) for call in run.source.plan.calls)
    failures = tuple(str(Failure(trouble.step, *trouble.cause)) for trouble in run.failures)
    return TimedPlan(run.time - began, calls, run.replan, failures)


def _call(history: JournalHistory, run: RunHistory, call: ActionCall, became: CallResult, origin: float, began: float) -> TimedCall:
    attempts = tuple(_attempt(attempt, began) for attempt in history.sent(run, call.index))
    name, lane, planned = str(became.call.action), run.lane(call.action), origin + call.planned
    has_failed, lasts = became.kind is CallOutcome.FAILED, call.action.duration
    return TimedCall(call.index, name, lane, planned, lasts, attempts, became.outcome, became.is_done, has_failed)


def _attempt(attempt: Attempt, began: float) -> timeline.TimedAttempt:
    if attempt.ended is None or attempt.outcome is None:
        return timeline.TimedAttempt(attempt.sent - began)
    return timeline.TimedAttempt(attempt.sent - began, attempt.ended - began, attempt.outcome.kind, attempt.outcome.message)
