"""One journal, one story: the page, `pnm why`, the timeline and the list of tasks tell the same of every task, whatever has happened.

They tell it without executing the runs, and it is what executing them shows. The journals are random: several tasks at once, pauses,
cancellations, processes that die and others that go on, and many segments.
"""

from __future__ import annotations

import json
import random
import sqlite3
from contextlib import closing
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from uuid import UUID

import pytest

from planner_bridge.explanations.answer import Answer
from planner_bridge.explanations.history import JournalHistory
from planner_bridge.explanations.run_questions import why_call_of_run, why_so
from planner_bridge.pipeline.achieve import carry_out
from planner_bridge.tasks.result import TASKS
from planner_bridge.tasks.settings import Settings
from planner_bridge.view.follow import Reader
from planner_bridge.view.story import View, timelines
from pnm.core.execution.call_results import CallResult
from pnm.core.execution.events import Command, Event
from pnm.core.execution.run import Run
from pnm.core.machine.requests import CallOutcome
from pnm.core.pictures.timeline import Timeline, timeline_svg
from pnm.journal import journal as journal_module
from pnm.journal.kept import DAY
from pnm.journal.replay import ReplayDiffers
from pnm.journal.resume import steps_after, summaries
from pnm.journal.store import KeptJournal
from pnm.tasks import Wanted
from tests.support.files import written
from tests.support.pddl.problems import fleet
from tests.support.tasks.scenarios.crash import survive
from tests.support.tasks.scenarios.forged_journal import forged
from tests.support.tasks.scenarios.random_deaths import run_deaths
from tests.support.tasks.scenarios.random_scenarios import run_scenario
from tests.support.tasks.simulation import TaskSimulation

LENGTHS = (1, 60, 1000)
"""Records after which a segment begins."""


@pytest.fixture
def segments(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have segments begin now and then, while tasks go on as well, or only when nothing is under way."""
    draw = random.Random(number)
    monkeypatch.setattr(journal_module, "_LONG", draw.choice(LENGTHS))
    monkeypatch.setattr(journal_module, "_LONGER", draw.choice(LENGTHS))
    monkeypatch.setattr(journal_module, "_SHARE", 0)


@dataclass(frozen=True)
class Told:
    """What a reader tells of a task.

    Args:
        ending: how it has ended, in words.
        replans: why each new plan followed, and the calls that it keeps, drops and adds.
        failures: how many there were.
        requests: what was sent, and how it has ended.
    """

    ending: str
    replans: list[tuple[str, tuple[str, ...], tuple[str, ...], tuple[str, ...]]]
    failures: int
    requests: list[tuple[str, str]]


def on_the_page(view: View, id: str) -> Told:
    task = view.tasks[id]
    replans = [view.runs[run]["replan"] for run in task["runs"]]
    own = [[thing for thing in things.values() if thing["run"] in task["runs"]] for things in (view.troubles, view.requests)]
    assert all(view.calls[f"{one['run']}/{one['call']}"]["action"] == one["action"] for one in own[1])
    return Told(
        f"{task['code']}: {task['reason']}" if task["code"] else "",
        [(replan["why"], replan["kept"], replan["dropped"], replan["added"]) for replan in replans if replan],
        sum(trouble["is_failure"] for trouble in own[0]),
        sorted((request["action"], request["outcome"]) for request in own[1]),
    )


def on_the_timeline(timeline: Timeline) -> Told:
    calls = [call for plan in timeline.plans for call in plan.calls]
    assert [plan.began for plan in timeline.plans] == sorted(plan.began for plan in timeline.plans)
    for call in calls:
        times = [time for attempt in call.attempts for time in (attempt.sent, attempt.ended) if time is not None]
        assert times == sorted(times)
        assert all(-1e-6 <= time <= timeline.now + 1e-6 for time in times)
    return Told(
        timeline.ending,
        [(plan.replan.why, plan.replan.kept, plan.replan.dropped, plan.replan.added) for plan in timeline.plans if plan.replan],
        sum(len(plan.failures) for plan in timeline.plans),
        sorted((call.name, attempt.outcome.value if attempt.outcome else "") for call in calls for attempt in call.attempts),
    )


def new_plans(answers: tuple[Answer, ...]) -> list[str]:
    """Why each new plan followed, as `pnm why` tells it."""
    return [answer.statement.partition(" s: ")[2] for answer in answers if " began at " in answer.statement]


def check_one_story(journal: Path) -> View:
    """Complain about what two readers of a journal tell differently; return the view of it."""
    view, told, listed, history = Reader(journal).newest(), timelines(journal), summaries(journal, TASKS), JournalHistory.read(journal)
    assert not view.problem
    assert timeline_svg(*told).startswith("<svg")
    rows = {summary.accepted.wanted.id: summary for summary in listed}
    for (id, task), timeline in zip(history.tasks.items(), told, strict=True):
        drawn, answers = on_the_timeline(timeline), why_so(history, task)
        assert new_plans(answers) == [why for why, *_ in drawn.replans]
        if drawn.ending:
            assert answers[0].statement.endswith(f" is over: {drawn.ending}")
            assert max(0, rows[id].runs - 1) == len(drawn.replans)
            assert rows[id].seconds == pytest.approx(timeline.now, abs=1e-6)
        if (shown := view.tasks.get(id.hex)) is not None and shown["runs"]:
            assert on_the_page(view, id.hex) == drawn
            if shown["code"]:
                assert all(trouble["followed"] for trouble in view.troubles.values() if trouble["run"] in shown["runs"])
                assert shown["used"] <= timeline.now + 1e-6
    return view


def as_told(result: CallResult) -> tuple[object, ...]:
    """All of a result but what its plan says of the call: conditions are those of the plan, without what parameters had for values."""
    return result.call.index, str(result.call), result.kind, result.attempts, result.started, result.ended, result.assumed, result.cause


def check_answers(history: JournalHistory) -> None:
    """Ask why every task and every call is as it is."""
    for task in history.tasks.values():
        assert why_so(history, task)
        for run, call in ((one, call.index) for one in task.runs for call in one.source.plan.calls):
            answers = why_call_of_run(history, task, run, call)
            assert all(part.statement and not part.claims for answer in answers for part in answer.every())
            if any(answer.statement.endswith(" waits") for answer in answers):
                assert run.last_results[call].kind is CallOutcome.WAITING


def check_told_as_executed(journal: Path) -> None:
    """Complain if executing the runs, which compares what they send and suffer, shows something else than was told without that."""
    with closing(KeptJournal(journal)) as kept:
        stepwise = JournalHistory(lambda key: TASKS.value(kept.part(key)))
        for step in steps_after(kept, TASKS, stepwise.apply, 0):
            if step.number % 60 == 0:
                check_answers(stepwise)
            replay = stepwise.replay
            if stepwise._repetition.left:  # the beginning of a segment is whole, or not there
                continue
            if replay.bases:
                assert (stepwise.world.facts(), stepwise.world.variables()) == (replay.world.facts(), replay.world.variables())
                assert stepwise.world.sensed_names() == replay.world.sensed_names()
            for id, task in replay.tasks.items():
                told = stepwise.tasks[id]
                if told.ended is None or task.runs:  # else it is said again at the beginning of a segment
                    assert (told.used, told.ending) == (task.used, task.ending)
                    assert [run.id for run in told.runs] == [run.made.run for run in task.runs]
            for run, replayed in ((stepwise.runs[id], replayed) for id, replayed in replay.runs.items()):
                assert (run.begun, run.origin) == (replayed.run.begun, replayed.run.origin)
                assert (run.results is not None) is replayed.is_over
                if replayed.result is not None:
                    shown = {call.index: CallResult(call) for call in run.source.plan.calls}
                    shown |= {one.call.index: one for one in replayed.result.calls}
                    assert {index: as_told(one) for index, one in run.last_results.items()} == {i: as_told(one) for i, one in shown.items()}
    at_once = JournalHistory.read(journal)
    assert (at_once.attempts, at_once.held) == (stepwise.attempts, stepwise.held)
    assert at_once.runs.keys() == stepwise.runs.keys()
    for id, run in at_once.runs.items():
        other = stepwise.runs[id]
        assert (run.troubles, run.replan, run.last_results) == (other.troubles, other.replan, other.last_results)


@pytest.mark.usefixtures("segments")
@pytest.mark.parametrize("number", range(8))
def test_all_readers_tell_one_story_of_tasks_that_people_interfere_with(number: int, tmp_path: Path) -> None:
    live: dict[str, tuple[str, int]] = {}

    def note(simulation: TaskSimulation) -> None:
        """Note what the tasks themselves say in the end: how often what has happened, and their replans."""
        for task in simulation.master._past:
            if task.result is not None and task.result.episodes:
                live[task.id.hex] = str(task.result.counts), task.status.replans

    run_scenario(number, journal=tmp_path / "journal", end=note)
    check_told_as_executed(tmp_path / "journal")
    view = check_one_story(tmp_path / "journal")
    for id, (counts, replans) in live.items():
        if (task := view.tasks.get(id)) and task["runs"]:
            assert (task["counts"], len(task["runs"]) - 1) == (counts, replans)


@pytest.mark.usefixtures("segments")
@pytest.mark.parametrize("number", range(6))
def test_all_readers_tell_one_story_of_tasks_whose_processes_die(number: int, tmp_path: Path) -> None:
    run_deaths(number, tmp_path)
    check_told_as_executed(tmp_path / "journal")
    check_one_story(tmp_path / "journal")


CALLS_ANOTHER = """
actions: {say: {params: [text]}}
all: {plan: [say: {text: first}, more: , say: {text: last}]}
more: {plan: [say: {text: one}, say: {text: two}]}
"""


def test_a_plan_that_is_a_call_of_another_is_no_replan(tmp_path: Path) -> None:
    file, journal = written(tmp_path / "plan.yaml", CALLS_ANOTHER), tmp_path / "journal"
    result = carry_out(file, "all", journal=journal)
    assert result.goal_reached
    (task,) = check_one_story(journal).tasks.values()
    assert len(task["runs"]) == 2
    assert task["counts"] == str(result.counts) == "4 requests, 0 failures"


def test_of_a_task_whose_records_are_dropped_nothing_is_claimed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journal_module, "_LONG", 1)
    days = count()
    tasks = [Wanted(UUID(int=number + 1), f"(at r1 a{2 + number % 2})") for number in range(12)]
    survive(fleet(), tasks, Settings(improve=0.0), tmp_path / "journal", [], in_turn=True, wall=lambda: next(days) * DAY)
    history = JournalHistory.read(tmp_path / "journal")
    dropped = [task for task in history.tasks.values() if not task.is_told]
    assert 0 < len(dropped) < len(history.tasks)
    for task in dropped:
        ended, unknown = why_so(history, task)
        assert "is over: goal_reached" in ended.statement
        assert unknown.statement == f"how {task.name} went is not known: its records are not kept any more"


def test_what_is_told_of_a_task_that_is_over_is_told_without_executing_its_runs(delivery: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def told() -> tuple[object, ...]:
        history = JournalHistory.read(delivery)
        return timelines(delivery), *(why_so(history, task) for task in history.tasks.values())

    before = told()
    check_told_as_executed(delivery)

    def handle(run: Run, event: Event, now: float) -> list[Command]:
        raise AssertionError("it was executed")

    monkeypatch.setattr(Run, "handle", handle)
    assert told() == before


@pytest.mark.parametrize("change", [("told", "Sent", "attempt", 7), ("results", "Became", "attempts", 7)])
def test_what_no_run_has_done_is_found_where_runs_are_executed(delivery: Path, change: tuple[str, str, str, int], tmp_path: Path) -> None:
    key, kind, field, value = change
    copy = tmp_path / "forged"
    with closing(sqlite3.connect(delivery)) as file:
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
