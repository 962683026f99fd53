"""Long texts and long plans: the event loop goes on while they are read, ordered and proved, so that others are answered meanwhile."""

from __future__ import annotations

import asyncio
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from uuid import UUID

import pytest

from planner_bridge.tasks.task_start import MAX_CALLS
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.core.logic.conditions import Condition
from pnm.errors import InputError
from pnm.tasks import SHORT, Code, TaskState
from tests.support.pddl.problems import fleet
from tests.support.processes import LIMIT
from tests.support.tasks.node import simulated
from tests.support.tasks.simulation import TaskSimulation

FEW = 6
"""Turns of the event loop that pass between two events of a task if it works on the loop itself."""
ROUND_TRIPS = "(move r0 a0 a1)\n(move r0 a1 a0)\n"


@contextmanager
def counted() -> Iterator[Callable[[], int]]:
    """Count the turns of the event loop."""
    turns = 0

    async def count() -> None:
        nonlocal turns
        while True:
            turns += 1
            await asyncio.sleep(0)

    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-4)  # a turn lets the other thread work for so long: with the usual 5 ms, there are 6 turns while it decides
    counting = asyncio.ensure_future(count())
    try:
        yield lambda: turns
    finally:
        counting.cancel()
        sys.setswitchinterval(before)


async def turns_until(simulation: TaskSimulation, task: UUID, kind: str, text: str, times: int = 1) -> int:
    """Return the turns of the event loop until an event of the task."""
    with counted() as turns:
        await simulation.sees(task, kind, text, times)
        return turns()


@simulated()
async def test_the_event_loop_goes_on_while_a_goal_is_read(simulation: TaskSimulation):
    is_free = threading.Event()

    def read(text: str) -> Condition:
        assert is_free.wait(LIMIT), "the event loop waits for the reader"
        return simulation.read(text)

    simulation.master._read_goal = read
    goal = f"(and {'(not (at r0 a2)) ' * SHORT}(at r0 a1))"
    task = simulation.want(goal)
    assert simulation.state(task) is TaskState.QUEUED
    with pytest.raises(InputError, match="there are 1 tasks"):
        simulation.master.begin_anew(simulation.problem)
    is_free.set()
    await simulation.sees(task, "state", "planning")
    assert simulation.master.status()[0].goal == goal
    await simulation.reaches(task)


@simulated()
async def test_the_event_loop_goes_on_while_a_plan_is_ordered_and_proved(simulation: TaskSimulation):
    task = simulation.want(ROUND_TRIPS * 50, is_plan=True)
    await simulation.sees(task, "planned")
    assert await turns_until(simulation, task, "state", "running") > FEW
    await simulation.master.cancel(task)


@simulated()
async def test_a_task_whose_machine_is_being_made_can_be_cancelled(simulation: TaskSimulation):
    task = simulation.want(ROUND_TRIPS * (MAX_CALLS // 2), is_plan=True)
    await simulation.sees(task, "planned")
    for _ in range(10):
        await asyncio.sleep(0)
    await simulation.master.cancel(task)
    assert not simulation.seen(task, "state", "running")
    assert await simulation.ended_with(task) == [Code.CANCELLED]


@simulated(fleet(places=200), faults=Faults((Fault("move(r0, a0, a1)", FaultKind.ABORT),)))
async def test_the_event_loop_goes_on_while_it_is_decided_what_follows_a_failure(simulation: TaskSimulation):
    task = simulation.want("(at r0 a99)")
    await simulation.sees(task, "failed")
    assert await turns_until(simulation, task, "replanned", "") > FEW
    assert await turns_until(simulation, task, "sent", "", 2) > FEW
    await simulation.reaches(task)


@simulated()
async def test_what_is_read_may_be_cancelled_and_what_is_wrong_with_it_ends_the_task(simulation: TaskSimulation):
    cancelled = simulation.want(f"{ROUND_TRIPS * 200}", is_plan=True)
    await simulation.master.cancel(cancelled)
    wrong = simulation.want("nonsense" * SHORT)
    assert await simulation.ended_with(cancelled, wrong) == [Code.CANCELLED, Code.INVALID_GOAL]
    assert "not a goal" in simulation.endings[wrong].message
