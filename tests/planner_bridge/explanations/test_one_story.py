"""One journal, one story: the page, `pnm why`, the timeline and the list of tasks tell the same of every task, whatever has happened.

The journals are random: several tasks at once, pauses, cancellations, processes that die and others that go on, and many segments.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from uuid import UUID

import pytest

from planner_bridge.explanations.answer import Answer
from planner_bridge.explanations.history import JournalHistory
from planner_bridge.explanations.run_questions import explained
from planner_bridge.pipeline.carry_out import carry_out
from planner_bridge.tasks.result import TASKS
from planner_bridge.tasks.settings import Settings
from planner_bridge.view.follow import Reader
from planner_bridge.view.shown import View
from planner_bridge.view.story import timelines
from pnm.core.pictures.timeline import Timeline
from pnm.journal import journal as journal_module
from pnm.journal.kept import DAY
from pnm.journal.records import TaskAccepted
from pnm.journal.replay import Replay
from pnm.journal.resume import replay_steps, summaries
from pnm.tasks import Wanted
from tests.support.files import written
from tests.support.pddl.problems import fleet
from tests.support.tasks.scenarios.crash import survive
from tests.support.tasks.scenarios.random_deaths import run_deaths
from tests.support.tasks.scenarios.random_scenarios import run_scenario
from tests.support.tasks.simulation import TaskSimulation

LENGTHS = (1, 60, 1000)
"""Records after which a segment begins."""


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
    runs = [view.runs[run] for run in task.runs]
    return Told(
        f"{task.code}: {task.reason}" if task.code else "",
        [(run.replan.why, run.replan.kept, run.replan.dropped, run.replan.added) for run in runs if run.replan],
        sum(trouble.is_failure for trouble in view.troubles.values() if trouble.run in task.runs),
        sorted((request.action, request.outcome) for request in view.requests.values() if request.run in task.runs),
    )


def on_the_timeline(timeline: Timeline) -> Told:
    calls = [call for plan in timeline.plans for call in plan.calls]
    return Told(
        timeline.ending,
        [(plan.replan.why, plan.replan.kept, plan.replan.dropped, plan.replan.added) for plan in timeline.plans if plan.replan],
        sum(len(plan.failures) for plan in timeline.plans),
        sorted((call.name, attempt.outcome.value if attempt.outcome else "") for call in calls for attempt in call.attempts),
    )


def new_plans(answers: tuple[Answer, ...]) -> list[str]:
    """Why each new plan followed, as `pnm why` tells it."""
    return [answer.statement.partition(" s: ")[2] for answer in answers if " began at " in answer.statement]


def accepted(journal: Path) -> Iterator[UUID]:
    """The tasks of a journal, each once, in the order in which they were accepted."""
    steps = replay_steps(journal, TASKS, Replay())
    return iter(dict.fromkeys(step.record.wanted.id for step in steps if isinstance(step.record, TaskAccepted)))


def check_one_story(journal: Path) -> int:
    """Complain about what two readers of a journal tell differently; return how many tasks both tell with their plans."""
    view, told, listed, both = Reader(journal).newest(), timelines(journal), summaries(journal, TASKS), 0
    assert not view.problem
    rows = {summary.accepted.wanted.id: summary for summary in listed}
    for id, timeline in zip(accepted(journal), told, strict=True):
        drawn = on_the_timeline(timeline)
        answers = explained(journal, id)
        assert new_plans(answers) == [why for why, *_ in drawn.replans]
        if drawn.ending:
            assert answers[0].statement.endswith(f" is over: {drawn.ending}")
            assert max(0, rows[id].runs - 1) == len(drawn.replans)
            assert rows[id].seconds == pytest.approx(timeline.now, abs=1e-6)
        if (shown := view.tasks.get(id.hex)) is not None and shown.runs:
            assert on_the_page(view, id.hex) == drawn
            both += 1
            if shown.code:
                assert not [trouble for trouble in view.troubles.values() if trouble.run in shown.runs and not trouble.followed]
                assert shown.used <= timeline.now + 1e-6
    return both


@pytest.mark.parametrize("number", range(12))
def test_all_readers_tell_one_story_of_tasks_that_people_interfere_with(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(journal_module, "_LONG", random.Random(number).choice(LENGTHS))
    live: dict[str, tuple[str, int]] = {}

    def note(simulation: TaskSimulation) -> None:
        """Note what the tasks themselves say in the end: how often what has happened, and their replans."""
        for task in simulation.master._past:
            if task.result is not None and task.result.episodes:
                live[task.id.hex] = str(task.result.counts), task.status.replans

    run_scenario(number, journal=tmp_path / "journal", end=note)
    check_one_story(tmp_path / "journal")
    view = Reader(tmp_path / "journal").newest()
    for id, (counts, replans) in live.items():
        if (task := view.tasks.get(id)) and task.runs:
            assert (task.counts, len(task.runs) - 1) == (counts, replans)


@pytest.mark.parametrize("number", range(8))
def test_all_readers_tell_one_story_of_tasks_whose_processes_die(number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journal_module, "_LONG", random.Random(number).choice(LENGTHS))
    run_deaths(number, tmp_path)
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
    check_one_story(journal)
    (task,) = Reader(journal).newest().tasks.values()
    assert len(task.runs) == 2
    assert task.counts == str(result.counts) == "3 requests, 0 failures"
    (id,) = accepted(journal)
    assert new_plans(explained(journal, id)) == []


def test_of_a_task_whose_records_are_dropped_nothing_is_claimed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journal_module, "_LONG", 1)
    days = count()
    tasks = [Wanted(UUID(int=number + 1), f"(at r1 a{2 + number % 2})") for number in range(12)]
    survive(fleet(), tasks, Settings(improve=0.0), tmp_path / "journal", [], in_turn=True, wall=lambda: next(days) * DAY)
    told = JournalHistory.read(tmp_path / "journal").tasks.values()
    dropped = [task for task in told if not task.is_told]
    assert 0 < len(dropped) < len(told)
    for task in dropped:
        ended, unknown = explained(tmp_path / "journal", task.accepted.wanted.id)
        assert "is over: goal_reached" in ended.statement
        assert unknown.statement == f"how {task.name} went is not known: its records are not kept any more"
