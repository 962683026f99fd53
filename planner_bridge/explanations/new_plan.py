"""Why a task was planned anew: what failed, with what was expected and observed, and what the next plan keeps, drops and adds."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

from planner_bridge.explanations.answer import Answer, Known, listed
from planner_bridge.explanations.history import JournalHistory, RunHistory, TaskHistory, Trouble
from pnm.core.machine.plan_graph import ActionCall, Recovery
from pnm.core.pictures.timeline import Replan
from pnm.errors import counted

_SHOWN = 6


def why_replanned(history: JournalHistory, task: TaskHistory) -> tuple[Answer, ...]:
    """Return for each run of a task after the first why it followed the one before."""
    answers = tuple(_follows(history, number, before, after) for number, (before, after) in enumerate(pairwise(task.own_runs), 2))
    if answers:
        return answers
    if not task.is_told:
        return (not_told(task),)
    return (Answer(f"there was no new plan for {task.name}", Known.JOURNAL),)


def not_told(task: TaskHistory) -> Answer:
    """Return what is said of a task whose records are dropped."""
    return Answer(f"how {task.name} went is not known: its records are not kept any more", Known.JOURNAL)


def _follows(history: JournalHistory, number: int, before: RunHistory, after: RunHistory) -> Answer:
    replan = after.replan or Replan("")
    text = f"run {number} began at {after.time - history.world_began:.2f} s: {replan.why}"
    return Answer(text, Known.JOURNAL, (*why_failed(history, before), *_changes(replan)))


def why_failed(history: JournalHistory, run: RunHistory) -> Iterator[Answer]:
    """Yield each failure of a run: what was expected and observed, how often it was tried, and which recovery."""
    for trouble in run.failures:
        step = trouble.step
        name = f"#{step.index} {step.action}" if isinstance(step, ActionCall) else str(step)
        text = f"{name} failed at {trouble.time - history.world_began:.2f} s: {_cause(trouble)}"
        yield Answer(text, Known.JOURNAL, tuple(_attempts(history, run, trouble)))


def _cause(trouble: Trouble) -> str:
    cause = trouble.cause
    return f"{cause.cause.value.replace('_', ' ')}: expected {cause.expected or 'success'}; observed {cause.observed or 'nothing'}"


def _attempts(history: JournalHistory, run: RunHistory, failed: Trouble) -> Iterator[Answer]:
    """Yield what was tried before the failure."""
    began, step = history.world_began, failed.step
    if sent := history.sent(run, step.index):
        times = listed([f"{attempt.sent - began:.2f} s" for attempt in sent], most=_SHOWN)
        yield Answer(f"it was sent {counted(len(sent), 'time')}, at {times}", Known.JOURNAL)
    hindered = [trouble for trouble in run.hindrances if trouble.step.index == step.index and trouble.time < failed.time]
    for trouble in hindered:
        yield Answer(f"at {trouble.time - began:.2f} s, attempt {trouble.attempt}: {_cause(trouble)}", Known.JOURNAL)
    for recovery in step.recoveries if isinstance(step, ActionCall) else ():
        if failed.cause.cause in recovery.causes or any(trouble.cause.cause in recovery.causes for trouble in hindered):
            yield Answer(f"its plan has a recovery for that: {_recovery(recovery)}", Known.GIVEN)


def _recovery(recovery: Recovery) -> str:
    steps = [str(step.action if isinstance(step, ActionCall) else step) for step in recovery.chain.steps]
    return ", then ".join([*steps, recovery.then.value])


def _changes(replan: Replan) -> Iterator[Answer]:
    """Yield which calls that were left the new plan keeps and drops, and which it adds."""
    for verb, calls in (("keeps", replan.kept), ("drops", replan.dropped), ("adds", replan.added)):
        if calls:
            yield Answer(f"the plan that followed {verb} {listed([*calls], most=_SHOWN)}", Known.JOURNAL)
