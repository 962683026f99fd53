"""Goals for the task node over ROS 2: refused, failed and reached."""

from __future__ import annotations

import asyncio
import json
from uuid import UUID, uuid4

from pnm.tasks import Code
from tests.support.ros.serving_node import serving_node
from tests.support.ros.task_client import ABORTED, SUCCEEDED, TaskClient


async def test_a_goal_while_the_node_is_inactive_is_rejected_and_a_later_one_is_not(two):
    async with serving_node(two, is_active=False) as one:
        for action in ("achieve_goal", "propose_goal", "execute_plan", "plan"):
            assert not (await one.client.send(action)).handle.accepted
        assert not one.tasks.wanted
        await one.node.activate()
        assert (await one.ended("goal_reached"))[0] == SUCCEEDED


WRONG = (
    ("achieve_goal", {"goal": "fly"}, "there is no predicate 'fly' here"),
    ("achieve_goal", {"goal": "running", "deadline": -1.0}, "deadline is -1; expected a number of seconds"),
    ("achieve_goal", {"goal": "running", "deadline": float("nan")}, "deadline is nan; expected a number of seconds"),
    ("achieve_goal", {"goal": "running", "policy": 4}, "there is no policy 4; expected one of 0 (default)"),
    ("execute_plan", {"plan": " "}, "the plan is empty; expected the name of a plan"),
    ("execute_plan", {"plan": "running", "parameters": "[1"}, "parameters:1:3: "),
    ("execute_plan", {"plan": "running", "deadline": float("inf")}, "deadline is inf; expected a number of seconds"),
    ("achieve_goal", {"goal": "x" * 100_001}, "the goal has 100001 characters; expected 100000 at most"),
    ("execute_plan", {"plan": "x" * 100_001}, "the plan has 100001 characters; expected 100000 at most"),
    (
        "execute_plan",
        {"plan": "running", "parameters": "x" * 100_001},
        "the text of the parameters has 100001 characters; expected 100000 at most",
    ),
    ("plan", {"goal": "wrong"}, "goal:1:1: expected a condition"),
    ("plan", {"goal": "running", "timeout": -3.0}, "timeout is -3; expected a number of seconds"),
)


async def test_what_is_wrong_with_a_goal_is_in_its_result(one):
    for action, goal, said in WRONG:
        status, result = await (await one.client.send(action, **goal)).result()
        assert (status, result["code"], result["reason"]) == (ABORTED, Code.INVALID_GOAL, "invalid_goal")
        assert said in result["message"]
    assert not one.tasks.open


async def test_a_goal_that_is_only_proposed_is_a_task_that_needs_a_yes(one):
    for action, needs_yes in (("propose_goal", True), ("achieve_goal", False)):
        sent = await one.client.send(action, goal="goal_reached")
        await sent.result()
        assert (one.tasks.wanted[-1].id, one.tasks.wanted[-1].needs_yes) == (sent.id, needs_yes)


async def test_a_goal_that_takes_long_to_read_holds_up_no_other(one):
    await one.client.meet("execute_plan")
    long = f"{{a: [{'1,' * 40_000}]}}"
    sending = asyncio.ensure_future(one.client.send("execute_plan", plan="goal_reached", parameters=long))
    await asyncio.sleep(0)  # it is sent
    quick = await one.goal("goal_reached")
    slow = await sending
    await asyncio.gather(slow.result(), quick.result())
    assert [wanted.id for wanted in one.tasks.wanted] == [quick.id, slow.id]


async def test_every_code_arrives_and_only_one_is_a_success(one):
    goals = {code: await one.goal(code.word) for code in Code}
    for code, goal in goals.items():
        status, result = await goal.result()
        assert status == (SUCCEEDED if code is Code.GOAL_REACHED else ABORTED), code
        assert (result["code"], result["reason"], result["message"]) == (code, code.word, f"as it was told: {code.word}")


async def test_an_id_is_that_of_one_task_only(one):
    first = await one.goal("running")
    for action, id, fields in (("execute_plan", first.id, {"plan": "running"}), ("achieve_goal", UUID(int=0), {"goal": "running"})):
        status, result = await (await one.client.send(action, id, **fields)).result()
        assert (status, result["code"]) == (ABORTED, Code.INVALID_GOAL)
        assert "is that of another task, or of none" in result["message"]
    one.tasks.end(first.id, Code.GOAL_REACHED)
    assert (await first.result())[0] == SUCCEEDED


async def test_a_failure_inside_is_a_result_too(two, caplog):
    async with serving_node(two) as one:
        one.tasks.begin = None  # type: ignore[method-assign,assignment]
        status, result = await one.ended("running")
        assert (status, result["code"]) == (ABORTED, Code.ERROR)
        assert "TypeError" in result["message"]
    assert "a task cannot begin" in caplog.text


async def test_requests_about_tasks_that_are_unknown_or_not_paused_are_refused(one):
    for service, id, said in (
        *((service, uuid4(), "there is no task {}") for service in ("pause", "resume", "cancel")),
        ("resume", (await one.goal("running")).id, "the task {} is not paused"),
    ):
        answer = await one.client.call(f"executor/{service}", task=id)
        assert answer == {"success": False, "message": said.format(id)}


async def test_a_person_takes_a_robot_over_and_gives_it_back(one):
    async def put(name: str, value: object, id: UUID | None = None) -> tuple[bool, str]:
        answer = await one.client.call("executor/hands/update", goal_id=id or uuid4(), name=name, value=json.dumps(value))
        return answer["success"], answer["message"]

    id = uuid4()
    assert await put("r1", {"by": "ada", "reason": "stuck"}, id) == (True, "")
    assert await put("r1", {"by": "ada", "reason": "stuck"}, id) == (True, ""), "it is the same request"
    assert await put("r1", {}) == (False, "r1 is taken")
    assert await put("stubborn", {}) == (True, "it may still move")
    assert await put("r2", {"since": "now"}) == (False, 'value: expected null, or texts under by and reason; found {"since": "now"}')
    told = json.loads((await one.client.call("executor/hands/query"))["value"])
    assert told[0] == {"name": "r1", "since": 100.0, "reason": "stuck", "by": "ada"}
    assert [hand["name"] for hand in told] == ["r1", "stubborn"]
    assert await put("r1", None) == (True, "")
    assert not (await one.client.call("executor/hands/query", name="r1"))["found"]


async def test_a_client_that_disappears_leaves_its_goal_behind(one, two):
    goal = await one.goal("running")
    await one.client.close()
    one.client = TaskClient(two[1])
    assert goal.id in one.tasks.open
    one.tasks.end(goal.id, Code.GOAL_REACHED)
    assert (await one.ended("goal_reached"))[0] == SUCCEEDED
    assert repr(one.node._servers) == "<TaskServers 0 goals>"


async def test_closing_cancels_everything_and_answers_everybody(one):
    goals = [await one.goal(text) for text in ("running", "queued")] + [await one.client.send("plan", goal="planning")]
    await one.node.close(5.0)
    for goal in goals:
        status, result = await goal.result()
        assert (status, result["code"]) == (ABORTED, Code.CANCELLED), "nobody has asked for it"


async def test_a_task_that_does_not_end_is_not_waited_for_without_end(two, caplog):
    async with serving_node(two) as one:
        goal = await one.goal("stubborn")
        await one.node.close(0.1)
        one.tasks.open.clear()
        status, result = await goal.result()
        assert (status, result["code"]) == (ABORTED, Code.CANCELLED)
        assert "have not confirmed the cancellation" in result["message"]
    assert "has not ended; its calls are left alone" in caplog.text
