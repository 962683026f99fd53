"""Two of the household's problems over ROS 2: PyRoboSim's world is a node of its own, and `pnm run` has only files."""

from __future__ import annotations

import signal
from typing import Any

from tests.support.e2e.deployment import RunProgram
from tests.support.e2e.plan_deployment import PlanDeployment
from tests.support.files import ROOT
from tests.support.processes import Program

HOUSEHOLD = ROOT / "domains" / "household"


def pursued(deployment: PlanDeployment, problem: int) -> tuple[dict[str, Any], list[str]]:
    """Return the result of a run whose verdict is that of the simulator, and what the robot did successfully."""
    world = ["-m", "tests.support.e2e.household.world_node", str(problem), "--seed", "1", "--realtime-factor", "-1"]
    node = deployment.start(Program(world, deployment.environment))
    node.until(lambda: "ready" in node.out)
    files = [str(HOUSEHOLD / "domain.pddl"), str(HOUSEHOLD / f"problem{problem}.pddl")]
    options = ["--actions", "ros2", "--sensing", str(HOUSEHOLD / "sensing.yaml"), "--json"]
    status, result = deployment.start(RunProgram(["-m", "planner_bridge", "run", *files, *options], deployment.environment)).result()
    node.process.send_signal(signal.SIGTERM)
    assert node.ended() == 0, str(node)
    *actions, verdict = node.objects()
    assert verdict == {"goal_reached": result["goal_reached"]}
    assert status == (0 if result["goal_reached"] else 1)
    return result, [f"{action['type']} {action['what']}" for action in actions if action["status"] == "SUCCESS"]


def test_the_snacks_are_fetched(deployment: PlanDeployment) -> None:
    result, actions = pursued(deployment, 1)
    assert (result["goal_reached"], result["failures"]) == (True, [])
    wanted = ["navigate pantry", "pick snacks0", "navigate table", "place snacks0"]
    assert [action for action in actions if action in wanted][-4:] == wanted


def test_the_robot_charges_on_its_way(deployment: PlanDeployment) -> None:
    result, actions = pursued(deployment, 4)
    assert result["goal_reached"]
    assert "navigate charger" in actions
