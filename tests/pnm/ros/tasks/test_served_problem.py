"""What a node that serves a problem tells of its world, and is told, over ROS 2."""

from __future__ import annotations

from uuid import UUID

import pytest

from planner_bridge.pipeline.loading import load
from pnm.ros.node.services import ServiceClient
from tests.support.files import ROOT
from tests.support.processes import LIMIT, Program
from tests.support.ros.child_process import run_bounded
from tests.support.ros.task_client import ABORTED, CANCELED, SERVICES, TaskClient, uuid_data

ERRANDS = ROOT / "domains/delivery/plans/world.yaml"
DOMAIN, PROBLEM = ROOT / "domains/delivery/domain.pddl", ROOT / "problems/delivery/p01.pddl"


def test_a_node_tells_and_is_told_what_is_so(ros, tmp_path):
    options = ["--problems", str(tmp_path), "--ros-args", "-r", "__ns:=/told"]
    node = Program(["-m", "planner_bridge", "serve", str(DOMAIN), str(PROBLEM), *options], {})

    async def call(type_name, name, **fields):
        client = ServiceClient(ros, f"pnm_interfaces/srv/{type_name}", f"/told/{name}")
        try:
            return await client.call(fields, LIMIT)
        finally:
            await client.close()

    async def main():
        told = await call("UpdateFacts", "knowledge/update", add=["(open door1)"], remove=["(at r1 store)"], forget=["(empty r2)"])
        assert told.success  # not how many: at a first contact a request may arrive twice
        questions = ["(open door1)", "(exists (?p - place) (at r1 ?p))", "(empty r2)", "(speed r1)"]
        asked = await call("QueryFacts", "knowledge/query", questions=questions)
        assert (asked.success, asked.facts, asked.values) == (True, questions, ["true", "false", "unknown", "1"])
        wrong = await call("UpdateFacts", "knowledge/update", add=["(free store)", "(open dor1)"])
        assert (wrong.success, wrong.message) == (False, "add[1]:1:7: unknown object 'dor1'; did you mean 'door1'?")
        saved = await call("SaveProblem", "problem/save", file="now.pddl")
        assert (saved.success, saved.path) == (True, str((tmp_path / "now.pddl").resolve()))
        now = load(DOMAIN, tmp_path / "now.pddl")
        assert ("open", "door1") in now.init
        assert not {("at", "r1", "store"), ("empty", "r2")} & now.init.keys()
        got = await call("GetProblem", "problem/get")
        assert got.problem == (tmp_path / "now.pddl").read_text(encoding="utf-8")
        refused = await call("SaveProblem", "problem/save", file="../now.pddl")
        assert not refused.success
        assert "is not in the folder" in refused.message
        refused = await call("LoadProblem", "problem/load", problem="(define (problem p) (:domain delivery) (:goal (at r1 hall)))")
        assert not refused.success
        assert "'r1'" in refused.message
        asked = await call("QueryFacts", "knowledge/query", questions=["(open door1)"])
        assert asked.values == ["true"], "nothing has changed"
        text = "(define (problem p) (:domain delivery) (:objects r9 - robot) (:init (empty r9)) (:goal (empty r9)))"
        assert (await call("LoadProblem", "problem/load", problem=text)).success
        asked = await call("QueryFacts", "knowledge/query", questions=["(empty r9)"])
        assert asked.values == ["true"]
        asked = await call("QueryFacts", "knowledge/query")
        assert asked.facts == ["(empty r9)"]

    try:
        node.until(lambda: any(line.startswith("ready") for line in node.out))
        run_bounded(main())
    finally:
        node.close()


@pytest.mark.parametrize("how", [["--planner", "kairoos"], ["--ros-args", "-p", "planner:=kairoos"]])
def test_a_planner_that_is_not_there_is_refused_at_the_start(how):
    node = Program(["-m", "planner_bridge", "serve", str(DOMAIN), str(PROBLEM), *how], {})
    try:
        assert node.ended() == 2
        assert [
            line for line in node.err if "there is no planner 'kairoos'; installed: kairos, " in line and "did you mean 'kairos'?" in line
        ]
        assert not node.out
    finally:
        node.close()


def test_a_node_with_plans_only_pauses_and_cancels_them_and_says_what_it_has_not(ros):
    node = Program(["-m", "planner_bridge", "serve", "--world", str(ERRANDS), "--ros-args", "-r", "__ns:=/plans"], {})

    async def main():
        client = TaskClient(ros)
        everything = uuid_data(UUID(int=0))

        async def refused(action, **goal):
            status, result = await (await client.send(f"/plans/{action}", **goal)).result()
            assert (status, result["reason"]) == (ABORTED, "invalid_goal")
            return result["message"]

        async def call(name, **request):
            return await client.call(f"/plans/{name}", f"pnm_interfaces/srv/{SERVICES[name]}", **request)

        for goal in ("", "(at r1 hall)", "tidy"):
            assert "no domain and problem are loaded, only plans" in await refused("achieve_goal", goal=goal)
        assert "no domain and problem are loaded" in await refused("plan")
        assert "needs a domain with actions" in await refused("execute_plan", plan="(move r1 hall store)")
        assert await refused("execute_plan", plan="round_tripp") == "there is no plan 'round_tripp'; did you mean 'round_trip'?"
        assert "did you mean 'robot'?" in await refused("execute_plan", plan="round_trip", parameters="{robt: r1}")
        for name, request in (("problem/get", {}), ("problem/load", {"problem": "(define (problem p) (:domain nothing))"})):
            assert "no domain and problem are loaded" in (await call(name, **request))["message"]
        assert (await call("knowledge/query"))["success"]
        assert (await call("executor/pause", task=everything))["success"]
        goal = await client.send("/plans/round_trip", parameters="{robot: r1}")
        assert (await call("executor/cancel", task=uuid_data(goal.id)))["success"]
        status, result = await goal.result()
        assert (status, result["reason"], result["message"]) == (CANCELED, "cancelled", "cancelled on request")
        texts = (file.read_text(encoding="utf-8") for file in (DOMAIN, PROBLEM))
        assert (await call("problem/load", **dict(zip(("domain", "problem"), texts, strict=True))))["success"]
        assert (await call("knowledge/query", questions=["(at r1 store)"]))["values"] == ["true"]
        assert "has no parameters; found a" in await refused("execute_plan", plan="(move r1 store hall)", parameters="{a: 1}")
        await client.close()

    try:
        node.until(lambda: any(line.startswith("ready") for line in node.out))
        run_bounded(main())
    finally:
        node.close()
