"""Tasks in the next process: paused ones send nothing, those that have begun go on first, and none leaves its robot unwatched."""

from __future__ import annotations

import asyncio
import re
from pathlib import Path
from uuid import UUID

import pytest

from planner_bridge.tasks.result import TASKS
from planner_bridge.tasks.task_manager import TaskLimits
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.machine.bindings import Binding
from pnm.core.resources import Resources
from pnm.errors import InputError
from pnm.journal.codec import RECORDS
from pnm.journal.journal import WrittenJournal
from pnm.journal.records import EndConfirmed
from pnm.journal.replay import Replay
from pnm.journal.resume import replay_steps, replayed
from pnm.journal.store import JournalFile
from pnm.language.plan import parse_plans
from pnm.language.runner import Program
from pnm.tasks import Code, TaskRefused, TaskState, Wanted
from tests.support.tasks.scenarios.successors import Successors

GOALS = {"r1 there": ("at", "r1", "a2"), "r1 far": ("at", "r1", "a3"), "r0 there": ("at", "r0", "a2")}
FAR = Wanted(UUID(int=1), "r1 far")
ROUND = """
actions: {move: {params: [r, from, to], duration: 4}}
plan: [move: {r: r1, from: a1, to: a2}, move: {r: r1, from: a2, to: a3}]
"""


async def test_a_plan_that_was_paused_sends_nothing_in_the_next_process_before_it_is_resumed(tmp_path: Path) -> None:
    task = Wanted(UUID(int=1), "round", is_plan=True)
    (plan,) = parse_plans(ROUND).values()
    lives = Successors(tmp_path, GOALS, programs={"round": Program.of(plan)})
    async with lives.begun() as (manager, heard):
        manager.begin(task)
        await heard.sent.wait()
        await manager.pause(task.id, at_once=False)
    async with lives.gone_on() as (second, _, heard):
        await asyncio.sleep(100.0)
        assert second.link.sent == []
        await second.manager.resume(task.id)
        await heard.over.wait()
        assert [action.partition("(")[0] for action in second.link.sent] == ["move"]
        assert heard.endings[task.id].code is Code.GOAL_REACHED


async def test_a_task_that_was_paused_because_its_node_was_inactive_goes_on_in_the_next_process(tmp_path: Path) -> None:
    lives = Successors(tmp_path, GOALS)
    async with lives.begun() as (manager, heard):
        manager.begin(FAR)
        await heard.sent.wait()
        await manager.pause(None, at_once=True, is_kept=False)
    async with lives.gone_on() as (_, _, heard):
        await heard.over.wait()
        assert heard.endings[FAR.id].code is Code.GOAL_REACHED


async def test_a_task_that_has_begun_goes_on_before_those_of_higher_priority_that_waited(tmp_path: Path) -> None:
    waiting, lives = Wanted(UUID(int=2), "r1 there", priority=5), Successors(tmp_path, GOALS, limits=TaskLimits(active=1))
    async with lives.begun() as (manager, heard):
        manager.begin(FAR)
        await heard.sent.wait()
        manager.begin(waiting)
    async with lives.gone_on() as (_, _, heard):
        while len(heard.endings) < 2:
            heard.over.clear()
            await heard.over.wait()
        assert {ending.code for ending in heard.endings.values()} == {Code.GOAL_REACHED}
        assert [*heard.endings] == [FAR.id, waiting.id]


async def test_a_task_that_was_over_is_over_in_the_next_process_and_one_that_goes_on_has_ended_as_many_calls(tmp_path: Path) -> None:
    past, going_on, lives = Wanted(UUID(int=2), "r0 there"), FAR, Successors(tmp_path, GOALS)
    async with lives.begun() as (manager, heard):
        manager.begin(past)
        await heard.over.wait()
        manager.begin(going_on)
        for _ in range(2):
            heard.sent.clear()
            await heard.sent.wait()
        before = {status.id: status for status in manager.status()}
        assert (before[past.id].state, before[past.id].reason) == (TaskState.OVER, "the goal holds")
    async with lives.gone_on() as (second, _, heard):
        after = {status.id: status for status in second.manager.status()}
        assert after[past.id] == before[past.id]
        assert (after[past.id].ended, after[going_on.id].ended) == (2, before[going_on.id].ended) == (2, 1)
        assert not heard.endings, "its clients have heard of it"
        with pytest.raises(TaskRefused, match="is over"):
            await second.manager.cancel(past.id)
        await heard.over.wait()
        assert {status.id: status.ended for status in second.manager.status()} == {past.id: 2, going_on.id: 2}


async def test_what_a_task_has_begun_that_means_nothing_any_more_is_recalled_and_its_resources_are_free_then(tmp_path: Path) -> None:
    lives = Successors(tmp_path, GOALS)
    async with lives.begun() as (manager, heard):
        manager.begin(FAR)
        await heard.sent.wait()
    lives.goals = {"r1 there": GOALS["r1 there"]}
    async with lives.gone_on() as (second, replay, heard):
        assert heard.endings[FAR.id].code is Code.INVALID_GOAL
        with pytest.raises(InputError, match="r1 is kept by move"):
            second.manager.begin_anew(lives.problem)
        await asyncio.sleep(1.0)
        assert not replay.resources.held
        second.journal.blocked = "the disk is full"
        with pytest.raises(InputError, match="the disk is full"):
            second.manager.begin_anew(lives.problem)
        second.journal.blocked = ""
        second.manager.begin_anew(lives.problem)
        heard.over.clear()
        second.manager.begin(Wanted(UUID(int=2), "r1 there"))
        await heard.over.wait()


async def test_what_a_request_has_kept_that_was_given_up_is_free_when_its_server_says_that_it_is_over(tmp_path: Path) -> None:
    slow = Faults((Fault("move(r1, a1, a2)", FaultKind.SLOW, ignores_cancel=True),))
    lives = Successors(tmp_path, GOALS, Binding(resources=("{r}",), timeout=2.0, cancel=1.0, retries=0), slow)
    async with lives.begun() as (manager, heard):
        manager.begin(Wanted(UUID(int=1), "r1 there"))
        await heard.given_up.wait()
    async with lives.gone_on() as (_, replay, _):
        (given_up,) = replay.withheld
        assert str(given_up.action) == "move(r1, a1, a2)", "nobody has said yet that it is over"
        freed = asyncio.Event()
        replay.resources.listen(freed.set)
        while replay.resources.given_up:
            await freed.wait()
            freed.clear()
    assert any(isinstance(step.record, EndConfirmed) for step in replay_steps(lives.journal, TASKS, Replay()))


async def test_what_is_sensed_later_is_sensed_in_the_next_process(tmp_path: Path) -> None:
    journal, world = WrittenJournal(JournalFile(tmp_path / "j", 0.0), RECORDS), KnowledgeBase()
    journal.begin(world, Resources())
    world.sense(("at",), lag=2.0)
    world.store({"x": 1})
    world.sense(("open",))
    journal.close()
    after = replayed(tmp_path / "j", RECORDS).world
    assert (after.sensed_names(), after.variables()) == ({"at": 2.0, "open": 0.0}, {"x": 1})


async def test_the_status_says_when_and_why_the_plan_was_replaced_last(tmp_path: Path) -> None:
    lives = Successors(tmp_path, GOALS, Binding(resources=("{r}",), retries=0), Faults((Fault("move", FaultKind.ABORT, times=1),)))
    async with lives.begun() as (manager, heard):
        manager.begin(FAR)
        async with asyncio.timeout(1000.0):
            while not manager.status()[0].replans:
                await heard.sent.wait()
                heard.sent.clear()
        before = manager.status()[0]
        assert before.state is TaskState.RUNNING
        when, _, why = before.reason.partition(" after it came in: ")
        assert re.fullmatch(r"replanned \d+\.\d\d s", when)
        assert why.startswith("the rest of the plan still works: going on with ")
    async with lives.gone_on() as (second, _, heard):
        await heard.sent.wait()
        after = second.manager.status()[0]
        assert (after.state, after.reason) == (TaskState.RUNNING, f"replanned in another process: {why}")
        await heard.over.wait()
