"""Told and executed: after every record of a random journal, what is told without executing the runs is what executing them shows."""

from __future__ import annotations

import json
import random
import sqlite3
from collections import Counter
from contextlib import closing
from pathlib import Path

import pytest

from planner_bridge.explanations.history import JournalHistory, RunHistory
from planner_bridge.explanations.run_questions import explained
from planner_bridge.pipeline.achieve import achieve
from planner_bridge.tasks.result import TASKS
from planner_bridge.view.story import timelines
from pnm.actions.faults import read_faults
from pnm.core.execution.call_results import CallResult, Explanation, Failure, Hindered, Sent, Told, action_with, sent_with
from pnm.core.execution.events import Command, Event, Observer
from pnm.core.execution.run import Run
from pnm.core.machine.plan_graph import ActionCall, PlanGraph, Step
from pnm.core.machine.requests import Request
from pnm.journal import journal as journal_module
from pnm.journal.records import Happened, Record, RunMade
from pnm.journal.replay import ReplayDiffers, ReplayStep as Replayed
from pnm.journal.resume import steps_after
from pnm.journal.store import KeptJournal
from tests.support.files import ROOT
from tests.support.tasks.scenarios.forged_journal import forged
from tests.support.tasks.scenarios.random_deaths import run_deaths
from tests.support.tasks.scenarios.random_scenarios import run_scenario

LENGTHS = (1, 60, 1000)
"""Records after which a segment begins."""


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

    def apply(self, number: int, time: float, record: Record) -> Replayed:
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

    def check_news(self, step: Replayed) -> None:
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


def check(journal: Path) -> Counter[str]:
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


def test_what_is_told_of_tasks_that_people_interfere_with_is_what_executing_shows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checked = Counter[str]()
    for number in range(12):
        monkeypatch.setattr(journal_module, "_LONG", random.Random(number).choice(LENGTHS))
        run_scenario(number, journal=tmp_path / str(number))
        checked += check(tmp_path / str(number))
    assert checked["results"] > 30
    assert checked["news"] > 30


@pytest.mark.parametrize("number", range(8))
def test_what_is_told_of_tasks_whose_processes_die_is_what_executing_shows(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(journal_module, "_LONG", random.Random(number).choice(LENGTHS))
    run_deaths(number, tmp_path)
    check(tmp_path / "journal")


@pytest.fixture(scope="module")
def journal(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The journal of a run with failures and new plans."""
    place = tmp_path_factory.mktemp("told") / "run.journal"
    domain, problems = ROOT / "domains" / "delivery" / "domain.pddl", ROOT / "problems" / "delivery"
    assert achieve(domain, problems / "p01.pddl", faults=read_faults(problems / "faults.yaml", None), journal=place).goal_reached
    return place


def test_of_a_task_that_is_over_no_run_is_executed(journal: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (task,) = JournalHistory.read(journal).tasks
    (drawn,), answers = timelines(journal), explained(journal, task)

    def handle(run: Run, event: Event, now: float) -> list[Command]:
        raise AssertionError("it was executed")

    monkeypatch.setattr(Run, "handle", handle)
    assert timelines(journal) == (drawn,)
    assert explained(journal, task) == answers


@pytest.mark.parametrize("change", [("told", "Sent", "attempt", 7), ("results", "Became", "attempts", 7)])
def test_what_no_run_has_done_is_found_where_runs_are_executed(journal: Path, change: tuple[str, str, str, int], tmp_path: Path) -> None:
    key, kind, field, value = change
    copy = tmp_path / "forged"
    with closing(sqlite3.connect(journal)) as file:
        file.execute("VACUUM INTO ?", (str(copy),))
    with forged(copy) as file:
        rows = file.execute("SELECT sequence, text FROM records ORDER BY sequence").fetchall()
        for number, text in rows:
            record = json.loads(text)
            if entries := [entry for entry in record.get(key, ()) if entry["@"] == kind]:
                entries[0][field] = value
                file.execute("UPDATE records SET text = ? WHERE sequence = ?", (json.dumps(record), number))
                break
    with pytest.raises(ReplayDiffers, match=f"record {number}: the replay .* the journal says"):
        JournalHistory.read(copy).execute()
