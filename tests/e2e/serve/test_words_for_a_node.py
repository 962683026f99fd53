"""The commands that speak to a running node: from a terminal of its own, to `pnm serve` in one process and robots in another."""

from __future__ import annotations

import json
import signal

import pytest

from tests.support.e2e.deployment import SimulationProgram
from tests.support.e2e.plan_deployment import PlanDeployment, Serving
from tests.support.e2e.task_node import DOMAIN, PROBLEM
from tests.support.processes import Program

FAR = "(and (at r1 yard) (at r2 corridor))"


@pytest.fixture(scope="module")
def robots(deployment_of_module: PlanDeployment) -> SimulationProgram:
    command = ["-m", "planner_bridge", "simulate", DOMAIN, PROBLEM, "--speed", "0.5", "--log", "/dev/stdout"]
    return deployment_of_module.start(SimulationProgram(command, deployment_of_module.environment)).ready()


@pytest.fixture(scope="module")
def served(deployment_of_module: PlanDeployment, robots: SimulationProgram) -> PlanDeployment:
    """The node, and slow robots for it."""
    serving = Serving(["-m", "planner_bridge", "serve", DOMAIN, PROBLEM], deployment_of_module.environment)
    deployment_of_module.start(serving).ready()
    return deployment_of_module


def started(deployment: PlanDeployment, *arguments: str) -> Program:
    return deployment.start(Program(["-m", "planner_bridge", *arguments], deployment.environment))


def words(deployment: PlanDeployment, *arguments: str) -> tuple[int, str]:
    """Run a command; return its exit status and all that it prints."""
    program = started(deployment, *arguments)
    status = program.ended()
    return status, "\n".join((*program.out, *program.err))


def tasks(deployment: PlanDeployment) -> dict[str, str]:
    """Return the state of every task, by the beginning of its id."""
    program = started(deployment, "status", "--json")
    assert program.ended() == 0, str(program)
    return {task["id"][:8]: task["state"] for task in json.loads(program.out[-1])["tasks"]}


def going_on(deployment: PlanDeployment, goal: str) -> tuple[Program, str]:
    """Send a goal and wait until something of it is under way; return its client, and the beginning of its id."""
    before = tasks(deployment).keys()
    client = started(deployment, "goal", goal)
    client.until(lambda: any(" sent " in line for line in client.out))
    (task,) = tasks(deployment).keys() - before
    return client, task


# --- what fails ------------------------------------------------------------------------------


def test_a_node_that_is_not_there_is_named_with_what_may_be_wrong(served):
    status, said = words(served, "facts", "-n", "elsewhere")
    assert (status, "there is no service /elsewhere/knowledge/query" in said) == (1, True), said
    assert "is `pnm serve` running, in the namespace /elsewhere and with ROS_DOMAIN_ID=" in said


def test_a_task_that_is_not_there_is_said(served):
    status, said = words(served, "pause")
    assert (status, said) == (2, "no task is going on")
    status, said = words(served, "cancel", "zz")
    assert (status, said.startswith("no task")) == (2, True)


@pytest.mark.parametrize(
    ("arguments", "exit_status", "said"),
    [
        (["goal", "(at r1 kichen)"], 2, "goal     not reached: goal:1:8: unknown object 'kichen'; did you mean 'kitchen'?"),
        (["facts", "--add", "(at r1 moon)"], 1, "add[0]:1:8: unknown object 'moon'"),
        (["facts", "--add", "(at r1 hall)"], 1, "(at r1 hall)"),  # which is sensed
        (["facts", "(at r1"], 1, "questions[0]:1:7: the text ends here"),
    ],
)
def test_what_the_node_refuses_is_printed_with_its_reason(served, arguments, exit_status, said):
    status, printed = words(served, *arguments)
    assert (status, said in printed) == (exit_status, True), printed


# --- what works -------------------------------------------------------------------------------


def test_a_goal_is_reached_and_its_events_are_printed(served):
    client = started(served, "goal", "(at r2 kitchen)", "--deadline", "600", "--policy", "queue", "--priority", "2")
    assert client.ended() == 0, str(client)
    assert client.out[-1] == "goal     holds"
    assert any("sent    move(r2, hall, kitchen)" in line for line in client.out)
    assert any("feedback move(r2, hall, kitchen): progress 0." in line for line in client.out), str(client)
    assert words(served, "facts", "(at r2 kitchen)") == (0, "(at r2 kitchen)  true")


def test_a_task_is_paused_resumed_and_cancelled_by_the_beginning_of_its_id(served, robots):
    client, task = going_on(served, FAR)
    assert words(served, "pause", task[:4], "--at-once") == (0, f"{task}: paused")
    assert tasks(served)[task] == "paused"
    assert words(served, "resume") == (0, f"{task}: goes on")
    assert words(served, "cancel", task) == (0, f"{task}: cancelled")
    assert client.ended() == 1
    assert client.out[-1].startswith("goal     not reached: ")
    assert tasks(served)[task] == "over"


def test_an_interrupted_goal_is_cancelled_and_watched_by_another(served, robots):
    watching = started(served, "watch")
    watching.until(lambda: watching.out)
    client, task = going_on(served, FAR)
    client.process.send_signal(signal.SIGINT)
    assert client.ended() == 1
    assert client.out[-1].startswith("goal     not reached: ")
    watching.until(lambda: any(f"{task}  state   over: cancelled" in line for line in watching.out))
    watching.process.send_signal(signal.SIGINT)
    assert watching.ended() == 0
