"""Problems of the household over ROS 2: `pnm run` has only files, and PyRoboSim's world, or `pnm simulate`, is another process."""

from __future__ import annotations

import signal

from tests.support.e2e.deployment import RunProgram, SimulationProgram
from tests.support.e2e.plan_deployment import PlanDeployment
from tests.support.files import ROOT, written
from tests.support.processes import Program

HOUSEHOLD = ROOT / "domains" / "household"
FAULTS = "faults: [{action: pick, do: abort, times: 1, message: it has slipped}]"


def files(problem: int) -> list[str]:
    return [str(HOUSEHOLD / "domain.pddl"), str(HOUSEHOLD / f"problem{problem}.pddl")]


def run(deployment: PlanDeployment, problem: int, *options: str) -> RunProgram:
    command = ["-m", "planner_bridge", "run", *files(problem), "--actions", "ros2", "--json", *options]
    return deployment.start(RunProgram(command, deployment.environment))


def test_the_snacks_are_fetched_and_the_verdict_is_that_of_the_simulator(deployment: PlanDeployment) -> None:
    world = ["-m", "tests.support.e2e.household.world_node", "1", "--seed", "1", "--realtime-factor", "-1"]
    node = deployment.start(Program(world, deployment.environment))
    node.until(lambda: "ready" in node.out)
    status, result = run(deployment, 1, "--sensing", str(HOUSEHOLD / "sensing.yaml")).result()
    node.process.send_signal(signal.SIGTERM)
    assert node.ended() == 0, str(node)
    *actions, verdict = node.objects()
    assert verdict == {"goal_reached": True}
    assert (status, result["goal_reached"], result["failures"]) == (0, True, [])
    done = [f"{action['type']} {action['what']}" for action in actions if action["status"] == "SUCCESS"]
    wanted = ["navigate pantry", "pick snacks0", "navigate table", "place snacks0"]
    assert [action for action in done if action in wanted][-4:] == wanted


def test_the_goal_is_reached_with_robots_that_are_played_by_the_bindings(deployment: PlanDeployment) -> None:
    faults = str(written(deployment.folder / "faults.yaml", FAULTS))
    command = ["-m", "planner_bridge", "simulate", *files(2), "--faults", faults, "--log", "/dev/stdout"]
    robots = deployment.start(SimulationProgram(command, deployment.environment)).ready()
    rehearsal = run(deployment, 2)
    status, result = rehearsal.result()
    assert (status, result["goal_reached"]) == (0, True), str(rehearsal)
    picks = [call["attempts"] for call in result["calls"] if call["action"] == "pick"]
    assert sorted(picks)[-2:] == [1, 2], "one has slipped once"
    assert picks.count(2) == 1, "and no other has"
    robots.happens("end", "pick")
