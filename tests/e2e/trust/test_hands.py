"""A robot that a person takes over, over ROS 2: judged by its own log, also when the node dies meanwhile."""

from __future__ import annotations

from typing import Any

import pytest

from tests.support.e2e.command_line import pnm, result
from tests.support.e2e.deployment import SimulationProgram
from tests.support.e2e.plan_deployment import PlanDeployment, Serving
from tests.support.e2e.task_node import DOMAIN, PROBLEM
from tests.support.processes import Program, until


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
