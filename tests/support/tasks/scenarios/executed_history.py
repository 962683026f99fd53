"""What a history tells of a journal without executing its runs, held against what executing them shows."""

from __future__ import annotations

from collections import Counter
from contextlib import closing
from pathlib import Path

from planner_bridge.explanations.history import JournalHistory, RunHistory
from planner_bridge.tasks.result import TASKS
from pnm.core.execution.call_results import CallResult, Explanation, Failure, Hindered, Sent, Told, action_with, sent_with
from pnm.core.execution.events import Observer
from pnm.core.machine.plan_graph import ActionCall, PlanGraph, Step
from pnm.core.machine.requests import Request
from pnm.journal.records import Happened, Record, RunMade
from pnm.journal.replay import ReplayStep
from pnm.journal.resume import steps_after
from pnm.journal.store import KeptJournal


class Seen(Observer):
    """What a run shows those who listen to it, in words."""

    def __init__(self) -> None:
        self.news: list[str] = []

    def sent(self, call: ActionCall, request: Request, now: float) -> None:
        self.news.append(f"sent {request.id} {request.action} {request.attempt} for {call.index}")

    def hindered(self, call: ActionCall, cause: Explanation, now: float) -> None:
        self.news.append(in_words(call, cause, is_failure=False))

    def failed(self, failure: Failure, now: float) -> None:
        cause = Explanation(failure.cause, failure.expected, failure.observed)
        self.news.append(in_words(failure.call, cause, is_failure=True))


def in_words(step: Step, cause: Explanation, *, is_failure: bool) -> str:
    return f"{'failed' if is_failure else 'hindered'} {step.index} {step}: {cause}"


def as_told(result: CallResult) -> tuple[object, ...]:
    """All of a result but what its plan says of the call: conditions are those of the plan, without what parameters had for values."""
    return result.call.index, str(result.call), result.kind, result.attempts, result.started, result.ended, result.assumed, result.cause


class Executed(JournalHistory):
    """A history whose runs are executed record by record, and that complains when what is told is something else."""

    def __init__(self, kept: KeptJournal) -> None:
        super().__init__(lambda key: TASKS.value(kept.part(key)))
        self.seen: dict[object, Seen] = {}
        self.checked = Counter[str]()

    def apply(self, number: int, time: float, record: Record) -> ReplayStep:
        super().apply(number, time, record)
        step, replay = self.execute(), self.replay
        assert step is not None
        assert step.number == number
        if isinstance(record, RunMade):
            self.seen[record.run] = replay.runs[record.run].run.observer = Seen()
        if replay.bases:
            assert (self.world.facts(), self.world.variables()) == (replay.world.facts(), replay.world.variables())
            assert self.world.sensed_names() == replay.world.sensed_names()
        for id, task in replay.tasks.items():
            if self.tasks[id].ended is not None and not task.runs:  # it is said again at the beginning of a segment
                continue
            assert (self.tasks[id].used, self.tasks[id].ending) == (task.used, task.ending)
            assert [run.id for run in self.tasks[id].runs] == [run.made.run for run in task.runs]
        for id in replay.runs:
            self.check(self.runs[id])
        self.check_news(step)
        return step

    def check(self, run: RunHistory) -> None:
        replayed = run.executed()
        assert (run.begun, run.origin) == (replayed.run.begun, replayed.run.origin)
        assert (run.results is not None) is replayed.is_over
        if replayed.result is not None:
            last = {one.call.index: one for one in replayed.result.calls}
            shown = {call.index: CallResult(call) for call in run.source.plan.calls} | last
            assert {index: as_told(one) for index, one in run.last_results.items()} == {index: as_told(one) for index, one in shown.items()}
            self.checked["results"] += 1

    def check_news(self, step: ReplayStep) -> None:
        """Compare, in their order, what a record says that its run has sent and been hindered by with what the run shows."""
        if isinstance(step.record, Happened):
            plan, seen = self.runs[step.record.run].source.plan, self.seen[step.record.run]
            assert [news(plan, told) for told in step.record.told] == seen.news
            self.checked["news"] += len(seen.news)
            seen.news.clear()


def news(plan: PlanGraph, told: Told) -> str:
    match told:
        case Sent(request, call, attempt, arguments):
            return f"sent {request} {action_with(plan.calls[call].action, arguments)} {attempt} for {call}"
        case Hindered(number, cause, is_failure, arguments):
            step = next(step for step in plan.every_step if step.index == number)
            return in_words(sent_with(step, arguments) if isinstance(step, ActionCall) else step, cause, is_failure=is_failure)


def told_as_executed(journal: Path) -> Counter[str]:
    """Hold what is told of a journal against what executing it shows, after every record; then one read at once against that."""
    with closing(KeptJournal(journal)) as kept:
        stepwise = Executed(kept)
        for _ in steps_after(kept, TASKS, stepwise.apply, 0):
            pass
    at_once = JournalHistory.read(journal)
    assert (at_once.attempts, at_once.held) == (stepwise.attempts, stepwise.held)
    assert at_once.runs.keys() == stepwise.runs.keys()
    for id, run in at_once.runs.items():
        other = stepwise.runs[id]
        assert (run.troubles, run.replan, run.last_results) == (other.troubles, other.replan, other.last_results)
    return stepwise.checked
