"""Questions about a run, answered from its journal: for a task and a call of it.

Why a call is in its plan, began when it did or waits; why there was a new plan; how a task is doing.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Final
from uuid import UUID

from planner_bridge.explanations.answer import Answer, Known
from planner_bridge.explanations.history import JournalHistory, RunHistory, TaskHistory, Trouble
from planner_bridge.explanations.needed_call import Course, why_call
from planner_bridge.model.progression import Happening
from pnm.core.execution.questions import EvaluationContext
from pnm.core.logic.computed_values import Unanswered
from pnm.core.logic.conditions import TRUE, All, conjuncts, evaluate, fluents, observed
from pnm.core.logic.effects import written
from pnm.core.logic.expressions import Fluent, fluent_text
from pnm.core.machine.plan_graph import ActionCall, Moment, Ordering, step_words
from pnm.core.machine.requests import CallOutcome
from pnm.core.pictures.timeline import Replan
from pnm.errors import InputError, PnmError, counted, listed, suggestion
from pnm.files.database.place import Place
from pnm.tasks import TaskState

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
    plan = run.source.plan
    if task.accepted.wanted.is_plan or not all(isinstance(step, ActionCall) for step in plan.steps):
        needed = Answer("the plan was written by a person: it does not say the purpose of its calls", Known.GIVEN)
    elif (ways := plan.calls[call].action.outcomes) and plan.goal == TRUE:
        chances = run.policy.chances(plan.calls[call].action) if run.policy else {}
        names = listed([f"{way.name} ({chances[way.name]:.0%})" if way.name in chances else way.name for way in ways], most=_SHOWN)
        needed = Answer(f"what follows {_name(run, call)} goes by its outcome, which may be {names}", Known.GIVEN)
    else:
        begun = frozenset(call.index for call in plan.calls if call.under_way)
        events = [event for event in plan.order if event.call not in begun or event.moment is Moment.END]
        course = [Happening(float(number), (), (event,)) for number, event in enumerate(events)]
        try:
            needed = why_call(Course(plan.calls, course, run.state, plan.goal, begun), call)
        except Unanswered:
            needed = Answer("its purpose depends on questions that were asked while it ran", Known.NOT_PROVED)
    failed = (answer for trouble, answer in zip(run.failures, why_failed(history, run), strict=True) if trouble.step.index == call)
    return needed, why_now(history, task, run, call), *failed


def explained(place: Place, run: UUID, call: int, last: int) -> tuple[Answer, ...]:
    """Read a journal up to a record, and return why a call of a run is as it is: for who knows them by their ids, as a page does."""
    history = JournalHistory.read(place, last)
    meant = history.runs.get(run)
    if meant is None or meant.made.task not in history.tasks or call >= len(meant.source.plan.calls):
        raise InputError(f"the journal has no call {call} of a run {run}")
    return why_call_of_run(history, history.tasks[meant.made.task], meant, call)


def explained_task(
    place: Place, task: str | None, call: str | None = None, last: int | None = None, *, replan: bool = False
) -> tuple[Answer, ...]:
    """Read a journal, up to a record if one is named, and return how a task is doing; or about a call of it, or about its new plans."""
    history = JournalHistory.read(place, last)
    meant = task_meant(history, task)
    if replan:
        return why_replanned(history, meant)
    return why_so(history, meant) if call is None else why_call_of_run(history, meant, *call_meant(meant, call))


def why_so(history: JournalHistory, task: TaskHistory) -> tuple[Answer, ...]:
    """Return the state of a task and its reasons: its end, or its running and waiting calls; and its new plans."""
    replans = why_replanned(history, task) if len(task.own_runs) > 1 else ()
    if task.ending is not None:
        ended = Answer(f"{task.name} is over: {task.ending.code.word}: {task.ending.message}", Known.JOURNAL)
        last = tuple(why_failed(history, task.runs[-1])) if task.runs else () if task.is_told else (not_told(task),)
        return ended, *last, *replans
    if not task.runs:
        return (Answer(f"{task.name} has no plan yet", Known.JOURNAL),)
    run = task.runs[-1]
    results = run.last_results
    calls = tuple(
        why_now(history, task, run, call)
        if result.kind is CallOutcome.WAITING
        else Answer(f"{_name(run, call)}: {result.outcome}", Known.JOURNAL)
        for call, result in results.items()
        if not result.is_done
    )
    done = sum(result.is_done for result in results.values())
    text = f"{task.name}: {done} of {counted(len(run.source.plan.calls), 'call')} of its plan {'is' if done == 1 else 'are'} done"
    return Answer(text, Known.JOURNAL, calls), *why_failed(history, run), *replans


# --- when a call begins ---------------------------------------------------------------------------
# Why a call of a run began when it did, or what it still waits for: orderings, times, resources and conditions, as its journal says.


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
    came = f"; it has come to its outcome {result.declared}" if result.declared else ""
    return Answer(f"{name} began at {result.started - began:.2f} s; {since}{came}", Known.JOURNAL, reasons[1:])


def _name(run: RunHistory, call: int) -> str:
    return f"#{call} {run.source.plan.calls[call].action}"


def _orderings(run: RunHistory, call: int) -> Iterator[Ordering]:
    """Yield the orderings that the start of a call waits for."""
    for ordering in run.source.plan.orderings:
        if ordering.after.call == call != ordering.before.call and ordering.after.moment is Moment.START:
            yield ordering


def _waited(history: JournalHistory, run: RunHistory, call: int, started: float) -> Iterator[tuple[float, str]]:
    """Yield everything that a call has waited for before it began, with the time of its end."""
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
    replay, planned = history.replay, run.source.plan.calls[call]
    if task.state in (TaskState.PAUSING, TaskState.PAUSED):
        yield Answer(f"its task is {task.state.word}: {task.reason}", Known.JOURNAL)
    elif run.executed().run.pausing:
        yield Answer("nothing begins while its plan is checked again", Known.JOURNAL)
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
    before, after = run.steps[ordering.before.call], run.steps[ordering.after.call]
    if not (isinstance(before, ActionCall) and isinstance(after, ActionCall) and ordering.protects):
        return ""
    action = before.action
    made = written((*action.start_effects, *action.possible_effects), run.state)
    needed = fluents(All((after.action.precondition, after.action.invariant, after.action.end_condition)), run.state)
    links = [fluent for fluent in ordering.protects if fluent in made and fluent in needed]
    if links:
        return f", which brings about {_facts(links)}"
    return f", because both have to do with {_facts([*ordering.protects])}"


def _facts(fluents: list[Fluent]) -> str:
    return listed([fluent_text(fluent) for fluent in fluents])


# --- new plans ------------------------------------------------------------------------------------
# Why a task was planned anew: what failed, with what was expected and observed, and what the next plan keeps, drops and adds.


_SHOWN = 6


def why_replanned(history: JournalHistory, task: TaskHistory) -> tuple[Answer, ...]:
    """Return for each run of a task after the first why it followed the one before."""
    answers = []
    for number, (before, after) in enumerate(pairwise(task.own_runs), 2):
        replan, reasons = after.replan or Replan(""), [*why_failed(history, before)]
        for verb, calls in (("keeps", replan.kept), ("drops", replan.dropped), ("adds", replan.added)):
            if calls:
                reasons.append(Answer(f"the plan that followed {verb} {listed([*calls], most=_SHOWN)}", Known.JOURNAL))
        text = f"run {number} began at {after.time - history.world_began:.2f} s: {replan.why}"
        answers.append(Answer(text, Known.JOURNAL, tuple(reasons)))
    if answers:
        return tuple(answers)
    return (Answer(f"there was no new plan for {task.name}", Known.JOURNAL) if task.is_told else not_told(task),)


def not_told(task: TaskHistory) -> Answer:
    """Return the words for a task whose records are dropped."""
    return Answer(f"how {task.name} went is not known: its records are not kept any more", Known.JOURNAL)


def why_failed(history: JournalHistory, run: RunHistory) -> Iterator[Answer]:
    """Yield each failure of a run: what was expected and observed, how often it was tried, and which recovery."""
    began = history.world_began
    for failed in run.failures:
        step, before = failed.step, list[Answer]()
        if sent := history.sent(run, step.index):
            times = listed([f"{attempt.sent - began:.2f} s" for attempt in sent], most=_SHOWN)
            before.append(Answer(f"it was sent {counted(len(sent), 'time')}, at {times}", Known.JOURNAL))
        hindered = [trouble for trouble in run.hindrances if trouble.step.index == step.index and trouble.time < failed.time]
        for trouble in hindered:
            text = f"at {trouble.time - began:.2f} s, attempt {trouble.attempt}: {_cause(trouble)}"
            before.append(Answer(text, Known.JOURNAL))
        for recovery in step.recoveries if isinstance(step, ActionCall) else ():
            if not recovery.causes.isdisjoint({failed.cause.cause, *(trouble.cause.cause for trouble in hindered)}):
                words = ", then ".join([*map(step_words, recovery.chain.steps), recovery.then.value])
                before.append(Answer(f"its plan has a recovery for that: {words}", Known.GIVEN))
        name = f"#{step.index} {step.action}" if isinstance(step, ActionCall) else str(step)
        yield Answer(f"{name} failed at {failed.time - began:.2f} s: {_cause(failed)}", Known.JOURNAL, tuple(before))


def _cause(trouble: Trouble) -> str:
    cause = trouble.cause
    return f"{cause.cause.value.replace('_', ' ')}: expected {cause.expected or 'success'}; observed {cause.observed or 'nothing'}"
