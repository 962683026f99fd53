"""A robot that a person takes over, over ROS 2: judged by its own log, also when the node dies meanwhile."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from tests.support.e2e.command_line import pnm, result
from tests.support.e2e.deployment import ProblemDeployment, SimulationProgram
from tests.support.e2e.plan_deployment import PlanDeployment, Serving
from tests.support.e2e.task_node import DOMAIN, PROBLEM
from tests.support.processes import Program, until
from tests.support.tasks.kills.interventions import campaign


def words(*arguments: str) -> tuple[int, str]:
    """Give a command; return its exit status and all that it prints."""
    done = pnm(*arguments)
    return done.returncode, done.output.rstrip("\n")


def begun(robots: SimulationProgram) -> list[str]:
    """Return what the robot r1 has begun with, by its own log."""
    return [one["action"] for one in robots.objects() if one["event"] == "start" and "(r1, " in one["action"]]


def test_nothing_is_sent_to_a_robot_in_a_persons_hands(deployment: PlanDeployment, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in deployment.environment.items():
        monkeypatch.setenv(name, value)
    robots = deployment.pnm(SimulationProgram, "simulate", DOMAIN, PROBLEM, "--speed", "0.05", "--log", "/dev/stdout").ready()
    node = deployment.pnm(Serving, "serve", DOMAIN, PROBLEM, "--journal", str(deployment.folder / "journal")).ready()
    goal = deployment.pnm(Program, "goal", "(at r1 yard)")
    goal.until(lambda: any(" sent " in line for line in goal.out))

    assert words("take", "r1", "--reason", "stuck", "--by", "ada") == (0, "r1: taken, and at rest")
    before = begun(robots)
    assert before
    node.kill()
    deployment.pnm(Serving, "serve", DOMAIN, PROBLEM, "--journal", str(deployment.folder / "journal")).ready()
    status: dict[str, Any] = result(pnm("status", "--json"))
    assert [(hand["name"], hand["reason"], hand["by"]) for hand in status["hands"]] == [("r1", "stuck", "ada")]
    told = "waits: r1 is in the hands of ada since"  # once the node has looked at the plan
    until(lambda: [told in task["reason"] for task in result(pnm("status", "--json"))["tasks"]] == [True])
    assert begun(robots) == before

    assert words("give", "r1") == (0, "r1: given back")
    robots.until(lambda: begun(robots)[len(before) :])
    robots.process.terminate()


def test_people_take_robots_over_at_random_and_no_command_reaches_what_they_have(deploy: Callable[..., ProblemDeployment]) -> None:
    done = campaign(deploy("delivery/p01", quick=True), seed=1, interventions=3, kills=1)
    assert not done.wrong
    assert (done.count, done.goals > 0, done.commands > 0) == (3, True, True)


def test_a_node_that_stands_by_takes_over_with_the_robot_still_in_hands(
    deployment: PlanDeployment, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in deployment.environment.items():
        monkeypatch.setenv(name, value)
    robots = deployment.pnm(SimulationProgram, "simulate", DOMAIN, PROBLEM, "--speed", "0.05", "--log", "/dev/stdout").ready()
    nodes = [deployment.pnm(Serving, "serve", DOMAIN, PROBLEM, "--journal", str(deployment.folder / "journal"))]
    nodes[0].ready()
    nodes.append(deployment.pnm(Serving, *nodes[0].arguments[2:]))
    nodes[1].until(lambda: any(line.startswith("stands by") for line in nodes[1].out))
    assert words("take", "r1", "--by", "ada") == (0, "r1: taken, and at rest")
    goal = deployment.pnm(Program, "goal", "(at r1 yard)")
    told = "no plan without r1, which is in the hands of ada since"
    until(lambda: [told in task["reason"] for task in result(pnm("status", "--json"))["tasks"]] == [True])
    nodes[0].kill()
    nodes[1].ready()
    until(lambda: [told in task["reason"] for task in result(pnm("status", "--json"))["tasks"]] == [True])
    assert [hand["name"] for hand in result(pnm("status", "--json"))["hands"]] == ["r1"]
    assert not begun(robots)
    assert words("give", "r1") == (0, "r1: given back")
    robots.until(lambda: begun(robots))
    assert goal.process.poll() is None, str(goal)
    robots.process.terminate()
