"""Tasks that clients cancel, pause and resume over ROS 2."""

from __future__ import annotations

from uuid import UUID

import pytest

from pnm.tasks import Code, TaskState
from tests.support.ros.task_client import ABORTED, CANCELED, LIMIT, SUCCEEDED

ALL = UUID(int=0)


@pytest.mark.parametrize(
    ("text", "by"),
    [*((text, "client") for text in ("queued", "planning", "running", "replanning", "paused")), ("running", "service"), ("queued", "all")],
)
async def test_a_goal_is_cancelled_in_every_state(one, text, by):
    goal = await one.goal("running" if text == "paused" else text)
    if text == "paused":
        assert (await one.client.call("executor/pause", task=goal.id))["success"]
    await goal.is_in(TaskState[text.upper()])
    if by == "client":
        assert await goal.cancel() == 1
    else:
        assert (await one.client.call("executor/cancel", task=goal.id if by == "service" else ALL))["success"]
    status, result = await goal.result()
    assert (status, result["code"], result["message"]) == (CANCELED, Code.CANCELLED, "cancelled")


async def test_a_goal_is_not_canceled_before_its_task_has_ended(one):
    goal = await one.goal("stubborn")
    assert await goal.cancel() == 1
    await goal.is_in(TaskState.CANCELLING)
    assert not goal.over.done()
    one.tasks.end(goal.id, Code.CANCELLED)
    assert (await goal.result())[0] == CANCELED


async def test_a_goal_that_is_reached_while_it_is_cancelled_has_succeeded(one):
    for code, status in ((Code.GOAL_REACHED, SUCCEEDED), (Code.ACTION_FAILED, ABORTED)):
        goal = await one.goal("stubborn")
        assert await goal.cancel() == 1
        one.tasks.end(goal.id, code)
        assert (await goal.result())[0] == status


async def test_a_search_for_a_plan_is_given_up(one):
    search = await one.client.send("plan", goal="planning")
    assert (await search.hears(lambda told: told["seconds"] > 0.5))["seconds"] < LIMIT
    assert await search.cancel() == 1
    status, result = await search.result()
    assert (status, result["code"], result["message"]) == (CANCELED, Code.CANCELLED, "the search was given up")


async def test_tasks_are_paused_while_the_node_is_inactive(one):
    goal = await one.goal("running")
    await one.node.deactivate()
    assert one.tasks.open[goal.id].state is TaskState.PAUSED
    for service in ("pause", "resume"):
        answer = await one.client.call(f"executor/{service}", task=goal.id)
        assert not answer["success"]
        assert "the node is inactive" in answer["message"]
    await one.node.activate()
    assert one.tasks.open[goal.id].state is TaskState.RUNNING


@pytest.mark.parametrize("before", [False, True])
async def test_what_somebody_has_paused_does_not_go_on_because_the_node_does(one, before):
    if before:  # in another process
        await one.tasks.pause(None, at_once=True)
        one.node.restored(True, ())
    goal = await one.goal("running")
    if not before:
        assert (await one.client.call("executor/pause", task=ALL))["success"]
    await one.node.deactivate()
    await one.node.activate()
    assert one.tasks.open[goal.id].state is TaskState.PAUSED
    assert (await one.client.call("executor/resume", task=ALL))["success"]
    assert one.tasks.open[goal.id].state is TaskState.RUNNING


async def test_what_is_paused_by_itself_does_not_go_on_with_the_others(one):
    paused, resumed, other = await one.goal("running"), await one.goal("running"), await one.goal("running")
    for goal in (paused, resumed):
        assert (await one.client.call("executor/pause", task=goal.id, at_once=True))["success"]
    assert [status.state for status in one.tasks.status()] == [TaskState.PAUSED, TaskState.PAUSED, TaskState.RUNNING]
    assert (await one.client.call("executor/resume", task=resumed.id))["success"]
    for _ in range(2):
        await one.node.deactivate()
        assert all(status.state is TaskState.PAUSED for status in one.tasks.open.values())
        await one.node.activate()
        states = [one.tasks.open[goal.id].state for goal in (paused, resumed, other)]
        assert states == [TaskState.PAUSED, TaskState.RUNNING, TaskState.RUNNING]
    assert (await one.client.call("executor/resume", task=ALL))["success"]
    assert one.tasks.open[paused.id].state is TaskState.RUNNING
    await one.node.deactivate()
    await one.node.activate()
    assert one.tasks.open[paused.id].state is TaskState.RUNNING
