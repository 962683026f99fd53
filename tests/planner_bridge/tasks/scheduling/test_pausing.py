"""Tasks that are paused and resumed."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from uuid import UUID

import pytest

from planner_bridge.tasks.replanning import Limits
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.core.machine.bindings import Binding
from pnm.tasks import Code, OnConflict, TaskState
from tests.support.pddl.problems import fleet
from tests.support.tasks.node import USUAL, carry, everything_needs, robots_of, simulated
from tests.support.tasks.simulation import TaskSimulation


@simulated()
async def test_a_task_that_is_paused_at_a_safe_point_goes_on_where_it_was(simulation: TaskSimulation):
    task = await simulation.begun("(at r0 a2)")
    await simulation.master.pause(task, at_once=False)
    assert simulation.state(task) is TaskState.PAUSED
    assert [len(simulation.seen(task, kind)) for kind in ("sent", "ended")] == [1, 1]
    await asyncio.sleep(100.0)
    assert len(simulation.sent(task)) == 1
    await simulation.master.resume(task)
    await simulation.reaches(task)
    assert len(simulation.sent(task)) == 2
    assert len(simulation.seen(task, "planned")) == 1


@simulated()
async def test_a_task_that_is_paused_at_once_begins_its_call_anew(simulation: TaskSimulation):
    task = await simulation.begun("(at r0 a2)")
    await simulation.master.pause(task, at_once=True)
    assert simulation.state(task) is TaskState.PAUSED
    assert "canceled" in simulation.seen(task, "ended")[0].text
    await simulation.master.resume(task)
    await simulation.reaches(task)
    assert len(simulation.sent(task)) == 3


@simulated()
async def test_a_task_whose_plan_does_not_work_any_more_after_a_pause_finds_another_way(simulation: TaskSimulation):
    task = await simulation.begun("(at r0 a2)")
    await simulation.master.pause(task, at_once=True)
    carry(simulation, "r0", "a0", "a3")
    await simulation.master.resume(task)
    await simulation.reaches(task)
    assert simulation.sent(task)[1:] == ["move(r0, a3, a2)"]


async def resumed_beside(simulation: TaskSimulation, goal: str, other: str, **how: object) -> tuple[UUID, UUID]:
    """Have a task be resumed when another one has begun with what is in conflict with it."""
    task = await simulation.begun(goal, **how)
    await simulation.master.pause(task, at_once=False)
    newcomer = await simulation.begun(other)
    assert not simulation.seen(newcomer, "state", "waits"), "what is paused keeps nobody waiting"
    await simulation.master.resume(task)
    return task, newcomer


@pytest.mark.parametrize(("goal", "how"), [("(at r0 a3)", {}), ("(move r0 a0 a1)\n(move r0 a1 a2)\n(move r0 a2 a3)", {"is_plan": True})])
@simulated(fleet(places=8))
async def test_a_task_that_is_resumed_waits_for_those_that_have_begun_meanwhile_what_is_in_its_way(
    simulation: TaskSimulation, goal: str, how: dict[str, object]
):
    task, newcomer = await resumed_beside(simulation, goal, "(and (has r0 p1) (at r0 a1))", **how)
    await simulation.sees(task, "state", "queued: waits for")
    count = len(simulation.sent(task))
    await simulation.reaches(newcomer)
    assert len(simulation.sent(task)) == count, "nothing of it began meanwhile"
    assert not simulation.seen(newcomer, "failed")
    await simulation.reaches(task)


@simulated(fleet(places=8))
async def test_a_task_that_is_resumed_plans_around_those_that_have_begun_meanwhile(simulation: TaskSimulation):
    task, newcomer = await resumed_beside(simulation, "(in p1 a7)", "(and (at r1 a4) (has r1 p3))")
    await simulation.reaches(task, newcomer)
    assert not simulation.seen(task, "failed")
    assert not simulation.seen(newcomer, "failed")
    assert robots_of(simulation, newcomer) == {"r1"}
    assert simulation.sent(task)[-1].startswith("drop(r0")


@simulated(fleet(places=8))
async def test_a_task_that_is_resumed_is_refused_beside_others_if_that_is_the_policy(simulation: TaskSimulation):
    task, newcomer = await resumed_beside(simulation, "(at r0 a3)", "(and (has r0 p1) (at r0 a1))", on_conflict=OnConflict.REFUSE)
    assert await simulation.ended_with(task, newcomer) == [Code.CONFLICT, Code.GOAL_REACHED]
    assert "which the other" in simulation.endings[task].message


@simulated(fleet(places=8))
async def test_those_of_lower_priority_make_way_for_a_task_that_is_resumed(simulation: TaskSimulation):
    task, newcomer = await resumed_beside(simulation, "(at r0 a3)", "(and (has r0 p1) (at r0 a1))", priority=1)
    await simulation.ended_with(task)
    assert newcomer not in simulation.endings
    assert simulation.seen(newcomer, "conflict", "makes way")
    await simulation.reaches(task, newcomer)


@simulated(fleet(places=8))
async def test_a_plan_by_hand_that_was_to_make_room_goes_on_when_nobody_needs_that_any_more(simulation: TaskSimulation):
    task = await simulation.begun("(move r0 a0 a1)\n(move r0 a1 a2)\n(move r0 a2 a3)", is_plan=True)
    first = asyncio.ensure_future(simulation.master.pause(task, at_once=False))
    await simulation.sees(task, "state", "pausing")
    newcomer = simulation.want("(and (at r1 a4) (not (at r0 a2)))")  # the call under way is not in its way, those after it are
    await simulation.sees(newcomer, "planned")
    await simulation.master.resume(task)
    await asyncio.sleep(0.1)
    second = asyncio.ensure_future(simulation.master.pause(task, at_once=False))
    await simulation.master.cancel(newcomer)
    assert not simulation.seen(task, "ended"), "its first call is still under way"
    await simulation.master.resume(task)
    await asyncio.gather(first, second)
    await simulation.reaches(task)


@pytest.mark.parametrize("at_once", [False, True])
@simulated(fleet(places=8), chosen=replace(USUAL, limits=Limits(seconds=20.0)))
async def test_a_pause_does_not_use_up_the_time_of_the_task(simulation: TaskSimulation, at_once: bool):
    task = await simulation.begun("(at r0 a4)")
    for _ in range(2):
        await simulation.master.pause(task, at_once=at_once)
        await asyncio.sleep(100.0)
        await simulation.master.resume(task)
    await simulation.reaches(task)


@simulated(fleet(places=8), chosen=replace(USUAL, limits=Limits(seconds=20.0)))
async def test_a_pause_gives_the_task_no_more_time_than_it_had(simulation: TaskSimulation):
    task = simulation.want("(at r0 a4)")
    await simulation.sees(task, "ended")
    await simulation.master.pause(task, at_once=False)
    await asyncio.sleep(100.0)
    simulation.backend.robots.faults = Faults((Fault("move", FaultKind.HANG),))
    resumed = asyncio.get_running_loop().time()
    await simulation.master.resume(task)
    assert await simulation.ended_with(task) == [Code.TIMED_OUT]
    assert simulation.endings[task].message == "the limit of 20 s is reached"
    assert 15.0 < asyncio.get_running_loop().time() - resumed < 20.0, "what it used before the pause counts"


@simulated()
async def test_a_paused_task_can_be_cancelled_and_misses_its_deadline(simulation: TaskSimulation):
    one, two = simulation.want("(at r0 a2)"), simulation.want("(at r1 a3)", deadline=50.0)
    await simulation.sees(one, "sent")
    await simulation.master.pause(None, at_once=False)
    await simulation.master.cancel(one)
    assert await simulation.ended_with(one, two) == [Code.CANCELLED, Code.DEADLINE_MISSED]


@simulated()
async def test_what_comes_while_all_is_paused_waits(simulation: TaskSimulation):
    await simulation.master.pause(None, at_once=False)
    task = simulation.want("(at r0 a2)")
    await asyncio.sleep(100.0)
    assert not simulation.sent(task)
    await simulation.master.resume(None)
    await simulation.reaches(task)


@simulated(
    faults=Faults((Fault("move(r0, a0, a1)", FaultKind.HANG, ignores_cancel=True),)),
    chosen=everything_needs("{r}", move=Binding(resources=("{r}",), retries=0, cancel=2.0)),
)
async def test_a_task_that_a_pause_leaves_without_a_plan_keeps_nobody_waiting(simulation: TaskSimulation):
    paused = await simulation.begun("(at r0 a1)")
    await simulation.master.pause(paused, at_once=True)
    await simulation.sees(paused, "replanned")  # its server has not confirmed that it has stopped
    for goal in ("(at r1 a2)", "(at r1 a1)"):
        await simulation.reaches(simulation.want(goal))


@pytest.mark.parametrize("at_once", [False, True])
@simulated()
async def test_a_resumption_at_the_moment_of_a_pause_lets_the_task_go_on(simulation: TaskSimulation, at_once: bool):
    task = await simulation.begun("(at r0 a2)")
    pausing = asyncio.ensure_future(simulation.master.pause(task, at_once=at_once))
    await asyncio.sleep(0)
    await simulation.master.resume(task)
    await pausing
    await simulation.reaches(task)


@simulated()
async def test_a_task_that_is_paused_while_it_plans_stays_so_and_plans_afresh(simulation: TaskSimulation):
    task = simulation.want("(at r0 a2)")
    await simulation.until(lambda: simulation.seen(task, "state", "planning"))
    await simulation.master.pause(task, at_once=False)
    await asyncio.sleep(100.0)
    assert simulation.state(task) is TaskState.PAUSED
    assert not simulation.seen(task, "planned")
    carry(simulation, "r0", "a0", "a3")
    await simulation.master.resume(task)
    await simulation.reaches(task)
    assert simulation.sent(task) == ["move(r0, a3, a2)"]
