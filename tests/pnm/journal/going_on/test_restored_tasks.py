"""Tasks in the next process: paused ones send nothing, those that have begun go on first, and none leaves its robot unwatched."""

from __future__ import annotations

import asyncio
import re
from pathlib import Path
from uuid import UUID

import pytest

from planner_bridge.model.world import simulated_backend
from planner_bridge.tasks.settings import Settings
from planner_bridge.tasks.task_manager import TaskLimits
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.clock import run_async
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.resources import Resources
from pnm.errors import InputError
from pnm.journal.codec import RECORDS
from pnm.journal.journal import WrittenJournal
from pnm.journal.replay import Replay
from pnm.journal.resume import replayed
from pnm.journal.store import Durability, JournalFile
from pnm.language.plan import parse_plans
from pnm.language.runner import Program
from pnm.tasks import Code, TaskEnding, TaskListener, TaskRefused, TaskState, TraceEvent, TraceKind, Wanted
from tests.support.pddl.problems import fleet
from tests.support.tasks.scenarios.successors import Process, Successors

SETTINGS = Settings(improve=0.0, bindings=Bindings({"move": Binding(resources=("{r}",))}))
GOALS = {"r1 there": ("at", "r1", "a2"), "r1 far": ("at", "r1", "a3"), "r0 there": ("at", "r0", "a2")}
ROUND = """
actions: {move: {params: [r, from, to], duration: 4}}
plan: [move: {r: r1, from: a1, to: a2}, move: {r: r1, from: a2, to: a3}]
"""


class Heard(TaskListener):
    """A listener that notes what is sent, and how tasks end."""

    def __init__(self) -> None:
        self.sent = asyncio.Event()
        self.endings: dict[UUID, TaskEnding] = {}
        self.over = asyncio.Event()

    def happened(self, event: TraceEvent) -> None:
        if event.kind is TraceKind.SENT:
            self.sent.set()

    def ended(self, task: UUID, ending: TaskEnding) -> None:
        self.endings[task] = ending
        self.over.set()


async def first_process(processes: Successors) -> tuple[Process, Heard]:
    """The first process, and what is heard of its tasks."""
    process, heard = await processes.first(), Heard()
    process.manager.listen(heard)
    return process, heard


async def next_process(processes: Successors) -> tuple[Process, Replay, Heard]:
    """The next process, which goes on with what the replay has, and what is heard of its tasks."""
    (process, replay), heard = await processes.next(), Heard()
    process.manager.listen(heard)
    process.manager.restore(replay)
    return process, replay, heard


def test_a_plan_that_was_paused_sends_nothing_in_the_next_process_before_it_is_resumed(tmp_path: Path) -> None:
    problem, task = fleet(robots=2), Wanted(UUID(int=1), "round", is_plan=True)
    (plan,) = parse_plans(ROUND).values()

    async def main() -> None:
        robots = simulated_backend(problem, SETTINGS.bindings)
        processes = Successors(problem, SETTINGS, robots, tmp_path / "journal", programs={"round": Program.of(plan)})
        first, heard = await first_process(processes)
        first.manager.begin(task)
        await heard.sent.wait()
        await first.manager.pause(task.id, at_once=False)
        await first.die()

        second, _, heard = await next_process(processes)
        await asyncio.sleep(100.0)
        assert second.link.sent == []
        await second.manager.resume(task.id)
        await heard.over.wait()
        assert [action.partition("(")[0] for action in second.link.sent] == ["move"]
        assert heard.endings[task.id].code is Code.GOAL_REACHED
        await second.manager.close()
        second.journal.close()

    run_async(main(), virtual=True)


def test_a_task_that_was_paused_because_its_node_was_inactive_goes_on_in_the_next_process(tmp_path: Path) -> None:
    problem, task = fleet(robots=2), Wanted(UUID(int=1), "r1 far")

    async def main() -> None:
        robots = simulated_backend(problem, SETTINGS.bindings)
        processes = Successors(problem, SETTINGS, robots, tmp_path / "journal", GOALS)
        first, heard = await first_process(processes)
        first.manager.begin(task)
        await heard.sent.wait()
        await first.manager.pause(None, at_once=True, is_kept=False)
        await first.die()

        second, _, heard = await next_process(processes)
        async with asyncio.timeout(1000.0):
            await heard.over.wait()
        assert heard.endings[task.id].code is Code.GOAL_REACHED
        await second.manager.close()
        second.journal.close()

    run_async(main(), virtual=True)


def test_a_task_that_has_begun_goes_on_before_those_of_higher_priority_that_waited(tmp_path: Path) -> None:
    problem, begun, waiting = fleet(robots=2), Wanted(UUID(int=1), "r1 far"), Wanted(UUID(int=2), "r1 there", priority=5)

    async def main() -> None:
        robots = simulated_backend(problem, SETTINGS.bindings)
        processes = Successors(problem, SETTINGS, robots, tmp_path / "journal", GOALS, limits=TaskLimits(active=1))
        first, heard = await first_process(processes)
        first.manager.begin(begun)
        await heard.sent.wait()
        first.manager.begin(waiting)
        await first.die()

        second, _, heard = await next_process(processes)
        async with asyncio.timeout(1000.0):
            while len(heard.endings) < 2:
                heard.over.clear()
                await heard.over.wait()
        assert {ending.code for ending in heard.endings.values()} == {Code.GOAL_REACHED}
        assert [*heard.endings] == [begun.id, waiting.id]
        await second.manager.close()
        second.journal.close()

    run_async(main(), virtual=True)


def test_a_task_that_was_over_is_over_in_the_next_process_and_one_that_goes_on_has_ended_as_many_calls(tmp_path: Path) -> None:
    problem, past, going_on = fleet(robots=2), Wanted(UUID(int=1), "r0 there"), Wanted(UUID(int=2), "r1 far")

    async def main() -> None:
        robots = simulated_backend(problem, SETTINGS.bindings)
        processes = Successors(problem, SETTINGS, robots, tmp_path / "journal", GOALS)
        first, heard = await first_process(processes)
        first.manager.begin(past)
        await heard.over.wait()
        first.manager.begin(going_on)
        for _ in range(2):
            heard.sent.clear()
            await heard.sent.wait()
        before = {status.id: status for status in first.manager.status()}
        assert (before[past.id].state, before[past.id].reason) == (TaskState.OVER, "the goal holds")
        await first.die()

        second, _, heard = await next_process(processes)
        after = {status.id: status for status in second.manager.status()}
        assert after[past.id] == before[past.id]
        assert (after[past.id].ended, after[going_on.id].ended) == (2, before[going_on.id].ended) == (2, 1)
        assert not heard.endings, "its clients have heard of it"
        with pytest.raises(TaskRefused, match="is over"):
            await second.manager.cancel(past.id)
        await heard.over.wait()
        assert {status.id: status.ended for status in second.manager.status()} == {past.id: 2, going_on.id: 2}
        await second.manager.close()
        second.journal.close()

    run_async(main(), virtual=True)


def test_what_a_task_has_begun_that_means_nothing_any_more_is_recalled_and_its_resources_are_free_then(tmp_path: Path) -> None:
    problem, task, later = fleet(robots=2), Wanted(UUID(int=1), "r1 far"), Wanted(UUID(int=2), "r1 there")

    async def main() -> None:
        robots = simulated_backend(problem, SETTINGS.bindings)
        processes = Successors(problem, SETTINGS, robots, tmp_path / "journal", GOALS)
        first, heard = await first_process(processes)
        first.manager.begin(task)
        await heard.sent.wait()
        await first.die()

        processes.goals = {"r1 there": GOALS["r1 there"]}
        second, replay, heard = await next_process(processes)
        assert heard.endings[task.id].code is Code.INVALID_GOAL
        with pytest.raises(InputError, match="r1 is kept by move"):
            second.manager.begin_anew(problem)
        await asyncio.sleep(1.0)
        assert not replay.resources.held
        second.journal.blocked = "the disk is full"
        with pytest.raises(InputError, match="the disk is full"):
            second.manager.begin_anew(problem)
        second.journal.blocked = ""
        second.manager.begin_anew(problem)
        heard.over.clear()
        second.manager.begin(later)
        await heard.over.wait()
        await second.manager.close()
        second.journal.close()

    run_async(main(), virtual=True)


def test_what_is_sensed_later_is_sensed_in_the_next_process(tmp_path: Path) -> None:
    async def main() -> None:
        journal, world = WrittenJournal(JournalFile(tmp_path / "journal", Durability.PROCESS_CRASH, 0.0), RECORDS), KnowledgeBase()
        journal.begin(world, Resources())
        world.sense(("at",), lag=2.0)
        world.store({"x": 1})
        world.sense(("open",))
        journal.close()

    run_async(main(), virtual=True)
    after = replayed(tmp_path / "journal", RECORDS).world
    assert (after.sensed_names(), after.variables()) == ({"at": 2.0, "open": 0.0}, {"x": 1})


def test_the_status_says_when_and_why_the_plan_was_replaced_last(tmp_path: Path) -> None:
    problem, task = fleet(robots=2), Wanted(UUID(int=1), "r1 far")
    once = Settings(improve=0.0, bindings=Bindings({"move": Binding(resources=("{r}",), retries=0)}))

    async def main() -> None:
        robots = simulated_backend(problem, once.bindings, Faults((Fault("move", FaultKind.ABORT, times=1),)))
        processes = Successors(problem, once, robots, tmp_path / "journal", GOALS)
        first, heard = await first_process(processes)
        first.manager.begin(task)
        async with asyncio.timeout(1000.0):
            while not first.manager.status()[0].replans:
                await heard.sent.wait()
                heard.sent.clear()
        before = first.manager.status()[0]
        assert before.state is TaskState.RUNNING
        when, _, why = before.reason.partition(" after it came in: ")
        assert re.fullmatch(r"replanned \d+\.\d\d s", when)
        assert why.startswith("the rest of the plan still works: going on with ")
        await first.die()

        second, _, heard = await next_process(processes)
        await heard.sent.wait()
        after = second.manager.status()[0]
        assert (after.state, after.reason) == (TaskState.RUNNING, f"replanned in another process: {why}")
        async with asyncio.timeout(1000.0):
            await heard.over.wait()
        await second.manager.close()
        second.journal.close()

    run_async(main(), virtual=True)
