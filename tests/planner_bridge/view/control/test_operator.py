"""What an operator does besides pausing: a step of a paused task, and saying how a request ends."""

from __future__ import annotations

import asyncio
from uuid import UUID, uuid4

import pytest

from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.tasks import TaskRefused, TaskState
from tests.support.pddl.problems import fleet
from tests.support.tasks.node import carry, robots_of, simulated
from tests.support.tasks.simulation import TaskSimulation


@simulated()
async def test_a_step_lets_one_request_leave_and_the_task_is_paused_again(simulation: TaskSimulation):
    task = await simulation.begun("(at r0 a2)")
    for id, why in ((task, "not paused on request"), (uuid4(), "there is no task")):
        with pytest.raises(TaskRefused, match=why):
            await simulation.master.step(id)
    await simulation.master.pause(task, at_once=True)
    stepping = asyncio.ensure_future(simulation.master.step(task))
    await asyncio.sleep(0.5)
    assert simulation.state(task) is TaskState.PAUSING, "what is under way is not hidden from others"
    assert len(simulation.sent(task)) == 2
    with pytest.raises(TaskRefused, match="only a task that is paused"):
        await simulation.master.step(task)
    await stepping
    assert simulation.state(task) is TaskState.PAUSED
    await asyncio.sleep(100.0)
    assert len(simulation.sent(task)) == 2
    await simulation.master.step(task)  # the last one
    await simulation.reaches(task)


@simulated()
async def test_a_plan_that_does_not_work_any_more_makes_no_step(simulation: TaskSimulation):
    task = await simulation.begun("(at r0 a2)")
    await simulation.master.pause(task, at_once=True)
    carry(simulation, "r0", "a0", "a3")
    with pytest.raises(TaskRefused, match="does not work any more"):
        await simulation.master.step(task)
    assert len(simulation.sent(task)) == 1
    await simulation.master.resume(task)
    await simulation.reaches(task)


@simulated(fleet(places=8))
async def test_a_plan_that_is_in_conflict_with_what_others_do_makes_no_step(simulation: TaskSimulation):
    task = await simulation.begun("(at r0 a3)")
    await simulation.master.pause(task, at_once=False)
    other = await simulation.begun("(and (has r0 p1) (at r0 a1))")
    count = len(simulation.sent(task))
    with pytest.raises(TaskRefused, match="is in conflict with"):
        await simulation.master.step(task)
    assert len(simulation.sent(task)) == count
    await simulation.reaches(other)
    await simulation.master.resume(task)
    await simulation.reaches(task)


@simulated(fleet(places=8))
async def test_a_goal_that_comes_during_a_step_respects_it(simulation: TaskSimulation):
    task = await simulation.begun("(at r0 a3)")
    await simulation.master.pause(task, at_once=True)
    stepping = asyncio.ensure_future(simulation.master.step(task))
    await asyncio.sleep(0.5)
    assert simulation.state(task) is TaskState.PAUSING
    other = await simulation.begun("(at r0 a0)")
    await stepping
    await simulation.reaches(other)
    assert not simulation.seen(other, "failed")
    assert not simulation.seen(task, "failed")
    assert robots_of(simulation, other) == {"r0"}


# --- how a request ends, because a person says so ------------------------------------------------


def open_request(simulation: TaskSimulation, task: UUID) -> UUID:
    """The only request of a task that is under way."""
    execution = simulation.master._tasks[task].control.execution
    assert execution is not None
    (request,) = execution.executor.run.open_requests
    return request


HANGS = Faults((Fault("move", FaultKind.HANG, times=1),))


@simulated(faults=HANGS)
async def test_what_has_failed_because_a_person_says_so_is_tried_again_when_its_server_has_let_go(simulation: TaskSimulation):
    task = await simulation.begun("(at r0 a1)")
    await asyncio.sleep(1.0)
    simulation.master.settle(open_request(simulation, task), is_done=False)
    await simulation.reaches(task)
    ended, again = simulation.seen(task, "ended")
    assert "a person says that it has failed; its server said: canceled" in ended.text
    assert "succeeded" in again.text


@simulated(faults=HANGS)
async def test_what_is_done_because_a_person_says_so_is_not_done_again(simulation: TaskSimulation):
    task = await simulation.begun("(at r0 a1)")
    await asyncio.sleep(1.0)
    request = open_request(simulation, task)
    carry(simulation, "r0", "a0", "a1")
    simulation.master.settle(request, is_done=True)
    await simulation.reaches(task)
    (ended,) = simulation.seen(task, "ended")
    assert "a person says that it is done; its server said: canceled" in ended.text
    with pytest.raises(TaskRefused, match="under way"):
        simulation.master.settle(request, is_done=True)
