"""`pnm serve` and `pnm run` with the time of a simulation: an hour of it passes in seconds."""

from __future__ import annotations

import pytest

from tests.support.e2e.plan_deployment import ABORTED, PlanDeployment, Workers
from tests.support.e2e.plan_files import DOMAIN, PLANS


@pytest.fixture(scope="module")
def simulation(deployment_of_module: PlanDeployment) -> PlanDeployment:
    """A simulation three hundred times as fast as real time, and a server whose actions take longer than their limit of 600 s."""
    deployment_of_module.write(
        {
            "domain.yaml": DOMAIN,
            "plans.yaml": PLANS,
            "plan.yaml": "domain: domain.yaml\nplan: [wait: {time: 3006}]\n",
            "world.yaml": "mine: {domain: domain.yaml, recipes: [plans.yaml]}",
        }
    )
    deployment_of_module.start(
        Workers(["-m", "tests.support.e2e.programs.simulation_clock", "300"], deployment_of_module.environment)
    ).ready()
    deployment_of_module.workers("add_one", "broken", "dummy_server", "wait").ready()
    return deployment_of_module


def test_limits_of_a_served_plan_are_those_of_the_simulation(simulation: PlanDeployment) -> None:
    simulation.serve("--ros-args", "-p", "use_sim_time:=true").ready()
    result = simulation.client("waits", {"time": 3006}).result()
    assert (result["status"], result["reason"]) == (ABORTED, "timed_out")


def test_limits_of_a_run_are_those_of_the_simulation(simulation: PlanDeployment) -> None:
    plan = str(simulation.folder / "plan.yaml")
    program = simulation.start(
        Workers(["-m", "planner_bridge", "run", "--plan", plan, "--actions", "ros2", "--sim-time"], simulation.environment)
    )
    assert program.ended() == 1
    assert any("failed wait(3006): timed_out" in line for line in program.out), str(program)
