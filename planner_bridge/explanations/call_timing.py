"""Why a call of a run began when it did, or what it still waits for: orderings, times, resources and conditions, as its journal says."""

from __future__ import annotations

from collections.abc import Iterator

from planner_bridge.explanations.answer import Answer, Known, listed
from planner_bridge.explanations.history import JournalHistory, RunHistory, TaskHistory
from pnm.core.execution.questions import EvaluationContext
from pnm.core.logic.computed_values import Unanswered
from pnm.core.logic.conditions import All, conjuncts, evaluate, fluents, observed
from pnm.core.logic.effects import written
from pnm.core.logic.expressions import Fluent, fluent_text
from pnm.core.machine.plan_graph import ActionCall, Moment, Ordering
from pnm.core.machine.requests import CallOutcome
from pnm.errors import PnmError
from pnm.tasks import TaskState


def why_now(history: JournalHistory, task: TaskHistory, run: RunHistory, call: int) -> Answer:
    """Return why a call began when it did, or why it has not begun."""
    result, name, began = run.last_results[call], _name(run, call), history.world_began
    if result.kind is CallOutcome.ALREADY_TRUE:
        return Answer(f"{name} was not made: its effects held already", Known.JOURNAL)
    if run.source.plan.calls[call].under_way:
        return Answer(f"{name} goes on from the run before", Known.JOURNAL)
    if result.started is None:
        if run.is_over or task.ending:
            return Answer(f"{name} never began: its run was over before", Known.JOURNAL)
        reasons = tuple(_obstacles(history, task, run, call))
        if not reasons:
            return Answer(f"{name} has not begun, and the journal names nothing that holds it back", Known.JOURNAL)
        return Answer(f"{name} waits", Known.JOURNAL, reasons)
    waited = sorted(_waited(history, run, call, result.started), key=lambda wait: -wait[0])
    reasons = tuple(Answer(text, Known.JOURNAL) for _, text in waited)
    since = "it began with its run" if not waited else f"the last that it waited for was: {waited[0][1]}"
    return Answer(f"{name} began at {result.started - began:.2f} s; {since}", Known.JOURNAL, reasons[1:])


def _name(run: RunHistory, call: int) -> str:
    return f"#{call} {run.source.plan.calls[call].action}"


def _orderings(run: RunHistory, call: int) -> Iterator[Ordering]:
    """Yield the orderings that the start of a call waits for."""
    for ordering in run.source.plan.orderings:
        if ordering.after.call == call != ordering.before.call and ordering.after.moment is Moment.START:
            yield ordering


def _waited(history: JournalHistory, run: RunHistory, call: int, started: float) -> Iterator[tuple[float, str]]:
    """Yield what a call has waited for before it began, with the time at which that was over."""
    began = history.world_began
    for ordering in _orderings(run, call):
        if (time := run.time_of(ordering.before)) is not None:
            verb = "began" if ordering.before.moment is Moment.START else "ended"
            later = f", and {ordering.delay:g} s more" if ordering.delay else ""
            text = f"{_name(run, ordering.before.call)} {verb} at {time - began:.2f} s{later}{_because(run, ordering)}"
            yield time + ordering.delay, text
    planned = run.source.plan.calls[call]
    if planned.release and (origin := run.origin) is not None:
        text = f"its earliest time, {planned.release:g} s after the beginning of its plan, at {origin + planned.release - began:.2f} s"
        yield origin + planned.release, text
    names = frozenset(run.source.bindings.resources(planned.action))
    for held in history.held.values() if names else ():
        if held.until is not None and run.time <= held.until <= started and (shared := names & frozenset(held.names)):
            yield held.until, f"{held.action} gave back {listed(sorted(shared))} at {held.until - began:.2f} s"
    for trouble in (*run.hindrances, *run.failures):
        if trouble.step.index == call and trouble.time <= started:
            cause = trouble.cause
            seen = f"expected {cause.expected}; observed {cause.observed}"
            yield trouble.time, f"{cause.cause.value} at {trouble.time - began:.2f} s: {seen}"


def _obstacles(history: JournalHistory, task: TaskHistory, run: RunHistory, call: int) -> Iterator[Answer]:
    """Yield what holds a call back now."""
    replay, planned = history.execute(), run.source.plan.calls[call]
    if task.state in (TaskState.PAUSING, TaskState.PAUSED):
        yield Answer(f"its task is {task.state.word}: {task.reason}", Known.JOURNAL)
    elif run.executed().run.pausing:
        yield Answer("nothing of its plan begins while that is looked at again", Known.JOURNAL)
    for ordering in _orderings(run, call):
        if run.time_of(ordering.before) is None:
            verb = "begin" if ordering.before.moment is Moment.START else "end"
            text = f"{_name(run, ordering.before.call)} has to {verb} before{_because(run, ordering)}"
            doing = run.last_results[ordering.before.call].kind.value
            yield Answer(f"{text}; it is: {doing}", Known.JOURNAL)
    if planned.release and (origin := run.origin) is not None and origin + planned.release > history.time:
        yield Answer(f"it is not to begin before {origin + planned.release - history.world_began:.2f} s", Known.JOURNAL)
    names = frozenset(run.source.bindings.resources(planned.action))
    for claim in replay.resources.held:
        shared = names & frozenset(claim.names)
        if shared and claim.request in replay.requests:
            yield Answer(f"{replay.requests[claim.request].action} has {listed(sorted(shared))}", Known.JOURNAL)
    context = EvaluationContext(run.executed().run.knowledge, planned.action, run.source.bindings.of(planned.action.name))
    for part in conjuncts(planned.action.precondition):
        try:
            if evaluate(part, context) is not True:
                yield Answer(f"it needs {part}; observed {observed(part, context)}", Known.JOURNAL)
        except (Unanswered, PnmError):
            yield Answer(f"it needs {part}, which has to be asked for", Known.JOURNAL)


def _because(run: RunHistory, ordering: Ordering) -> str:
    """Return for which facts the order is kept."""
    steps = {step.index: step for step in run.source.plan.every_step}
    before, after = steps[ordering.before.call], steps[ordering.after.call]
    if not (isinstance(before, ActionCall) and isinstance(after, ActionCall) and ordering.protects):
        return ""
    action = before.action
    made = written((*action.start_effects, *action.end_effects), run.state)
    needed = fluents(All((after.action.precondition, after.action.invariant, after.action.end_condition)), run.state)
    links = [fluent for fluent in ordering.protects if fluent in made and fluent in needed]
    if links:
        return f", which brings about {_facts(links)}"
    return f", because both have to do with {_facts([*ordering.protects])}"


def _facts(fluents: list[Fluent]) -> str:
    return listed([fluent_text(fluent) for fluent in fluents])
