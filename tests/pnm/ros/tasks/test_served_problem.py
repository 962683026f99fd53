"""A node that has plans and no problem, until it is told one."""

from __future__ import annotations

from uuid import UUID

from tests.support.files import ROOT
from tests.support.processes import Program
from tests.support.ros.child_process import run_bounded
from tests.support.ros.task_client import ABORTED, CANCELED, SERVICES, TaskClient

ERRANDS = ROOT / "domains/delivery/plans/world.yaml"
DOMAIN, PROBLEM = ROOT / "domains/delivery/domain.pddl", ROOT / "problems/delivery/p01.pddl"


def test_a_node_with_plans_only_pauses_and_cancels_them_and_says_what_it_has_not(ros):
    node = Program(["-m", "planner_bridge", "serve", "--world", str(ERRANDS), "--ros-args", "-r", "__ns:=/plans"], {})

    async def main():
        client = TaskClient(ros)
        everything = UUID(int=0)

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
        assert (await call("executor/cancel", task=goal.id))["success"]
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
