"""Robots that a person takes over and gives back: nothing is sent to them meanwhile, and all goals are reached in the end."""

from __future__ import annotations

import asyncio
from pathlib import Path
from uuid import UUID

import pytest

from planner_bridge.tasks.task_manager import TaskManager
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.core.machine.bindings import Binding
from pnm.journal import journal
from pnm.tasks import Code, TaskRefused, TaskState, Wanted
from tests.support.pddl.problems import fleet
from tests.support.tasks.node import LAZY, USUAL, carry, everything_needs, robots_of, simulated
from tests.support.tasks.scenarios.crash import Survival, survive
from tests.support.tasks.scenarios.random_hands import run_hands
from tests.support.tasks.simulation import TaskSimulation


def reason(simulation: TaskSimulation, task: object) -> str:
    return next(one.reason for one in simulation.master.status() if one.id == task)


@simulated()
async def test_a_robot_that_is_taken_is_cancelled_and_goes_on_when_it_is_given_back(simulation: TaskSimulation):
    task = await simulation.begun("(at r0 a2)")
    assert await simulation.master.take("r0", reason="stuck", by="ada") == ""
    assert not simulation.backend.robots._jobs
    await asyncio.sleep(10_000.0)  # longer than the task may take: its time stands still
    assert len(simulation.sent(task)) == 1
    assert simulation.state(task) is TaskState.RUNNING
    assert reason(simulation, task).startswith("waits: r0 is in the hands of ada since ")
    assert reason(simulation, task).endswith(": stuck")
    await simulation.master.give("r0")
    await simulation.reaches(task)
    assert len(simulation.sent(task)) == 3
    assert len(simulation.seen(task, "planned")) == 1


@pytest.mark.parametrize("chosen", [USUAL, LAZY])
def test_another_robot_takes_its_place(chosen: object):
    @simulated(chosen=chosen)
    async def scenario(simulation: TaskSimulation):
        task = await simulation.begun("(in p0 a2)")
        (first,) = robots_of(simulation, task)
        assert await simulation.master.take(first) == ""
        sent = len(simulation.sent(task))
        await simulation.reaches(task)
        assert not any(first in call for call in simulation.sent(task)[sent:])

    scenario()


@simulated()
async def test_the_other_calls_of_a_task_go_on(simulation: TaskSimulation):
    task = await simulation.begun("(and (at r0 a2) (at r1 a3))")
    await simulation.sees(task, "sent", "r1")
    assert await simulation.master.take("r0") == ""
    assert [str(one.request.action)[:8] for one in simulation.backend.robots._jobs.values()] == ["move(r1,"]
    await simulation.until(lambda: simulation.holds("(at r1 a3)"))
    await asyncio.sleep(1000.0)
    assert not any("r0" in call for call in simulation.sent(task)[2:])
    await simulation.master.give("r0")
    await simulation.reaches(task)


@pytest.mark.parametrize(("text", "is_plan"), [("(and (at r0 a1) (at r1 a2))", False), ("(move r0 a0 a1)\n(move r1 a1 a2)", True)])
@simulated()
async def test_what_a_task_waits_for_is_said_when_the_cancellation_is_confirmed_late(
    simulation: TaskSimulation, monkeypatch: pytest.MonkeyPatch, text: str, is_plan: bool
):
    task = await simulation.begun(text, is_plan=is_plan)
    await simulation.sees(task, "sent", "r1")
    robots, later = simulation.backend.robots, asyncio.get_running_loop().call_later
    with monkeypatch.context() as patch:
        patch.setattr(robots, "cancel", lambda request, at_once=robots.cancel: later(0.5, at_once, request))
        assert await simulation.master.take("r0") == ""
    await simulation.until(lambda: reason(simulation, task).startswith("waits: r0 is in"))
    assert not simulation.holds("(at r1 a2)"), "it is said before anything else makes somebody look at the task again"
    await simulation.master.give("r0")
    await simulation.reaches(task)


@simulated()
async def test_what_the_person_has_done_is_planned_with(simulation: TaskSimulation):
    task = await simulation.begun("(at r0 a2)")
    await simulation.master.take("r0")
    carry(simulation, "r0", "a0", "a3")
    await asyncio.sleep(500.0)
    await simulation.master.give("r0")
    await simulation.reaches(task)
    assert simulation.sent(task)[1:] == ["move(r0, a3, a2)"]


@simulated()
async def test_a_goal_that_needs_the_robot_waits_for_it_and_others_do_not(simulation: TaskSimulation):
    await simulation.master.take("r0", reason="battery")
    task, other = simulation.want("(at r0 a2)"), simulation.want("(at r1 a3)")
    await simulation.reaches(other)
    await asyncio.sleep(10_000.0)
    assert simulation.state(task) is TaskState.QUEUED
    assert "no plan without r0, which is in a person's hands since" in reason(simulation, task)
    await simulation.master.give("r0")
    await simulation.reaches(task)


@simulated()
async def test_a_goal_that_has_no_plan_with_the_robot_either_does_not_wait(simulation: TaskSimulation):
    await simulation.master.take("r0")
    task = simulation.want("(and (at r0 a1) (at r0 a2))")
    await simulation.until(lambda: task in simulation.endings)
    assert "no plan" in simulation.endings[task].message


@simulated()
async def test_what_cannot_be_is_refused_with_a_reason(simulation: TaskSimulation):
    with pytest.raises(TaskRefused, match=r"there is no robot, object or resource 'r00'; did you mean 'r0'\?"):
        await simulation.master.take("r00")
    with pytest.raises(TaskRefused, match="r0 is in nobody's hands"):
        await simulation.master.give("r0")
    await simulation.master.take("r0", by="ada")
    with pytest.raises(TaskRefused, match=r"r0 is in the hands of ada since .*; it has to be given back first"):
        await simulation.master.take("r0")
    with pytest.raises(TaskRefused, match="did you mean 'r1'"):
        await simulation.master.give("r11")
    assert [hand.name for hand in simulation.master.hands()] == ["r0"]
    await simulation.master.give("r0")
    assert simulation.master.hands() == ()


@simulated()
async def test_a_paused_task_leaves_the_robot_to_the_person_when_it_is_resumed(simulation: TaskSimulation):
    task = await simulation.begun("(at r0 a2)")
    await simulation.master.pause(task, at_once=True)
    await simulation.master.take("r0")
    await simulation.master.resume(task)
    await asyncio.sleep(500.0)
    assert len(simulation.sent(task)) == 1
    await simulation.master.pause(task, at_once=False)
    await simulation.master.give("r0")
    await asyncio.sleep(500.0)
    assert len(simulation.sent(task)) == 1
    await simulation.master.resume(task)
    await simulation.reaches(task)


@simulated(
    faults=Faults((Fault("move", FaultKind.HANG, times=1, ignores_cancel=True),)),
    chosen=everything_needs("{r}", move=Binding(resources=("{r}/base",), timeout=100.0, cancel=5.0, retries=0)),
)
async def test_a_cancellation_that_is_not_confirmed_is_said(simulation: TaskSimulation):
    task = await simulation.begun("(at r0 a2)")
    said = await simulation.master.take("r0")
    assert said.startswith("move(r0, ")
    assert "may still be at work: the cancellation is not confirmed" in said
    assert "r0/base is kept by move(r0" in said
    assert [hand.name for hand in simulation.master.hands()] == ["r0"]
    await simulation.master.give("r0")
    await simulation.until(lambda: task in simulation.endings)


@pytest.mark.parametrize("number", range(2))
def test_no_robot_that_a_person_has_begins_with_anything(number: int, tmp_path: Path):
    assert run_hands(number, 12, tmp_path / "journal").begun


@pytest.mark.parametrize(("commit", "longer"), [(commit, (1, 1000)[commit % 2]) for commit in range(8, 32, 3)])
def test_a_robot_stays_with_the_person_when_processes_die(commit: int, longer: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(journal, "_LONGER", longer)
    monkeypatch.setattr(journal, "_SHARE", 0)
    since: list[float] = []
    """When it was taken, once that was answered."""
    told: list[int] = []
    """How many requests the robots had begun with then."""

    async def people(manager: TaskManager, survival: Survival) -> None:
        now = asyncio.get_running_loop().time
        if now() > 100.0:
            return
        if not since:
            await asyncio.sleep(1.0)
            if not manager.hands():  # else the process has died before it could answer
                await manager.take("r0", reason="stuck")
            since.append(manager.hands()[0].since)
            told.append(len(survival.told))
        assert [(hand.name, hand.reason, hand.since) for hand in manager.hands()] == [("r0", "stuck", since[0])]
        await asyncio.sleep(max(0.0, 99.0 - now()))
        assert not [str(action) for _, action in survival.told[told[0] :] if "r0" in action.arguments]
        await asyncio.sleep(2.0)
        await manager.give("r0")

    goals = ("(at r0 a2)", "(in p1 a3)")
    tasks = [Wanted(UUID(int=number + 1), goal) for number, goal in enumerate(goals)]
    survival = survive(fleet(), tasks, USUAL, tmp_path / "journal", [commit] * 4, people=people)
    assert not survival.wrong, survival.wrong
    assert {ending.code for ending in survival.endings.values()} == {Code.GOAL_REACHED}
    assert survival.deaths


@simulated()
async def test_a_plan_by_hand_waits_for_the_robot(simulation: TaskSimulation):
    task = await simulation.begun("(move r0 a0 a1)\n(move r0 a1 a2)", is_plan=True)
    assert await simulation.master.take("r0") == ""
    await asyncio.sleep(1000.0)
    assert reason(simulation, task).startswith("waits: r0 is in a person's hands since ")
    await simulation.master.give("r0")
    await simulation.reaches(task)
    assert simulation.sent(task) == ["move(r0, a0, a1)", "move(r0, a0, a1)", "move(r0, a1, a2)"]
