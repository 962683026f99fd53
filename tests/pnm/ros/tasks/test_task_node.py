"""Actions, services and topics of a node that offers tasks, as clients that know only ROS 2 see them."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from itertools import count
from typing import Any
from uuid import UUID, uuid4

import pytest

from pnm.core.knowledge_base import KnowledgeBase
from pnm.errors import InputError
from pnm.ros.action_server.goal_server import GoalServer
from pnm.ros.node import service_server as request_services
from pnm.ros.node.ros_thread import RosThread
from pnm.ros.tasks import executor_topics as task_topics
from pnm.ros.tasks.executor_topics import TaskTopics
from pnm.ros.tasks.task_messages import TRACE, run_ending_fields
from pnm.ros.tasks.task_node import TaskNode, action_names
from pnm.tasks import Code, OnConflict, TaskEnding, TaskState, Wanted
from tests.support.ros.child_process import run
from tests.support.ros.task_client import ABORTED, CANCELED, LIMIT, SUCCEEDED, SentGoal, TaskClient, uuid_data
from tests.support.tasks.fake_tasks import FakeTasks, FakeWorld, fake_search

NUMBERS = count()
ALL = uuid_data(UUID(int=0))


@pytest.fixture
def two() -> Iterator[tuple[RosThread, RosThread]]:
    """A node and another for its client, in a namespace that nobody else has: what was there before is remembered for a while."""
    namespace = f"tasks{next(NUMBERS)}"
    threads = RosThread("pnm", namespace=namespace), RosThread("client", namespace=namespace)
    yield threads
    assert all(thread.close() for thread in threads)


@dataclass
class ServingNode:
    node: TaskNode
    tasks: FakeTasks
    knowledge: KnowledgeBase
    client: TaskClient

    async def goal(self, text: str, **fields: object) -> SentGoal:
        return await self.client.send("achieve_goal", goal=text, **fields)

    async def ended(self, text: str, **fields: object) -> tuple[int, dict[str, Any]]:
        return await (await self.goal(text, **fields)).result()


@asynccontextmanager
async def serving_node(two: tuple[RosThread, RosThread], *, is_active: bool = True, max_queue: int = 1000) -> AsyncIterator[ServingNode]:
    knowledge, tasks = KnowledgeBase(), FakeTasks(max_queue)
    node = TaskNode(two[0], tasks, fake_search, FakeWorld(knowledge), {"running": "running_tour"})
    await node.open()
    if is_active:
        await node.activate()
    one = ServingNode(node, tasks, knowledge, TaskClient(two[1]))
    try:
        yield one
    finally:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(request_services, "ARRIVAL", 0.0)  # nobody waits for an answer any more
            await node.close(5.0)
        await one.client.close()
        assert not tasks.listeners


async def heard(queue: asyncio.Queue[dict[str, Any]], found: Any) -> dict[str, Any]:
    async with asyncio.timeout(LIMIT):
        while True:
            message = await queue.get()
            if found(message):
                return message


# --- what is refused, and fails --------------------------------------------------------------


def test_a_goal_while_the_node_is_inactive_is_rejected_and_a_later_one_is_not(two):
    async def main():
        async with serving_node(two, is_active=False) as one:
            for action in ("achieve_goal", "execute_plan", "plan"):
                assert not await (await one.client.send(action)).accepted
            assert not one.tasks.wanted
            await one.node.activate()
            assert (await one.ended("goal_reached"))[0] == SUCCEEDED

    run(main())


@pytest.mark.parametrize(
    ("action", "goal", "said"),
    [
        ("achieve_goal", {"goal": "fly"}, "there is no predicate 'fly' here"),
        ("achieve_goal", {"goal": "running", "deadline": -1.0}, "deadline is -1; expected a number of seconds"),
        ("achieve_goal", {"goal": "running", "deadline": float("nan")}, "deadline is nan; expected a number of seconds"),
        ("achieve_goal", {"goal": "running", "policy": 4}, "there is no policy 4; expected one of 0 (default)"),
        ("execute_plan", {"plan": " "}, "the plan is empty; expected the name of a plan"),
        ("execute_plan", {"plan": "running", "parameters": "[1"}, "parameters:1:3: "),
        ("execute_plan", {"plan": "running", "deadline": float("inf")}, "deadline is inf; expected a number of seconds"),
        ("achieve_goal", {"goal": "x" * 100_001}, "the goal has 100001 characters; expected 100000 at most"),
        ("execute_plan", {"plan": "x" * 100_001}, "the plan has 100001 characters; expected 100000 at most"),
        ("plan", {"goal": "wrong"}, "goal:1:1: expected a condition"),
        ("plan", {"goal": "running", "timeout": -3.0}, "timeout is -3; expected a number of seconds"),
    ],
)
def test_what_is_wrong_with_a_goal_is_in_its_result(two, action, goal, said):
    async def main():
        async with serving_node(two) as one:
            status, result = await (await one.client.send(action, **goal)).result()
            assert (status, result["code"], result["reason"]) == (ABORTED, Code.INVALID_GOAL, "invalid_goal")
            assert said in result["message"]
            assert not one.tasks.open

    run(main())


def test_every_code_arrives_and_only_one_is_a_success(two):
    async def main():
        async with serving_node(two) as one:
            goals = {code: await one.goal(code.word) for code in Code}
            for code, goal in goals.items():
                status, result = await goal.result()
                assert status == (SUCCEEDED if code is Code.GOAL_REACHED else ABORTED), code
                assert (result["code"], result["reason"], result["message"]) == (code, code.word, f"as it was told: {code.word}")

    run(main())


def test_a_full_queue_says_so(two):
    async def main():
        async with serving_node(two, max_queue=2) as one:
            for _ in range(2):
                await one.goal("queued")
            status, result = await one.ended("queued")
            assert (status, result["code"], result["message"]) == (ABORTED, Code.QUEUE_FULL, "2 tasks are waiting already")

    run(main())


def test_an_id_is_that_of_one_task_only(two):
    async def main():
        async with serving_node(two) as one:
            first = await one.goal("running")
            for action, id, fields in (("execute_plan", first.id, {"plan": "running"}), ("achieve_goal", UUID(int=0), {"goal": "running"})):
                status, result = await (await one.client.send(action, id, **fields)).result()
                assert (status, result["code"]) == (ABORTED, Code.INVALID_GOAL)
                assert "is that of another task, or of none" in result["message"]
            one.tasks.end(first.id, Code.GOAL_REACHED)
            assert (await first.result())[0] == SUCCEEDED

    run(main())


def test_a_failure_inside_is_a_result_too(two, caplog):
    async def main():
        async with serving_node(two) as one:
            one.tasks.begin = None  # type: ignore[method-assign,assignment]
            status, result = await one.ended("running")
            assert (status, result["code"]) == (ABORTED, Code.ERROR)
            assert "TypeError" in result["message"]

    run(main())
    assert "a task cannot begin" in caplog.text


@pytest.mark.parametrize("service", ["pause", "resume", "cancel"])
def test_requests_about_unknown_tasks_are_refused(two, service):
    async def main():
        async with serving_node(two) as one:
            id = uuid4()
            answer = await one.client.call(f"executor/{service}", task=uuid_data(id))
            assert answer == {"success": False, "message": f"there is no task {id}"}

    run(main())


def test_a_task_that_is_not_paused_is_not_resumed(two):
    async def main():
        async with serving_node(two) as one:
            goal = await one.goal("running")
            answer = await one.client.call("executor/resume", task=uuid_data(goal.id))
            assert answer == {"success": False, "message": f"the task {goal.id} is not paused"}

    run(main())


def test_a_client_that_disappears_leaves_its_goal_behind(two):
    async def main():
        async with serving_node(two) as one:
            goal = await one.goal("running")
            await one.client.close()
            one.client = TaskClient(two[1])
            assert goal.id in one.tasks.open
            one.tasks.end(goal.id, Code.GOAL_REACHED)
            assert (await one.ended("goal_reached"))[0] == SUCCEEDED
            assert repr(one.node._servers) == "<TaskServers 0 goals>"

    run(main())


def test_closing_cancels_everything_and_answers_everybody(two):
    async def main():
        async with serving_node(two) as one:
            goals = [await one.goal(text) for text in ("running", "queued")] + [await one.client.send("plan", goal="planning")]
            await one.node.close(5.0)
            for goal in goals:
                status, result = await goal.result()
                assert (status, result["code"]) == (ABORTED, Code.CANCELLED), "nobody has asked for it"

    run(main())


def test_a_task_that_does_not_end_is_not_waited_for_without_end(two, caplog):
    async def main():
        async with serving_node(two) as one:
            goal = await one.goal("stubborn")
            await one.node.close(0.1)
            one.tasks.open.clear()
            status, result = await goal.result()
            assert (status, result["code"]) == (ABORTED, Code.CANCELLED)
            assert "has not confirmed that it is cancelled" in result["message"]

    run(main())
    assert "has not ended; what it runs is left alone" in caplog.text


# --- cancelling, pausing ---------------------------------------------------------------------


@pytest.mark.parametrize("text", ["queued", "planning", "running", "replanning", "paused"])
@pytest.mark.parametrize("by", ["client", "service", "all"])
def test_a_goal_is_cancelled_in_every_state(two, text, by):
    async def main():
        async with serving_node(two) as one:
            goal = await one.goal("running" if text == "paused" else text)
            if text == "paused":
                assert (await one.client.call("executor/pause", task=uuid_data(goal.id)))["success"]
            await goal.is_in(TaskState[text.upper()])
            if by == "client":
                assert await one.client.cancel(goal) == 1
            else:
                assert (await one.client.call("executor/cancel", task=uuid_data(goal.id) if by == "service" else ALL))["success"]
            status, result = await goal.result()
            assert (status, result["code"], result["message"]) == (CANCELED, Code.CANCELLED, "cancelled")

    run(main())


def test_a_goal_is_not_canceled_before_its_task_has_ended(two):
    async def main():
        async with serving_node(two) as one:
            goal = await one.goal("stubborn")
            assert await one.client.cancel(goal) == 1
            await goal.is_in(TaskState.CANCELLING)
            assert not goal.over.done()
            one.tasks.end(goal.id, Code.CANCELLED)
            assert (await goal.result())[0] == CANCELED

    run(main())


def test_a_goal_that_is_reached_while_it_is_cancelled_has_succeeded(two):
    async def main():
        async with serving_node(two) as one:
            for code, status in ((Code.GOAL_REACHED, SUCCEEDED), (Code.ACTION_FAILED, ABORTED)):
                goal = await one.goal("stubborn")
                assert await one.client.cancel(goal) == 1
                one.tasks.end(goal.id, code)
                assert (await goal.result())[0] == status

    run(main())


def test_a_search_for_a_plan_is_given_up(two):
    async def main():
        async with serving_node(two) as one:
            search = await one.client.send("plan", goal="planning")
            assert (await search.hears(lambda told: told["seconds"] > 0.5))["seconds"] < LIMIT
            assert await one.client.cancel(search) == 1
            status, result = await search.result()
            assert (status, result["code"], result["message"]) == (CANCELED, Code.CANCELLED, "the search was given up")

    run(main())


def test_one_task_is_paused_and_goes_on(two):
    async def main():
        async with serving_node(two) as one:
            goal, other = await one.goal("running"), await one.goal("running")
            assert (await one.client.call("executor/pause", task=uuid_data(goal.id), at_once=True))["success"]
            assert [status.state for status in one.tasks.status()] == [TaskState.PAUSED, TaskState.RUNNING]
            assert (await one.client.call("executor/resume", task=uuid_data(goal.id)))["success"]
            assert one.tasks.open[goal.id].state is TaskState.RUNNING
            assert one.tasks.open[other.id].state is TaskState.RUNNING

    run(main())


def test_tasks_are_paused_while_the_node_is_inactive(two):
    async def main():
        async with serving_node(two) as one:
            goal = await one.goal("running")
            await one.node.deactivate()
            assert one.tasks.open[goal.id].state is TaskState.PAUSED
            for service in ("pause", "resume"):
                answer = await one.client.call(f"executor/{service}", task=uuid_data(goal.id))
                assert not answer["success"]
                assert "the node is inactive" in answer["message"]
            await one.node.activate()
            assert one.tasks.open[goal.id].state is TaskState.RUNNING

    run(main())


def test_what_somebody_has_paused_does_not_go_on_because_the_node_does(two):
    async def main():
        async with serving_node(two) as one:
            goal = await one.goal("running")
            assert (await one.client.call("executor/pause", task=ALL))["success"]
            await one.node.deactivate()
            await one.node.activate()
            assert one.tasks.open[goal.id].state is TaskState.PAUSED
            assert (await one.client.call("executor/resume", task=ALL))["success"]
            assert one.tasks.open[goal.id].state is TaskState.RUNNING

    run(main())


def test_what_is_paused_by_itself_does_not_go_on_with_the_others(two):
    async def main():
        async with serving_node(two) as one:
            paused, resumed, other = await one.goal("running"), await one.goal("running"), await one.goal("running")
            for goal in (paused, resumed):
                assert (await one.client.call("executor/pause", task=uuid_data(goal.id)))["success"]
            assert (await one.client.call("executor/resume", task=uuid_data(resumed.id)))["success"]
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

    run(main())


# --- plans with an action of their own -------------------------------------------------------


def test_a_plan_with_an_action_of_its_own_is_a_task_like_others(two):
    async def main():
        async with serving_node(two) as one:
            goal = await one.client.send("running_tour", parameters="{shop: bakery}")
            assert await goal.hears(lambda told: told["running"]) == {"running": ["move(r1, hall)"], "ended": 1, "restarts": 0}
            assert one.tasks.wanted == [Wanted(goal.id, "running", parameters={"shop": "bakery"}, is_plan=True)]
            assert (await one.client.call("executor/pause", task=uuid_data(goal.id)))["success"]
            assert one.tasks.open[goal.id].state is TaskState.PAUSED
            assert (await one.client.call("executor/cancel", task=uuid_data(goal.id)))["success"]
            status, result = await goal.result()
            assert (status, result["success"], result["reason"]) == (CANCELED, False, "cancelled")

    run(main())


@pytest.mark.parametrize(
    ("code", "cause", "reason"),
    [
        (Code.GOAL_REACHED, "", "goal"),
        (Code.INVALID_GOAL, "", "parameters"),
        (Code.ACTION_FAILED, "aborted", "aborted"),
        (Code.CONDITION_LOST, "goal_false", "goal_false"),
        (Code.TIMED_OUT, "", "timed_out"),
        (Code.QUEUE_FULL, "", "queue_full"),
        (Code.ERROR, "", "error"),
    ],
)
def test_the_result_of_a_plan_says_why_in_one_word(code, cause, reason):
    fields = run_ending_fields(TaskEnding(code, "why", cause=cause, results={"n": 1}), 0.0)
    assert fields == {"success": code is Code.GOAL_REACHED, "reason": reason, "message": "why", "results": '{"n": 1}'}


def test_plans_have_names_that_can_be_told_apart(two):
    names = run(two[0].ask(lambda: action_names(two[0], ["fetch-it"])))
    assert names[1]["fetch-it"].endswith("/fetch_it")
    with pytest.raises(InputError, match=r"the plan plan would have the action server .*/plan, which the node offers for all tasks"):
        run(two[0].ask(lambda: action_names(two[0], ["plan"])))
    with pytest.raises(InputError, match="two plans would both have the action server"):
        run(two[0].ask(lambda: action_names(two[0], ["fetch-it", "fetch_it"])))


# --- what is told ----------------------------------------------------------------------------


def test_what_is_wanted_arrives_as_it_was_said(two):
    async def main():
        async with serving_node(two) as one:
            await one.goal(" running ", priority=-3, deadline=2.5, policy=2)
            await one.client.send("execute_plan", plan="running fast", parameters="{shop: bakery}", priority=7)
            goal = Wanted(one.tasks.wanted[0].id, "running", -3, 2.5, OnConflict.QUEUE)
            plan = Wanted(one.tasks.wanted[1].id, "running fast", 7, parameters={"shop": "bakery"}, is_plan=True)
            assert one.tasks.wanted == [goal, plan]

    run(main())


def test_feedback_tells_how_the_task_is_doing(two):
    async def main():
        async with serving_node(two) as one:
            goal = await one.goal("running", priority=2)
            told = await goal.is_in(TaskState.RUNNING)
            assert told["plan"] == ["move(r1, hall)", "pick(r1, cup)"]
            assert told["status"] == {
                "id": uuid_data(goal.id), "goal": "running", "priority": 2, "state": 2, "reason": "", "running": ["move(r1, hall)"],
                "ended": 1, "replans": 0,
            }  # fmt: skip

    run(main())


def test_a_result_has_the_last_events_and_what_a_plan_gives_back(two):
    async def main():
        async with serving_node(two) as one:
            goal = await one.client.send("execute_plan", plan="running")
            one.tasks.tell(goal.id, TRACE)
            one.tasks.end(goal.id, Code.GOAL_REACHED)
            status, result = await goal.result()
            assert (status, result["results"]) == (SUCCEEDED, '{"eggs": 3}')
            assert [event["subject"] for event in result["trace"]] == [f"call {number}" for number in range(TRACE)]
            assert {bytes(event["task"]["uuid"]) for event in result["trace"]} == {goal.id.bytes}
            assert {event["stamp"]["sec"] > 1_600_000_000 for event in result["trace"]} == {True}

    run(main())


def test_a_plan_is_looked_for(two):
    async def main():
        async with serving_node(two) as one:
            status, result = await (await one.client.send("plan", goal="(at r1 hall)", planner="kairos", timeout=2.5)).result()
            assert (status, result["code"], result["message"]) == (SUCCEEDED, Code.GOAL_REACHED, "kairos 2.5")
            assert (result["plan"]["goal"], result["plan"]["task"]) == ("(at r1 hall)", ALL)
            assert result["plan"]["steps"][1] == {
                "action": "move", "arguments": ["r1", "hall"], "start": 1.0, "duration": 2.0, "state": 1, "after": [0],
            }  # fmt: skip
            status, result = await (await one.client.send("plan", goal="no_plan")).result()
            assert (status, result["reason"], result["plan"]["steps"]) == (ABORTED, "no_plan", [])

    run(main())


def test_the_status_says_that_a_task_is_over_before_its_client_is_told(two, monkeypatch):
    monkeypatch.setattr(task_topics, "PERIOD", 3600.0)  # whatever is only due by then is never heard
    order: list[str] = []

    def note(kind: type, method: str, name: str) -> None:
        original = getattr(kind, method)
        monkeypatch.setattr(
            kind, method, lambda self, *given: (order.append(self.name if name == "answer" else name), original(self, *given))[1]
        )

    note(TaskTopics, "_publish_status", "status")
    note(GoalServer, "end", "answer")

    async def main():
        async with serving_node(two) as one:
            status = await one.client.subscribe("executor/status")
            goal = await one.goal("running")
            await heard(status, lambda told: not told["tasks"])
            order.clear()
            one.tasks.end(goal.id, Code.GOAL_REACHED)
            assert (await goal.result())[0] == SUCCEEDED
            assert order[:2] == ["status", "achieve_goal"]
            assert not (await asyncio.wait_for(status.get(), LIMIT))["tasks"]
            assert status.empty()

    run(main())


def test_who_comes_late_learns_how_everything_is(two):
    async def main():
        async with serving_node(two) as one:
            goal = await one.goal("running")
            assert (await one.client.call("executor/pause", task=ALL))["success"]
            status = await heard(await one.client.subscribe("executor/status"), lambda told: told["paused"])
            assert [(bytes(task["id"]["uuid"]), task["state"]) for task in status["tasks"]] == [(goal.id.bytes, TaskState.PAUSED)]
            plans = await heard(await one.client.subscribe("executor/plan"), lambda told: told["plans"])
            assert [(plan["number"], len(plan["steps"])) for plan in plans["plans"]] == [(3, 3)]
            nets = await heard(await one.client.subscribe("executor/net"), lambda told: told["nets"])
            assert [(net["number"], '"transitions"' in net["machine"]) for net in nets["nets"]] == [(3, True)]

    run(main())


def test_what_is_over_is_no_longer_told(two):
    async def main():
        async with serving_node(two) as one:
            goal = await one.goal("running")
            queues = [await one.client.subscribe(f"executor/{name}") for name in ("plan", "net")]
            for queue, name in zip(queues, ("plans", "nets"), strict=True):
                await heard(queue, lambda told, name=name: told[name])
            one.tasks.end(goal.id, Code.GOAL_REACHED)
            for queue, name in zip(queues, ("plans", "nets"), strict=True):
                await heard(queue, lambda told, name=name: not told[name])

    run(main())


def test_markings_and_events_are_told_to_those_who_listen(two):
    async def main():
        async with serving_node(two) as one:
            first = await one.goal("running")
            markings = await one.client.subscribe("executor/marking")
            told = await heard(markings, lambda told: bytes(told["task"]["uuid"]) == first.id.bytes)
            assert (told["number"], len(told["places"])) == (3, len(told["tokens"]))
            assert sum(told["tokens"]) > 0
            trace = await one.client.subscribe("executor/trace")
            until = asyncio.get_running_loop().time() + LIMIT
            while trace.empty() and asyncio.get_running_loop().time() < until:
                one.tasks.tell(first.id, 1)  # until it is known that somebody listens
                await asyncio.sleep(0.05)
            assert (await trace.get())["kind"] == "sent"

    run(main())


def test_changes_of_the_knowledge_are_counted(two):
    async def main():
        async with serving_node(two) as one:
            changes = await one.client.subscribe("knowledge/changes")
            until, number = asyncio.get_running_loop().time() + LIMIT, 0
            while changes.empty() and asyncio.get_running_loop().time() < until:
                number += 1
                one.knowledge.update({("n",): float(number)})
                await asyncio.sleep(0.05)
            first = await changes.get()
            assert (first["fluents"], first["values"]) == (["(n)"], [float(first["sequence"])])
            answer = await one.client.call("knowledge/update", add=["(clean a)", "(clean b)"])
            assert answer == {"success": True, "message": "", "changed": 2}
            told = await heard(changes, lambda told: told["added"])
            assert (told["added"], told["sequence"]) == (["(clean a)", "(clean b)"], number + 1)

    run(main())


def test_what_is_known_and_the_problem_may_be_asked_for(two):
    async def main():
        async with serving_node(two) as one:
            one.knowledge.update({("clean", "a"): True})
            answer = await one.client.call("knowledge/query", questions=["(clean a)", "(clean b)"])
            assert (answer["facts"], answer["values"]) == (["(clean a)", "(clean b)"], ["true", "false"])
            answer = await one.client.call("knowledge/query", questions=["clean a"])
            assert not answer["success"]
            assert "clean a" in answer["message"]
            assert (await one.client.call("problem/get"))["domain"] == "(define (domain d))"
            assert (await one.client.call("problem/save", file="p.pddl"))["path"] == "/problems/p.pddl"
            assert (await one.client.call("problem/save", file="/p.pddl"))["message"] == "/p.pddl is outside of the folder for problems"
            assert (await one.client.call("problem/load", problem="(")) == {"success": False, "message": "problem:1:1: expected (define"}

    run(main())


def test_a_hundred_goals_at_once_are_all_answered(two):
    async def main():
        async with serving_node(two) as one:
            await one.client.meet("achieve_goal")
            goals = await asyncio.gather(*(one.goal("running") for _ in range(100)))
            assert len(one.tasks.open) == 100
            for goal in goals:
                one.tasks.end(goal.id, Code.GOAL_REACHED)
            assert {status for status, _ in await asyncio.gather(*(goal.result() for goal in goals))} == {SUCCEEDED}

    run(main())
