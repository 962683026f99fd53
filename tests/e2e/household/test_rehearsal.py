"""A configuration is rehearsed before the robot is there: `pnm simulate` plays the household's bindings, types and fields."""

from __future__ import annotations

from tests.support.e2e.deployment import RunProgram, SimulationProgram
from tests.support.e2e.plan_deployment import PlanDeployment
from tests.support.files import ROOT, written

FILES = [str(ROOT / "domains" / "household" / name) for name in ("domain.pddl", "problem2.pddl")]
FAULTS = "faults: [{action: pick, do: abort, times: 1, message: it has slipped}]"


def test_the_goal_is_reached_with_robots_that_are_played_by_the_bindings(deployment: PlanDeployment) -> None:
    faults = str(written(deployment.folder / "faults.yaml", FAULTS))
    command = ["-m", "planner_bridge", "simulate", *FILES, "--faults", faults, "--log", "/dev/stdout"]
    robots = deployment.start(SimulationProgram(command, deployment.environment)).ready()
    run = deployment.start(RunProgram(["-m", "planner_bridge", "run", *FILES, "--actions", "ros2", "--json"], deployment.environment))
    status, result = run.result()
    assert (status, result["goal_reached"]) == (0, True), str(run)
    picks = [call["attempts"] for call in result["calls"] if call["action"] == "pick"]
    assert sorted(picks)[-2:] == [1, 2], "one has slipped once"
    assert picks.count(2) == 1, "and no other has"
    robots.happens("end", "pick")
