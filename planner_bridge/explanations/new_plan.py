"""Why a task was planned anew: what failed, with what was expected and observed, and what the next plan keeps, drops and adds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from planner_bridge.explanations.answer import Answer, Known, listed
from planner_bridge.explanations.run_history import JournalHistory, RunHistory, TaskHistory, Trouble
from planner_bridge.tasks.replanning import decision_words
from pnm.core.machine.plan_graph import ActionCall, Recovery
from pnm.errors import counted

_SHOWN = 6


def why_replanned(history: JournalHistory, task: TaskHistory) -> tuple[Answer, ...]:
    """Return for each run of a task after the first why it followed the one before."""
    pairs = zip(task.runs, task.runs[1:], strict=False)
    answers = tuple(_follows(history, number, before, after) for number, (before, after) in enumerate(pairs, 2))
    if answers:
        return answers
    return (Answer(f"there was no new plan for {task.name}", Known.JOURNAL),)


def _follows(history: JournalHistory, number: int, before: RunHistory, after: RunHistory) -> Answer:
    text = f"run {number} began at {after.time - history.replay.began:.2f} s: {decision_words(before.decision)}"
    return Answer(text, Known.JOURNAL, (*why_failed(history, before), *_changes(before, after)))


def why_failed(history: JournalHistory, run: RunHistory) -> Iterator[Answer]:
    """Yield each failure of a run: what was expected and observed, how often it was tried, and which recovery."""
    for trouble in run.troubles:
        if trouble.failure is not None:
            step = trouble.failure.call
            name = f"#{step.index} {step.action}" if isinstance(step, ActionCall) else str(step)
            text = f"{name} failed at {trouble.time - history.replay.began:.2f} s: {_cause(trouble)}"
            yield Answer(text, Known.JOURNAL, tuple(_attempts(history, run, trouble)))


def _cause(trouble: Trouble) -> str:
    cause = trouble.cause
    return f"{cause.cause.value.replace('_', ' ')}: expected {cause.expected or 'success'}; observed {cause.observed or 'nothing'}"


def _attempts(history: JournalHistory, run: RunHistory, failed: Trouble) -> Iterator[Answer]:
    """Yield what was tried before the failure."""
    sent = run.sent.get(failed.call, [])
    if sent:
        times = listed([f"{time - history.replay.began:.2f} s" for time in sent], most=_SHOWN)
        yield Answer(f"it was sent {counted(len(sent), 'time')}, at {times}", Known.JOURNAL)
    hindered = [
        trouble for trouble in run.troubles if trouble.call == failed.call and trouble.failure is None and trouble.time < failed.time
    ]
    for trouble in hindered:
        yield Answer(f"at {trouble.time - history.replay.began:.2f} s, attempt {trouble.attempt}: {_cause(trouble)}", Known.JOURNAL)
    step = failed.failure.call if failed.failure else None
    for recovery in step.recoveries if isinstance(step, ActionCall) else ():
        if failed.cause.cause in recovery.causes or any(trouble.cause.cause in recovery.causes for trouble in hindered):
            yield Answer(f"its plan has a recovery for that: {_recovery(recovery)}", Known.GIVEN)


def _recovery(recovery: Recovery) -> str:
    steps = [str(step.action if isinstance(step, ActionCall) else step) for step in recovery.chain.steps]
    return ", then ".join([*steps, recovery.then.value])


def _changes(before: RunHistory, after: RunHistory) -> Iterator[Answer]:
    """Yield what the new plan has of the calls that were left of the one before, what not, and what else."""
    left = Counter(str(result.call.action) for result in before.results.values() if not result.is_done)
    new = Counter(str(call.action) for call in after.source.plan.calls)
    for verb, calls in (("keeps", left & new), ("drops", left - new), ("adds", new - left)):
        if names := [*calls.elements()]:
            yield Answer(f"the plan that followed {verb} {listed(names, most=_SHOWN)}", Known.JOURNAL)
