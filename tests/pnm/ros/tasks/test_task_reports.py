"""What the task node reports over ROS 2: results, plans, status and trace."""

from __future__ import annotations

import asyncio
from typing import Any
from uuid import UUID

import pytest
from pnm_interfaces.action import AchieveGoal
from pnm_interfaces.msg import PlanStep, TaskStatus, TraceEvent
from pnm_interfaces.srv import QueryKnowledge, UpdateKnowledge

from pnm.errors import InputError
from pnm.ros.action_server.goal_server import GoalServer
from pnm.ros.knowledge import LAYERS
from pnm.ros.tasks import executor_topics as task_topics
from pnm.ros.tasks.executor_topics import CAUSES, TRACE, TaskTopics, run_ending_fields
from pnm.ros.tasks.task_node import action_names
from pnm.tasks import Code, OnConflict, StepState, TaskEnding, TaskState, TraceKind, Wanted
from tests.support.ros.child_process import run_bounded
from tests.support.ros.serving_node import serving_node
from tests.support.ros.task_client import ABORTED, CANCELED, LIMIT, SUCCEEDED

ALL = UUID(int=0)


async def message_where(queue: asyncio.Queue[dict[str, Any]], found: Any) -> dict[str, Any]:
    async with asyncio.timeout(LIMIT):
        while True:
            message = await queue.get()
            if found(message):
                return message


# --- plans with an action of their own ---


async def test_a_plan_with_an_action_of_its_own_is_a_task_like_others(one):
    goal = await one.client.send("running_tour", parameters="{shop: bakery}")
    assert await goal.hears(lambda told: told["running"]) == {
        "running": ["move(r1, hall)"], "feedback": [""], "ended": 1, "restarts": 0,
    }  # fmt: skip
    assert one.tasks.wanted == [Wanted(goal.id, "running", parameters={"shop": "bakery"}, is_plan=True, server="running_tour")]
    assert (await one.client.call("executor/pause", task=goal.id))["success"]
    assert one.tasks.open[goal.id].state is TaskState.PAUSED
    assert (await one.client.call("executor/cancel", task=goal.id))["success"]
    status, result = await goal.result()
    assert (status, result["success"], result["reason"]) == (CANCELED, False, "cancelled")


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
    assert fields == {
        "success": code is Code.GOAL_REACHED, "code": code, "reason": reason, "message": "why", "results": '{"n": 1}',
    }  # fmt: skip


def test_plans_have_names_that_can_be_told_apart(two):
    names = run_bounded(two[0].ask(lambda: action_names(two[0], ["fetch-it"])))
    assert names[1]["fetch-it"].endswith("/fetch_it")
    with pytest.raises(InputError, match=r"the plan plan would have the action server .*/plan, which the node offers for all tasks"):
        run_bounded(two[0].ask(lambda: action_names(two[0], ["plan"])))
    with pytest.raises(InputError, match="two plans would both have the action server"):
        run_bounded(two[0].ask(lambda: action_names(two[0], ["fetch-it", "fetch_it"])))


# --- what is told ---


async def test_what_is_wanted_arrives_as_it_was_said(one):
    await one.goal(" running ", priority=-3, deadline=2.5, policy=2)
    await one.client.send("execute_plan", plan="running fast", parameters="{shop: bakery}", priority=7)
    goal = Wanted(one.tasks.wanted[0].id, "running", -3, 2.5, OnConflict.QUEUE, server="achieve_goal")
    plan = Wanted(one.tasks.wanted[1].id, "running fast", 7, parameters={"shop": "bakery"}, is_plan=True, server="execute_plan")
    assert one.tasks.wanted == [goal, plan]


async def test_feedback_tells_how_the_task_is_doing(one):
    goal = await one.goal("running", priority=2)
    told = await goal.is_in(TaskState.RUNNING)
    assert told["plan"] == ["move(r1, hall)", "pick(r1, cup)"]
    assert told["status"] == {
        "id": {"uuid": [*goal.id.bytes]}, "goal": "running", "priority": 2, "state": 2, "code": 0, "reason": "",
        "running": ["move(r1, hall)"], "feedback": [""], "ended": 1, "replans": 0,
        "odds": {"chance": -1.0, "median": 0.0, "ninety_percent": 0.0, "rests_on": ""},
    }  # fmt: skip


async def test_what_the_server_of_a_call_says_is_passed_on(one):
    goal, tour = await one.goal("running"), await one.client.send("running_tour")
    status = await one.client.subscribe("executor/status")
    await message_where(status, lambda told: len(told["tasks"]) == 2)
    one.tasks.feed(goal.id, "distance_remaining 1.2")
    one.tasks.feed(tour.id, "distance_remaining 1.3")
    await goal.hears(lambda told: told["status"]["feedback"] == ["distance_remaining 1.2"])
    await tour.hears(lambda told: told["feedback"] == ["distance_remaining 1.3"])
    await message_where(
        status, lambda told: [task["feedback"] for task in told["tasks"]] == [[f"distance_remaining 1.{n}"] for n in (2, 3)]
    )


async def test_a_result_has_the_last_events_and_what_a_plan_gives_back(one):
    goal = await one.client.send("execute_plan", plan="running")
    one.tasks.tell(goal.id, TRACE)
    one.tasks.end(goal.id, Code.GOAL_REACHED)
    status, result = await goal.result()
    assert (status, result["results"]) == (SUCCEEDED, '{"eggs": 3}')
    assert [event["subject"] for event in result["trace"]] == [f"call {number}" for number in range(TRACE)]
    assert {bytes(event["task"]["uuid"]) for event in result["trace"]} == {goal.id.bytes}
    assert {event["stamp"]["sec"] > 1_600_000_000 for event in result["trace"]} == {True}


async def test_a_plan_is_looked_for(one):
    status, result = await (await one.client.send("plan", goal="(at r1 hall)", planner="kairos", timeout=2.5)).result()
    assert (status, result["code"], result["message"], result["odds"]["chance"]) == (SUCCEEDED, Code.GOAL_REACHED, "kairos 2.5", -1.0)
    _, likely = await (await one.client.send("plan", goal="(at r1 hall)", with_new_plans=True)).result()
    assert likely["odds"] == {"chance": 0.75, "median": 4.0, "ninety_percent": 9.0, "rests_on": "assumed: go"}
    assert (result["plan"]["goal"], result["plan"]["task"]) == ("(at r1 hall)", {"uuid": [*ALL.bytes]})
    assert result["plan"]["steps"][1] == {
        "action": "move", "arguments": ["r1", "hall"], "start": 1.0, "duration": 2.0, "state": 1, "after": [0],
        "started": {"sec": 0, "nanosec": 0}, "ended": {"sec": 0, "nanosec": 0}, "attempts": 2, "limit": 10.0,
        "cause": 6, "reason": "aborted",
    }  # fmt: skip
    status, result = await (await one.client.send("plan", goal="no_plan")).result()
    assert (status, result["reason"], result["plan"]["steps"]) == (ABORTED, "no_plan", [])


async def test_the_status_says_that_a_task_is_over_before_its_client_is_told(two, monkeypatch):
    monkeypatch.setattr(task_topics, "PERIOD", 3600.0)  # whatever is only due by then is never heard
    order: list[str] = []

    def note(kind: type, method: str, name: str) -> None:
        original = getattr(kind, method)

        def noted(self: Any, *given: Any, **how: Any) -> Any:
            order.append(name or self.name)
            return original(self, *given, **how)

        monkeypatch.setattr(kind, method, noted)

    note(TaskTopics, "_publish_status", "status")
    note(GoalServer, "end", "")

    async with serving_node(two) as one:
        status = await one.client.subscribe("executor/status")
        goal = await one.goal("running")
        await message_where(status, lambda told: not told["tasks"])
        order.clear()
        one.tasks.end(goal.id, Code.GOAL_REACHED)
        assert (await goal.result())[0] == SUCCEEDED
        assert order[:2] == ["status", "achieve_goal"]
        assert not (await asyncio.wait_for(status.get(), LIMIT))["tasks"]
        assert status.empty()


async def test_who_comes_late_learns_how_everything_is_until_it_is_over(one):
    goal = await one.goal("running")
    assert (await one.client.call("executor/pause", task=ALL))["success"]
    status = await message_where(await one.client.subscribe("executor/status"), lambda told: told["paused"])
    assert [(bytes(task["id"]["uuid"]), task["state"]) for task in status["tasks"]] == [(goal.id.bytes, TaskState.PAUSED)]
    plan, net = [await one.client.subscribe(f"executor/{name}") for name in ("plan", "net")]
    (told,) = (await message_where(plan, lambda told: told["plans"]))["plans"]
    assert (told["number"], len(told["steps"])) == (3, 3)
    done = told["steps"][0]
    assert 1_600_000_000 < done["started"]["sec"] <= done["ended"]["sec"], "on the clock of the node"
    (told,) = (await message_where(net, lambda told: told["nets"]))["nets"]
    assert (told["number"], '"transitions"' in told["machine"]) == (3, True)
    one.tasks.end(goal.id, Code.GOAL_REACHED)
    await message_where(plan, lambda told: not told["plans"])
    await message_where(net, lambda told: not told["nets"])


async def test_markings_and_events_are_told_to_those_who_listen(one):
    first = await one.goal("running")
    markings = await one.client.subscribe("executor/marking")
    told = await message_where(markings, lambda told: bytes(told["task"]["uuid"]) == first.id.bytes)
    assert (told["number"], len(told["places"])) == (3, len(told["tokens"]))
    assert sum(told["tokens"]) > 0
    trace = await one.client.subscribe("executor/trace")
    until = asyncio.get_running_loop().time() + LIMIT
    while trace.empty() and asyncio.get_running_loop().time() < until:
        one.tasks.tell(first.id, 1)  # until it is known that somebody listens
        await asyncio.sleep(0.05)
    told = await trace.get()
    assert (told["kind"], told["word"]) == (TraceKind.SENT, "sent")


async def test_changes_of_the_knowledge_are_counted(one):
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
    told = await message_where(changes, lambda told: told["added"])
    assert (told["added"], told["sequence"]) == (["(clean a)", "(clean b)"], number + 1)


async def test_what_is_known_and_the_problem_may_be_asked_for(one):
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


# --- numbers ---


def constants(message: Any) -> dict[str, int]:
    """Return the constants of a message by name, which are properties of the class of its class."""
    return {name: getattr(message, name) for name, kind in vars(type(message)).items() if isinstance(kind, property)}


@pytest.mark.parametrize(
    ("message", "named"),
    [
        (AchieveGoal.Goal, {policy.name: policy.value for policy in OnConflict}),
        (AchieveGoal.Result, {code.name: code.value for code in Code}),
        (TaskStatus, {state.name: state.value for state in TaskState}),
        (TraceEvent, {kind.name: kind.value for kind in TraceKind}),
        (PlanStep, {s.name: s.value for s in StepState} | {cause.name if cause else "NONE": CAUSES.index(cause) for cause in CAUSES}),
        *(
            (request, {layer.name: LAYERS.index(layer) for layer in LAYERS})
            for request in (QueryKnowledge.Request, UpdateKnowledge.Request)
        ),
    ],
)
def test_the_constants_of_a_message_are_those_of_the_enum(message, named):
    assert constants(message) == named
