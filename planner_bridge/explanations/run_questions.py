"""Questions about a run, answered from its journal: which function answers which one, for a task and a call of it."""

from __future__ import annotations

from typing import Final
from uuid import UUID

from planner_bridge.explanations.answer import Answer, Known, listed
from planner_bridge.explanations.call_timing import why_now
from planner_bridge.explanations.history import JournalHistory, RunHistory, TaskHistory
from planner_bridge.explanations.needed_call import Course, why_call
from planner_bridge.explanations.new_plan import not_told, why_failed, why_replanned
from planner_bridge.model.progression import Happening
from pnm.core.execution.call_results import CallResult
from pnm.core.logic.computed_values import Unanswered
from pnm.core.machine.plan_graph import ActionCall, Moment
from pnm.core.machine.requests import CallOutcome
from pnm.errors import InputError, counted, suggestion
from pnm.files.database.place import Place

_BEGINNING: Final = 4
"""Characters of an id that are enough to mean its task; fewer are a number, or a mistake."""


def task_meant(history: JournalHistory, text: str | None) -> TaskHistory:
    """Return the task that is meant by its number in the journal, or by the beginning of its id; without one, the last that goes on."""
    tasks = [*history.tasks.values()]
    if not tasks:
        raise InputError("the journal has no task")
    if text is None:
        return next((task for task in reversed(tasks) if task.ending is None), tasks[-1])
    if text.isdecimal() and 1 <= int(text) <= len(tasks):
        return tasks[int(text) - 1]
    beginning = text.replace("-", "").lower()
    meant = [task for task in tasks if len(beginning) >= _BEGINNING and task.accepted.wanted.id.hex.startswith(beginning)]
    if len(meant) != 1:
        known = listed([f"{number} ({task.accepted.wanted.id.hex[:8]})" for number, task in enumerate(tasks, 1)], most=8)
        raise InputError(f"{'no task' if not meant else 'more than one task'} is called {text!r}; expected one of {known}")
    return meant[0]


def call_meant(task: TaskHistory, text: str) -> tuple[RunHistory, int]:
    """Return the call that is meant by its number in the last run of a task, or by its name: then also in an earlier one."""
    if not task.runs:
        raise InputError(f"{task.name} has no plan yet" if task.is_told else not_told(task).statement)
    if text.strip("# ").isdecimal():
        number, calls = int(text.strip("# ")), task.runs[-1].source.plan.calls
        if number >= len(calls):
            raise InputError(f"there is no call {number}: the last run has {counted(len(calls), 'call')}; expected a number from 0")
        return task.runs[-1], number
    wanted = "".join(text.split())
    for run in reversed(task.runs):
        for call in run.source.plan.calls:
            if "".join(str(call.action).split()) == wanted:
                return run, call.index
    known = list(dict.fromkeys(str(call.action) for run in reversed(task.runs) for call in run.source.plan.calls))
    hint = suggestion(text, known) or f"expected one of {listed(known, most=8)}"
    raise InputError(f"no plan of {task.name} has {text}; {hint}")


def why_call_of_run(history: JournalHistory, task: TaskHistory, run: RunHistory, call: int) -> tuple[Answer, ...]:
    """Return why a call is in its plan, why it began when it did or what it waits for, and why it failed if it has."""
    if task.accepted.wanted.is_plan or not all(isinstance(step, ActionCall) for step in run.source.plan.steps):
        needed = Answer("the plan was written by a person: what each call is for, it does not say", Known.GIVEN)
    else:
        try:
            needed = why_call(_course(run), call)
        except Unanswered:
            needed = Answer("what needs it depends on questions that were asked while it ran", Known.NOT_PROVED)
    failed = (answer for trouble, answer in zip(run.failures, why_failed(history, run), strict=True) if trouble.step.index == call)
    return needed, why_now(history, task, run, call), *failed


def _course(run: RunHistory) -> Course:
    """Return the course of the plan of a run from the state it began in."""
    plan = run.source.plan
    begun = frozenset(call.index for call in plan.calls if call.under_way)
    events = [event for event in plan.order if event.call not in begun or event.moment is Moment.END]
    course = [Happening(float(number), (), (event,)) for number, event in enumerate(events)]
    return Course(plan.calls, course, run.state, plan.goal, begun)


def explained(place: Place, task: UUID, call: tuple[UUID, int] | None = None, last: int | None = None) -> tuple[Answer, ...]:
    """Read a journal, and return why a task, or one of its calls, is as it is: for who knows them by their ids, as a page does.

    Args:
        place: of the journal.
        task: which one.
        call: its run and its number, from 0; None for the task as a whole.
        last: the record up to which the journal is read; None for all that there is.
    """
    history = JournalHistory.read(place, last)
    if task not in history.tasks:
        raise InputError(f"the journal knows no task {task}")
    meant = history.tasks[task]
    if call is None:
        return why_so(history, meant)
    run = next((run for run in meant.runs if run.id == call[0]), None)
    if run is None or not 0 <= call[1] < len(run.source.plan.calls):
        raise InputError(f"the task has no call {call[1]} in a run {call[0]}")
    return why_call_of_run(history, meant, run, call[1])


def why_so(history: JournalHistory, task: TaskHistory) -> tuple[Answer, ...]:
    """Return how a task is doing and why: how it has ended, or what runs and what waits for what; and its new plans."""
    replans = why_replanned(history, task) if len(task.own_runs) > 1 else ()
    if task.ending is not None:
        ended = Answer(f"{task.name} is over: {task.ending.code.word}: {task.ending.message}", Known.JOURNAL)
        last = tuple(why_failed(history, task.runs[-1])) if task.runs else () if task.is_told else (not_told(task),)
        return ended, *last, *replans
    if not task.runs:
        return (Answer(f"{task.name} has no plan yet", Known.JOURNAL),)
    run = task.runs[-1]
    results = run.last_results
    calls = tuple(_doing(history, task, run, results[call.index]) for call in run.source.plan.calls if not results[call.index].is_done)
    done = sum(result.is_done for result in results.values())
    text = f"{task.name}: {done} of {counted(len(run.source.plan.calls), 'call')} of its plan {'is' if done == 1 else 'are'} done"
    return Answer(text, Known.JOURNAL, calls), *why_failed(history, run), *replans


def _doing(history: JournalHistory, task: TaskHistory, run: RunHistory, result: CallResult) -> Answer:
    """Return what a call that is not done is doing."""
    call = result.call.index
    if result.kind is CallOutcome.WAITING:
        return why_now(history, task, run, call)
    return Answer(f"#{call} {run.source.plan.calls[call].action}: {result.outcome}", Known.JOURNAL)
