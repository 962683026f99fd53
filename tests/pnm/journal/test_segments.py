"""Segments of a journal: a process goes on with the last one, the ones before it can be dropped, and the file does not grow."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import closing
from itertools import count
from pathlib import Path
from uuid import UUID

import pytest

from planner_bridge.tasks.result import TASKS
from planner_bridge.tasks.settings import Settings
from pnm.core.execution.events import Begin, Command, Send
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.conditions import TRUE, Holds, Not
from pnm.core.logic.rules import NO_RULES, DerivationRule, Rules
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import ActionCall, Flow, GroundAction, Loop, PlanGraph
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind
from pnm.core.resources import Resources
from pnm.journal import journal as journal_module
from pnm.journal.journal import WrittenJournal
from pnm.journal.kept import DAY, Fenced, Hold
from pnm.journal.records import KnowledgeDelta, SharedBegan
from pnm.journal.replay import Replay
from pnm.journal.resume import Follower, replay_steps, replayed, summaries
from pnm.journal.store import JournalFile, KeptJournal
from pnm.tasks import Code, TaskEnding, Wanted
from tests.support.pddl.problems import fleet
from tests.support.runs.simulation.disk import DEATHS, DiskPlan
from tests.support.tasks.scenarios.crash import survive

GOALS = tuple(Wanted(UUID(int=number + 1), text) for number, text in enumerate(("(in p0 a2)", "(at r1 a3)", "(in p0 a1)")))
QUICK = Settings(improve=0.0)


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have a segment begin whenever nothing is under way."""
    monkeypatch.setattr(journal_module, "_LONG", 1)


@pytest.mark.usefixtures("short")
def test_what_is_known_in_the_last_segment_is_what_all_segments_lead_to(tmp_path: Path) -> None:
    survive(fleet(), GOALS, QUICK, tmp_path / "j", [], in_turn=True)
    whole = Replay()
    steps = [*replay_steps(tmp_path / "j", TASKS, whole)]
    assert sum(isinstance(step.record, SharedBegan) for step in steps) == 1 + len(GOALS)
    last = replayed(tmp_path / "j", TASKS)
    assert last.length < len(steps)
    assert last.world.facts() == whole.world.facts()
    assert (last.began, last.now) == (whole.began, whole.now)
    assert {id: task.ending for id, task in last.tasks.items()} == {id: task.ending for id, task in whole.tasks.items()}


async def test_a_process_that_stands_by_knows_no_more_than_one_that_reads_the_last_segment(tmp_path: Path) -> None:
    """What it knew besides would be missing in the segment that it goes on with, for the process after it."""
    journal, world = WrittenJournal(JournalFile(tmp_path / "j", 0.0), TASKS), KnowledgeBase()
    journal.begin(world, Resources())
    follower = Follower(tmp_path / "j", TASKS)
    acts = PlanGraph((ActionCall(0, GroundAction("act")),))
    run = journal.make_run(generate(acts), Layered(world), id=UUID(int=1), bindings=Bindings(), goal_fields=lambda _: ("action",))
    journal.handle(run, Begin(), 0.0, lambda _: None)
    await asyncio.sleep(0.1)
    follower.catch_up()
    assert follower.replay.fields == {"act()": ("action",)}
    journal.retired(run)
    run.retire()
    journal.begin(world, Resources())
    await asyncio.sleep(0.1)
    follower.catch_up()
    fresh = replayed(tmp_path / "j", TASKS)
    for known in (follower.replay, fresh):
        assert (known.fields, known.runs, known.requests, known.tasks) == ({}, {}, {}, {})
    follower.close()
    journal.close()


async def test_another_world_is_no_change_of_the_one_before(tmp_path: Path) -> None:
    near, far = ("near",), ("far",)
    journal, world = WrittenJournal(JournalFile(tmp_path / "j", 0.0), TASKS), KnowledgeBase()
    world.begin_anew({near: True}, {}, Rules((DerivationRule("far", (), Not(Holds(near))),)))
    journal.begin(world, Resources())
    journal.begin(world, Resources(), lambda: world.begin_anew({far: True}, {}, NO_RULES))  # which was derived before
    world.update({near: True})
    journal.close()
    whole = Replay()
    deltas = [step.record for step in replay_steps(tmp_path / "j", TASKS, whole) if isinstance(step.record, KnowledgeDelta)]
    assert deltas == [KnowledgeDelta(0, {near: True})]
    assert whole.world.facts() == {far: True, near: True}


@pytest.mark.usefixtures("short")
def test_tasks_in_turn_survive_a_death_before_during_or_after_every_commit(tmp_path: Path) -> None:
    for commit in count(1):
        death = DiskPlan(commit, DEATHS[commit % len(DEATHS)])
        survival = survive(fleet(), GOALS[:2], QUICK, tmp_path / f"{commit}.journal", [death], in_turn=True)
        assert {ending.code for ending in survival.endings.values()} == {Code.GOAL_REACHED}, (commit, survival.endings)
        assert survival.endings.keys() == {wanted.id for wanted in GOALS[:2]}
        assert [survival.repeated, survival.wrong] == [[], []], commit
        if not survival.deaths:
            assert commit > 20
            return


@pytest.fixture
def all_the_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have a segment begin after a few records, whatever goes on."""
    monkeypatch.setattr(journal_module, "_LONGER", 5)
    monkeypatch.setattr(journal_module, "_SHARE", 0)


@pytest.mark.usefixtures("all_the_time")
def test_what_goes_on_survives_a_death_before_during_or_after_every_commit(tmp_path: Path) -> None:
    begun = 0
    for commit in count(1):
        death = DiskPlan(commit, DEATHS[commit % len(DEATHS)])
        survival = survive(fleet(), GOALS[:2], QUICK, tmp_path / f"{commit}.journal", [death])
        assert {ending.code for ending in survival.endings.values()} == {Code.GOAL_REACHED}, (commit, survival.endings)
        assert [survival.repeated, survival.wrong] == [[], []], commit
        begun += sum(isinstance(record, SharedBegan) and record.since > 0 for record in survival.story.records)
        if not survival.deaths:
            assert commit > 20
            assert begun > 5 * commit
            return


@pytest.mark.usefixtures("all_the_time")
def test_the_records_of_a_task_that_goes_on_are_dropped_but_for_the_last_segment(tmp_path: Path) -> None:
    days = count()
    survive(fleet(), GOALS[:1], QUICK, tmp_path / "j", [30], wall=lambda: next(days) * DAY)
    steps = [*replay_steps(tmp_path / "j", TASKS, Replay())]
    assert steps[0].number > 30, "its first segments are not there any more"
    first = steps[0].record
    assert isinstance(first, SharedBegan)
    assert 0 < first.since < steps[0].number, "it goes on there"
    assert [task.ending and task.ending.code for task in replayed(tmp_path / "j", TASKS).tasks.values()] == [Code.GOAL_REACHED]


async def test_a_loop_is_taken_up_as_fast_however_long_it_has_gone_on(tmp_path: Path) -> None:
    lengths: list[int] = []
    for calls in (2_000, 6_000):
        journal, world = WrittenJournal(JournalFile(tmp_path / f"{calls}", 0.0), TASKS), KnowledgeBase()
        journal.begin(world, Resources())
        body = Flow((ActionCall(0, GroundAction("act")),))
        machine = generate(PlanGraph((Loop(1, TRUE, body, 10**6),)))
        run = journal.make_run(machine, Layered(world), id=UUID(int=1), bindings=Bindings(), goal_fields=lambda _: None)
        waiting: list[Command] = []
        journal.handle(run, Begin(), 0.0, waiting.extend)
        for number in range(calls):
            (sent,) = (command.request.id for command in waiting if isinstance(command, Send))
            waiting.clear()
            journal.handle(run, Accepted(sent), float(number), waiting.extend)
            journal.handle(run, Ended(sent, Outcome(OutcomeKind.SUCCEEDED)), float(number), waiting.extend)
            if number % 100 == 0:
                await asyncio.sleep(0)
        journal.close()
        again = replayed(tmp_path / f"{calls}", TASKS)
        assert again.runs[run.id].run.marking == run.marking
        assert again.runs[run.id].run.interim_result().earlier.attempts + len(again.runs[run.id].run.results) == calls + 1
        with closing(KeptJournal(tmp_path / f"{calls}")) as kept:
            lengths.append(sum(len(row.text) for _, row in kept.rows(kept.last_segment() - 1)))
    assert lengths[1] < 2 * lengths[0]


async def test_records_of_the_past_are_dropped_while_there_is_nothing_to_do(tmp_path: Path) -> None:
    class Looking(Hold):
        look: Callable[[], None]

        def keep(self, renewed: Callable[[], None], fenced: Callable[[Fenced], None]) -> None:
            self.look = renewed

    wall, hold, path = 0.0, Looking(), tmp_path / "j"
    file = JournalFile(path, wall)
    journal, world = WrittenJournal(file, TASKS, kept=7 * DAY, hold=hold, wall=lambda: wall), KnowledgeBase()
    journal.begin(world, Resources())
    secret = Wanted(UUID(int=1), "(open door1)")
    journal.accepted(secret, 1)
    world.update({("said",): "secret"})
    world.update({("said",): "nothing"})
    for hours in range(10 * 24):
        wall = hours * DAY / 24
        if hours == 1:
            journal.over(secret.id, TaskEnding(Code.CANCELLED, "by its client"))
        hold.look()
        kept = KeptJournal(path)
        texts = "".join(row.text for _, row in kept.rows())
        assert ("secret" in texts) or wall > 7 * DAY, "it is kept for as long as was said"
        segments = len(kept.segments())
        kept.close()
    assert "secret" not in texts
    assert segments == 1, "nothing begins while nothing is new"
    journal.close()


@pytest.mark.usefixtures("short")
def test_records_of_the_past_are_dropped_and_its_tasks_are_listed(tmp_path: Path) -> None:
    days = count()
    there_and_back = [Wanted(UUID(int=number + 1), f"(at r1 a{2 + number % 2})") for number in range(30)]
    survive(fleet(), there_and_back, QUICK, tmp_path / "j", [], in_turn=True, wall=lambda: next(days) * DAY)
    steps = [*replay_steps(tmp_path / "j", TASKS, Replay())]
    segments = [step.record for step in steps if isinstance(step.record, SharedBegan)]
    assert 1 < len(segments) < 5
    assert len(steps) < 200 < steps[0].number
    listed = summaries(tmp_path / "j", TASKS)
    assert [summary.ending and summary.ending.code for summary in listed] == [Code.GOAL_REACHED] * 30
    assert all(
        summary.seconds is not None and 0.0 < summary.seconds < 60.0 for summary in listed
    )  # days have passed by the clock on the wall
    assert len(replayed(tmp_path / "j", TASKS).tasks) == 20  # which clients may still ask for


async def test_what_is_heard_after_the_end_is_left_to_the_next_process(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    journal, world = WrittenJournal(JournalFile(tmp_path / "j", 0.0), TASKS), KnowledgeBase()
    journal.begin(world, Resources())
    world.update({("at", "r1", "a"): True})
    journal.close()
    world.update({("at", "r1", "b"): True})
    await asyncio.sleep(0.1)
    assert not journal.blocked
    assert not caplog.records
    assert replayed(tmp_path / "j", TASKS).world.facts() == {("at", "r1", "a"): True}
