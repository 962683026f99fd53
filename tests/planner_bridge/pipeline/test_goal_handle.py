"""GoalHandles: a goal on the event loop that is running, awaited, paused, resumed and stopped."""

from __future__ import annotations

import asyncio

import pytest

from planner_bridge.model.world import simulated_backend
from planner_bridge.pipeline.achieve import achieve, achieve_async
from planner_bridge.pipeline.goal_handle import GoalHandle
from planner_bridge.tasks.result import Stopwatch
from planner_bridge.tasks.settings import Settings, TaskObserver
from pnm.core.machine.plan_graph import ActionCall
from pnm.core.machine.requests import Request
from pnm.errors import InputError
from pnm.tasks import Code, TaskState
from tests.support.pddl.problems import rooms
from tests.support.runs.simulated import in_virtual_time, on_a_loop


class Starts(TaskObserver):
    """Notes which calls start, and lets somebody wait for the first."""

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.has_begun = asyncio.Event()

    def sent(self, call: ActionCall, request: Request, now: float) -> None:
        self.calls.append(str(call.action))
        self.has_begun.set()


def begun(observer: TaskObserver) -> GoalHandle:
    problem = rooms(goal="(at r1 c)", ways="ab bc")
    return GoalHandle(simulated_backend(problem, Settings().bindings), problem, Settings(), observer, Stopwatch()).begin()


def test_inside_of_an_event_loop_achieve_says_what_to_use_and_outside_pursue_does() -> None:
    async def cell() -> None:
        with pytest.raises(InputError, match=r"an event loop is running here: `await planner_bridge\.achieve_async\(\.\.\.\)`"):
            achieve(None, rooms())

    asyncio.run(cell())
    with pytest.raises(InputError, match="no event loop is running here: call `achieve`"):
        achieve_async(None, rooms())


@on_a_loop
async def test_a_goal_is_awaited_in_a_cell_of_a_notebook() -> None:
    handle = achieve_async(None, rooms(goal="(at r1 a)"))
    assert (await handle).goal_reached
    assert (await handle).goal_reached, "once more"
    assert repr(handle) == "<GoalHandle of (at r1 a): over>"


@in_virtual_time
async def test_a_goal_is_stopped_and_what_is_under_way_cancelled() -> None:
    observer = Starts()
    handle = begun(observer)
    await observer.has_begun.wait()
    assert handle.state is TaskState.RUNNING
    result = await handle.stop()
    assert (result.code, [str(call.outcome) for call in result.calls]) == (Code.CANCELLED, ["canceled", "skipped"])
    assert handle.state is TaskState.OVER


@in_virtual_time
async def test_a_goal_that_is_paused_starts_nothing_until_it_goes_on() -> None:
    observer = Starts()
    handle = begun(observer)
    await observer.has_begun.wait()
    await handle.pause()
    assert handle.state is TaskState.PAUSED
    await asyncio.sleep(1000.0)
    assert observer.calls == ["move(r1, a, b)"]
    await handle.resume()
    assert (await handle).goal_reached
    assert observer.calls == ["move(r1, a, b)", "move(r1, b, c)"]


@in_virtual_time
async def test_who_gives_up_waiting_does_not_stop_the_goal_handle() -> None:
    async def waited() -> None:
        await handle

    handle = begun(Starts())
    with pytest.raises(TimeoutError):
        await asyncio.wait_for(asyncio.ensure_future(waited()), 0.001)
    assert (await handle).goal_reached
