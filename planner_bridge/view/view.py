"""The view of a story: what is shown after its last record. A pure function, which changes nothing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from math import isfinite

from planner_bridge.tasks.replanning import decision_words
from planner_bridge.view.shown import CallShown, RunShown, ServerShown, TaskShown, View
from planner_bridge.view.story import RunStory, Story, TaskStory
from pnm.core.execution.call_results import CallResult
from pnm.core.machine.machine import CallOutcome
from pnm.core.machine.requests import OutcomeKind
from pnm.tasks import TaskState


def view_of(story: Story) -> View:
    """Return what is shown of a story; the same story gives the same view."""
    return View(
        story.number,
        story.time,
        story.began,
        story.first,
        "",
        story.clock,
        {id.hex: _task(task, story.time) for id, task in story.tasks.items()},
        {id.hex: _run(run) for id, run in story.runs.items()},
        {f"{call.run}/{call.index}": call for run in story.runs.values() for call in _calls(run)},
        {id: request for run in story.runs.values() for id, request in run.requests.items()},
        story.facts,
        _servers(story),
        dict(story.questions),
        {key: trouble for run in story.runs.values() for key, trouble in run.troubles.items()},
        {str(number): event for number, event in story.events.items()},
    )


def _task(task: TaskStory, now: float) -> TaskShown:
    wanted, state = task.accepted.wanted, _state(task)
    limit = task.used.limit if task.used and isfinite(task.used.limit) else None
    return TaskShown(
        wanted.text or "the goal of the problem",
        state.word,
        _reason(task, state),
        wanted.priority,
        task.accepted.wall,
        None if wanted.deadline is None else task.accepted.wall + wanted.deadline,
        round(task.used.until(now if task.ended is None else task.ended), 6) if task.used else 0.0,
        limit,
        task.ending.code.word if task.ending else "",
        tuple(run.replayed.run.id.hex for run in task.runs),
        task.accepted.order,
    )


def _state(task: TaskStory) -> TaskState:
    """Return how a task is doing, as far as the journal says: it does not say when a planner is asked."""
    last = task.runs[-1].replayed.run if task.runs else None
    run = None if last is None or task.runs[-1].is_over else last
    if task.ending:
        return TaskState.OVER
    if task.is_held or (run and run.pausing):
        return TaskState.PAUSING if run and not run.paused else TaskState.PAUSED
    if (run and run.begun) or (last and last.over and last.result().goal):  # with its goal there is nothing to plan again
        return TaskState.RUNNING
    if task.runs:
        return TaskState.REPLANNING
    return TaskState.PLANNING if task.used and task.used.since is not None else TaskState.QUEUED


def _reason(task: TaskStory, state: TaskState) -> str:
    """Return why a task is as it is."""
    if task.ending:
        return task.ending.message
    if task.helps:
        return "a person is asked what is to be done"
    if not task.runs:
        return "it has no plan yet: a planner looks for one, or it waits for other tasks" if state is TaskState.PLANNING else ""
    run = task.runs[-1]
    if state is TaskState.REPLANNING and task.decision:
        return decision_words(task.decision)
    failures = [trouble for trouble in run.troubles.values() if trouble.is_failure]
    if failures:
        failed = f"{failures[-1].step} has failed: {failures[-1].cause}"
        return f"{failed}; what else runs comes to its end" if state is TaskState.RUNNING else failed
    going_on = [str(call.action) for call in run.replayed.run.open_calls.values()]
    return f"{', '.join(going_on)} {'run' if len(going_on) > 1 else 'runs'}" if going_on else ""


def _run(story: RunStory) -> RunShown:
    made, run = story.replayed.made, story.replayed.run
    return RunShown(made.task.hex, made.name, story.record, story.time, run.origin, story.is_over, story.cut)


def _calls(story: RunStory) -> Iterator[CallShown]:
    """Yield the calls of a run as they were reached last."""
    for index, result in {**story.unreached, **{result.call.index: result for result in story.results}}.items():
        if (known := story.shown.get(index)) is None or known[0] is not result:
            known = story.shown[index] = result, _call(story, result)
        yield known[1]


def _call(story: RunStory, result: CallResult) -> CallShown:
    call, action = result.call, result.call.action
    return CallShown(
        story.replayed.run.id.hex,
        call.index,
        str(action),
        story.lane(action),
        result.kind.name.lower(),
        result.outcome if result.kind is not CallOutcome.ALREADY_TRUE else "not needed: its effects held",
        result.attempts,
        result.started,
        result.ended,
        call.planned,
        action.duration,
        result.assumed,
    )


def _servers(story: Story) -> dict[str, ServerShown]:
    """Return the servers that calls are bound to."""
    actions: dict[str, dict[str, None]] = {}
    busy: dict[str, list[str]] = {}
    failed = Counter[str]()
    for run in story.runs.values():
        for server, names in run.servers.items():
            actions.setdefault(server, {}).update(dict.fromkeys(names))
        for request in run.requests.values():
            actions.setdefault(request.server, {})[request.action.partition("(")[0]] = None
            if not request.outcome and not run.replayed.is_over:
                busy.setdefault(request.server, []).append(request.action)
            failed[request.server] += request.outcome not in ("", OutcomeKind.SUCCEEDED.value)
    found = sorted(name for name in actions if name)
    return {name: ServerShown(tuple(actions[name]), tuple(busy.get(name, ())), failed[name]) for name in found}
