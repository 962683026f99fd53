"""`pnm serve` and `pnm run` with the time of a simulation: an hour of it passes in seconds."""

from __future__ import annotations

import signal

import pytest

from tests.support.e2e.plan_deployment import ABORTED, PlanDeployment, Workers
from tests.support.e2e.plan_files import DOMAIN, FILES, PLANS
from tests.support.processes import Program


@pytest.fixture(scope="module")
def simulation(deployment_of_module: PlanDeployment) -> PlanDeployment:
    """A simulation three hundred times as fast as real time, and a server whose actions take longer than their limit of 600 s."""
    # At this speed 20 s, the limit for an answer to a goal, are 67 ms of the processor, which a busy machine may need.
    patient = DOMAIN.replace("timeout: 600", "timeout: 600, accept: 6000")
    deployment_of_module.write(
        {
            "domain.yaml": patient,
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


@pytest.fixture(params=["serve", "run"])
def following(request: pytest.FixtureRequest, deployment: PlanDeployment) -> tuple[Program, Program]:
    """A simulation, and who follows its time, at work with a server that does not let go."""
    deployment.write({**FILES, "plans.yaml": "clings: {plan: [stubborn: {time: 1000}]}", "domain.yaml": "actions: {stubborn: {cancel: 1}}"})
    deployment.write({"plan.yaml": "domain: domain.yaml\nplan: [stubborn: {time: 1000}]\n"})
    clock = deployment.start(Workers(["-m", "tests.support.e2e.programs.simulation_clock", "1"], deployment.environment)).ready()
    workers = deployment.workers("stubborn").ready()
    if request.param == "serve":
        program: Program = deployment.serve("--ros-args", "-p", "use_sim_time:=true").ready()
        deployment.client("clings")
    else:
        options = ["--plan", str(deployment.folder / "plan.yaml"), "--actions", "ros2", "--sim-time", "--json"]
        program = deployment.start(Program(["-m", "planner_bridge", "run", *options], deployment.environment))
    workers.happens("start", "stubborn")
    return program, clock


def test_a_signal_ends_what_follows_a_simulation_that_has_ended(following: tuple[Program, Program]) -> None:
    program, clock = following
    clock.process.kill()
    program.until(lambda: any("/clock has stood still" in line for line in program.err))
    program.process.send_signal(signal.SIGTERM)
    assert program.ended(60.0) in (0, 1), str(program)
    assert all(one["reason"] == "cancelled" for one in program.objects())
