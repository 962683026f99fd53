"""A problem of the household over ROS 2: `pnm run` has only files, and PyRoboSim's world is another process."""

from __future__ import annotations

import signal

from tests.support.e2e.deployment import RunProgram
from tests.support.e2e.plan_deployment import PlanDeployment
from tests.support.files import ROOT
from tests.support.processes import Program

HOUSEHOLD = ROOT / "domains" / "household"


def test_the_snacks_are_fetched_and_the_verdict_is_that_of_the_simulator(deployment: PlanDeployment) -> None:
    node = deployment.module(Program, "tests.support.e2e.household.world_node", "1", "--seed", "1", "--realtime-factor", "-1")
    node.until(lambda: "ready" in node.out)
    files = [str(HOUSEHOLD / name) for name in ("domain.pddl", "problem1.pddl")]
    options = ["--actions", "ros2", "--json", "--sensing", str(HOUSEHOLD / "sensing.yaml")]
    status, result = deployment.pnm(RunProgram, "run", *files, *options).result()
    node.process.send_signal(signal.SIGTERM)
    assert node.ended() == 0, str(node)
    *actions, verdict = node.objects()
    assert verdict == {"goal_reached": True}
    assert (status, result["goal_reached"], result["failures"]) == (0, True, [])
    done = [f"{action['type']} {action['what']}" for action in actions if action["status"] == "SUCCESS"]
    wanted = ["navigate pantry", "pick snacks0", "navigate table", "place snacks0"]
    assert [action for action in done if action in wanted][-4:] == wanted
