"""Goals over ROS 2 from one process to another, planned for and carried out by simulated robots in a third: all of it is real."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.support.e2e.deployment import SimulationProgram
from tests.support.e2e.page.serving import Stream
from tests.support.e2e.plan_deployment import ABORTED, CANCELED, SUCCEEDED, ClientProgram, PlanDeployment, Serving
from tests.support.e2e.task_node import DOMAIN, PAGE, PROBLEM, goals
from tests.support.processes import Program


@pytest.fixture(scope="module")
def robots(deployment_of_module: PlanDeployment) -> SimulationProgram:
    command = ["-m", "planner_bridge", "simulate", DOMAIN, PROBLEM, "--speed", "20", "--log", "/dev/stdout"]
    return deployment_of_module.start(SimulationProgram(command, deployment_of_module.environment)).ready()


@pytest.fixture(scope="module")
def serving(deployment_of_module: PlanDeployment, robots: SimulationProgram) -> Serving:
    """The node that takes goals, and its page."""
    deployment_of_module.write({"goals.yaml": "goals:\n  in the yard: (and (at r1 yard) (not (at r2 yard)))"})
    options = ["--goals", str(deployment_of_module.folder / "goals.yaml"), "--view=0"]
    node = Serving(["-m", "planner_bridge", "serve", DOMAIN, PROBLEM, *options], deployment_of_module.environment)
    deployment_of_module.start(node).ready()
    return node


@pytest.fixture(scope="module")
def served(deployment_of_module: PlanDeployment, serving: Serving) -> PlanDeployment:
    """Robots, and the node that takes goals for them."""
    return deployment_of_module


REFUSED = {
    "(at r1 kichen)": ("invalid_goal", "goal:1:8: "),
    "in the jard": ("invalid_goal", "there is no goal 'in the jard'; did you mean 'in the yard'?"),
    "(and (at r1 hall) (at r1 store))": ("no_plan", "no plan"),
}


def test_a_goal_that_cannot_be_is_answered_with_the_reason(served):
    for result, (reason, said) in zip(goals(served, *REFUSED).results(), REFUSED.values(), strict=True):
        assert (result["status"], result["reason"]) == (ABORTED, reason)
        assert said in result["message"]


def test_a_goal_with_a_name_is_reached_by_the_robots(served, robots):
    result = goals(served, "in the yard").result()
    assert (result["status"], result["reason"]) == (SUCCEEDED, "goal_reached"), result
    robots.happens("end", "move")
    assert goals(served, "in the yard").result()["status"] == SUCCEEDED, "it is so already"


def test_the_page_of_the_node_shows_its_goals_as_they_are_reached(served, serving):
    stream = Stream(next(line.split()[1] for line in serving.err if line.startswith("view ")))
    _, frame = stream.next()
    state = frame["parts"]
    client = goals(served, "(at r1 kitchen)")
    while not any((task["goal"], task["code"]) == ("(at r1 kitchen)", "goal_reached") for task in state["tasks"].values()):
        _, frame = stream.next()
        for part, changes in frame["parts"].items():
            state.setdefault(part, {}).update(changes)
    assert client.result()["reason"] == "goal_reached"
    assert {request["outcome"] for request in state["requests"].values()} == {"succeeded"}
    assert state["facts"]["(at r1 kitchen)"]["value"] == "true"
    stream.close()


def page(deployment: PlanDeployment, folder: Path, goal: str, limit: str) -> Program:
    """Run the client of the page, with another goal and another limit."""
    (script,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    assert script.count("(at r2 kitchen)") == script.count(", 5.0)") == 1
    file = folder / "client.py"
    file.write_text(script.replace("(at r2 kitchen)", goal).replace(", 5.0)", f", {limit})"))
    client = deployment.start(ClientProgram([str(file)], deployment.environment))
    assert client.ended() == 0, str(client)
    return client


def test_the_client_of_the_page_sends_a_goal_and_hears_of_it(served, tmp_path):
    client = page(served, tmp_path, "(at r2 kitchen)", "30.0")
    assert any("move(r2, hall, kitchen)" in line for line in client.out[:-1]), str(client)
    assert client.out[-1] == f"{SUCCEEDED} goal_reached the goal holds"


def test_the_client_of_the_page_cancels_what_takes_too_long(served, robots, tmp_path):
    client = page(served, tmp_path, "(and (at parcel1 hall) (at parcel2 kitchen))", "0.1")
    assert client.out[-1].startswith(f"{CANCELED} cancelled "), str(client)
    starts = [one["action"] for one in robots.objects() if one["event"] == "start"]
    ends = [one["action"] for one in robots.objects() if one["event"] == "end"]
    assert sorted(starts) == sorted(ends), "what was under way has confirmed that it is cancelled"
