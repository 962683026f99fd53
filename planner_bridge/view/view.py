"""The view of a story: what is shown after its last record. A pure function, which changes nothing that can be seen."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from math import isfinite

from planner_bridge.explanations.history import Attempt, RunHistory, TaskHistory, Trouble
from planner_bridge.tasks.replanning import decision_words
from planner_bridge.view.shown import CallShown, RequestShown, RunShown, ServerShown, TaskShown, TroubleShown, View
from planner_bridge.view.story import Story
from pnm.core.execution.call_results import CallResult
from pnm.core.machine.plan_graph import ActionCall
from pnm.core.machine.requests import CallOutcome, OutcomeKind
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
        {id.hex: _task(story, task) for id, task in story.tasks.items()},
        {id.hex: _run(run) for id, run in story.runs.items()},
        {f"{call.run}/{call.index}": call for run in story.runs.values() for call in _calls(story, run)},
        {id.hex: _request(story, id.hex, attempt) for id, attempt in story.attempts.items()},
        story.facts,
        _servers(story),
        story.questions,
        {key: _trouble(story, run, key, trouble) for run in story.runs.values() for key, trouble in run.troubles.items()},
        {str(number): event for number, event in story.events.items()},
    )


def _task(story: Story, task: TaskHistory) -> TaskShown:
    wanted, used = task.accepted.wanted, task.used
    limit = used.limit if used and isfinite(used.limit) else None
    return TaskShown(
        task.name,
        task.state.word,
        _reason(task),
        wanted.priority,
        task.accepted.wall,
        None if wanted.deadline is None else task.accepted.wall + wanted.deadline,
        round(task.seconds(story.time), 6),
        limit,
        task.ending.code.word if task.ending else "",
        tuple(run.id.hex for run in task.runs),
        task.accepted.order,
        str(task.counts) if task.runs else "",
    )


def _reason(task: TaskHistory) -> str:
    """Return why a task is as it is; if nobody has said that, what it does."""
    if task.reason or task.ending:
        return task.reason
    if task.helps:
        return "a person is asked what is to be done"
    if not task.runs:
        return "it has no plan yet: a planner looks for one, or it waits for other tasks" if task.state is TaskState.PLANNING else ""
    run = task.runs[-1]
    if task.decision:  # about what follows the last run
        return decision_words(task.decision)
    if run.failures:
        failed = f"{_step(run.failures[-1])} has failed: {run.failures[-1].cause.cause}"
        return f"{failed}; what else runs comes to its end" if task.state is TaskState.RUNNING else failed
    going_on = [str(call.action) for call in run.executed().run.open_calls.values()]
    return f"{', '.join(going_on)} {'run' if len(going_on) > 1 else 'runs'}" if going_on else ""


def _run(run: RunHistory) -> RunShown:
    made, origin = run.made, run.origin
    return RunShown(made.task.hex, made.name, run.record, run.time, origin, run.is_over, run.replan)


def _calls(story: Story, run: RunHistory) -> Iterator[CallShown]:
    """Yield the calls of a run as they were reached last."""
    for index, result in run.last_results.items():
        yield story.once(f"{run.id.hex}/{index}", result, lambda result=result: _call(run, result))  # type: ignore[misc]


def _call(run: RunHistory, result: CallResult) -> CallShown:
    call, action = result.call, result.call.action
    return CallShown(
        run.id.hex,
        call.index,
        str(action),
        run.lane(action),
        result.kind.name.lower(),
        result.outcome if result.kind is not CallOutcome.ALREADY_TRUE else "not needed: its effects held",
        result.attempts,
        result.started,
        result.ended,
        call.planned,
        action.duration,
        result.assumed,
    )


def _request(story: Story, id: str, attempt: Attempt) -> RequestShown:
    def show() -> RequestShown:
        run, outcome = story.runs[attempt.sender], attempt.outcome
        return RequestShown(
            attempt.run.hex,
            attempt.call,
            str(attempt.action),
            run.lane(attempt.action),
            run.server(attempt.action),
            attempt.number,
            attempt.record,
            attempt.sent,
            attempt.accepted,
            attempt.ended,
            outcome.kind.value if outcome else "",
            outcome.message if outcome else "",
            attempt.feedback,
        )

    return story.once(id, attempt, show)


def _trouble(story: Story, run: RunHistory, key: str, trouble: Trouble) -> TroubleShown:
    def show() -> TroubleShown:
        cause, expected, observed = trouble.cause
        is_failure, time = trouble.is_failure, trouble.time
        return TroubleShown(
            run.id.hex, trouble.step.index, _step(trouble), is_failure, cause.value, expected, observed, time, trouble.followed
        )

    return story.once(key, trouble, show)


def _step(trouble: Trouble) -> str:
    return str(trouble.step.action if isinstance(trouble.step, ActionCall) else trouble.step)


def _servers(story: Story) -> dict[str, ServerShown]:
    """Return the servers that calls are bound to."""
    actions: dict[str, dict[str, None]] = {}
    busy: dict[str, list[str]] = {}
    failed = Counter[str]()
    for run in story.runs.values():
        for server, names in run.servers.items():
            actions.setdefault(server, {}).update(dict.fromkeys(names))
    for attempt in story.attempts.values():
        server = story.runs[attempt.sender].server(attempt.action)
        actions.setdefault(server, {})[attempt.action.name] = None
        if attempt.outcome is None and story.runs[attempt.run].results is None:
            busy.setdefault(server, []).append(str(attempt.action))
        failed[server] += attempt.outcome is not None and attempt.outcome.kind is not OutcomeKind.SUCCEEDED
    found = sorted(name for name in actions if name)
    return {name: ServerShown(tuple(actions[name]), tuple(busy.get(name, ())), failed[name]) for name in found}
