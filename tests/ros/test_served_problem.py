"""What a node that serves a problem tells of its world, and is told, over ROS 2."""

from __future__ import annotations

from planner_bridge.loading import load
from pnm.ros.service_client import ServiceClient
from tests.e2e.processes import ROOT, Program
from tests.ros.scripts import run

DOMAIN, PROBLEM = ROOT / "domains/delivery/domain.pddl", ROOT / "problems/delivery/p01.pddl"


def test_a_node_tells_and_is_told_what_is_so(ros, tmp_path):
    options = ["--problems", str(tmp_path), "--ros-args", "-r", "__ns:=/told"]
    node = Program(["-m", "planner_bridge", "serve", str(DOMAIN), str(PROBLEM), *options], {})

    async def call(type_name, name, **fields):
        client = ServiceClient(ros, f"pnm_interfaces/srv/{type_name}", f"/told/{name}")
        try:
            return await client.call(fields, 30.0)
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
        run(main())
    finally:
        node.close()
