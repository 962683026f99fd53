"""Runs that are held while their plans are looked at again: what happens meanwhile, and that they are never held for ever."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path
from uuid import UUID

import pytest

from planner_bridge.explanations.history import JournalHistory
from planner_bridge.explanations.run_questions import why_now
from planner_bridge.tasks.control import STILL
from planner_bridge.tasks.plan_execution import PlanExecution
from planner_bridge.tasks.result import TASKS
from planner_bridge.view.follow import Reader
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.core.machine.bindings import Binding, Bindings
from pnm.executor import Executor
from pnm.journal.records import TaskEntered, TaskOver
from pnm.journal.replay import Replay, words
from pnm.journal.resume import replay_steps
from pnm.tasks import Code, TaskRefused, TaskState, TraceKind
from tests.support.pddl.problems import fleet
from tests.support.tasks.node import EAGER, simulated
from tests.support.tasks.scenarios.random_holds import run_holds
from tests.support.tasks.scenarios.slow_work import SlowLoop, slow_backend
from tests.support.tasks.simulation import TaskSimulation, simulate_tasks


@pytest.mark.parametrize("work", [0.0, 0.3, 0.4, 0.7, 1.5, 3.0], ids=lambda seconds: f"work takes {seconds:g} s")
def test_a_call_that_fails_while_its_run_is_held_is_tried_again(work: float) -> None:
    """After the hold, while there is a new plan, while it is searched for, while the world is asked, or before the hold."""
    settings = replace(EAGER, bindings=Bindings({"move": Binding(retries=1)}))
    failing = Faults((Fault("move", FaultKind.ABORT, times=1),))

    async def scenario(simulation: TaskSimulation) -> None:
        task = await simulation.begun("(at r0 a2)")
        await asyncio.sleep(1.0)  # a call fails when half of its time is over, which is 4 s
        over = simulation.sent(task)[0].removesuffix(")")[-2:]
        closed = {("way", over, "a2"): False}
        simulation.backend.robots.world.change(closed)
        simulation.knowledge.update(closed)  # no sensor tells of ways; a person does
        await simulation.reaches(task)
        assert simulation.ended_at(task) < 100.0

    simulate_tasks(
        scenario, fleet(3), faults=failing, chosen=settings, make_backend=slow_backend(lambda: work), loop=lambda: SlowLoop(lambda: work)
    )


BROKEN = {
    2: "a call failed while the world was asked about",
    18: "a match that was out waited for the mending by its light, which was to be tried again",
    56: "a call failed while there was no new plan yet",
    81: "what was under way did not fit into the rest of its plan",
    1245: "two tasks, whose plans were searched for at the same time, waited for each other",
    371: "requests that were out in another order than their calls went to the wrong calls of the next run",
}
"""Scripts that went wrong once; in the first ones a task hung for ever."""


@pytest.mark.parametrize("number", BROKEN)
def test_a_task_that_nobody_pauses_makes_progress(number: int) -> None:
    run_holds(number)


# --- the watchdog, in a copy of what is that never comes to rest ---


async def for_ever(_: object) -> bool:
    await asyncio.Event().wait()
    return True


async def until_it_ends(executor: Executor) -> bool:
    while not executor.ended:
        await executor.happens()
    return False


@pytest.mark.parametrize(
    ("where", "at_rest"), [(Executor, until_it_ends), (PlanExecution, for_ever)], ids=["it ends in order", "it is left alone"]
)
def test_a_task_that_stands_still_all_the_same_is_ended_with_its_name(
    where: type, at_rest: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(where, "at_rest", at_rest)

    async def scenario(simulation: TaskSimulation) -> None:
        task = await simulation.begun("(at r0 a2)")
        await asyncio.sleep(1.0)
        simulation.knowledge.update({("way", simulation.sent(task)[0].removesuffix(")")[-2:], "a2"): False})
        assert await simulation.ended_with(task) == [Code.ERROR]
        said = simulation.endings[task].message
        assert said.startswith("it stands still: for 60 s nothing has happened to it, although it waits for nothing")
        assert simulation.ended_at(task) < 4.0 + 3.0 * STILL

    with pytest.raises(AssertionError, match="stands still"):  # which is logged as an error
        simulate_tasks(scenario, fleet(3), chosen=EAGER, journal=tmp_path / "journal")
    (over,) = [step.record for step in replay_steps(tmp_path / "journal", TASKS, Replay()) if isinstance(step.record, TaskOver)]
    assert over.ending.code is Code.ERROR
    assert "it stands still" in over.ending.message


@simulated(chosen=EAGER)
async def test_who_is_paused_asked_or_waits_for_others_does_not_stand_still(simulation: TaskSimulation) -> None:
    first = await simulation.begun("(at r0 a2)")
    other = simulation.want("(at r0 a3)")
    await simulation.sees(other, "state", "waits for")
    await simulation.master.pause(first, at_once=False)
    await asyncio.sleep(20.0 * STILL)
    assert simulation.state(first) is TaskState.PAUSED
    await simulation.master.resume(first)
    await simulation.ended_with(first, other)


def told(simulation: TaskSimulation, task: UUID, journal: Path) -> list[tuple[str, str]]:
    """The state of a task, and why: by its status, the page, and `pnm why` of a call that waits."""
    status = next(one for one in simulation.master.status() if one.id == task)
    shown = Reader(journal).newest().tasks[task.hex]
    history = JournalHistory.read(journal)
    run = history.tasks[task].runs[-1]
    why = " ".join(reason.statement for reason in why_now(history, history.tasks[task], run, len(run.source.plan.calls) - 1).reasons)
    return [(status.state.word, status.reason), (shown["state"], shown["reason"]), ("", why)]


def test_one_state_of_a_task_is_told_by_all_while_it_is_held_and_while_it_is_paused(tmp_path: Path) -> None:
    journal = tmp_path / "journal"

    async def scenario(simulation: TaskSimulation) -> None:
        task = await simulation.begun("(at r0 a2)")
        first = simulation.sent(task)[0]
        await asyncio.sleep(1.0)
        simulation.knowledge.update({("way", first.removesuffix(")")[-2:], "a2"): False})
        await asyncio.sleep(1.0)  # the world is being asked
        status, page, why = told(simulation, task, journal)
        assert (status, page) == (("running", ""), ("running", f"{first} runs"))
        assert "nothing begins while its plan is checked again" in why[1]
        assert "paused" not in why[1]
        with pytest.raises(TaskRefused, match=f"the task {task} is not paused: it is running"):
            await simulation.master.resume(task)
        await simulation.sees(task, "state", "replanning")
        await asyncio.sleep(0.1)  # after which it is kept
        status, page, _ = told(simulation, task, journal)
        assert status == page
        assert "would start although" in status[1]
        await simulation.master.pause(task, at_once=True)
        status, page, why = told(simulation, task, journal)
        assert (status, page) == (("paused", "paused on request"),) * 2
        assert "its task is paused: paused on request" in why[1]
        await simulation.master.resume(task)
        await simulation.reaches(task)

    slow = {"make_backend": slow_backend(lambda: 2.0), "loop": lambda: SlowLoop(lambda: 2.0)}
    simulate_tasks(scenario, fleet(3), chosen=EAGER, journal=journal, **slow)  # type: ignore[arg-type]


@pytest.mark.parametrize("number", range(200, 202))
def test_the_journal_has_the_states_that_tasks_have_told(number: int, tmp_path: Path) -> None:
    happened = run_holds(number, journal=tmp_path / "journal")
    said = [f"{event.task.hex[:8]} is {event.text}" for event in happened if event.kind is TraceKind.STATE]
    steps = [*replay_steps(tmp_path / "journal", TASKS, Replay())]
    entered = [words(step, Replay())[0] for step in steps if isinstance(step.record, TaskEntered)]
    assert entered == [text for text in said if " is over" not in text]
