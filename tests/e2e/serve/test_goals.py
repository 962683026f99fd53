"""Goals over ROS 2 from one process to another, planned for and carried out by simulated robots in a third: all of it is real."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from planner_bridge.view.follow import Reader
from tests.support.e2e.deployment import RunProgram, SimulationProgram
from tests.support.e2e.plan_deployment import ABORTED, CANCELED, SUCCEEDED, ClientProgram, PlanDeployment, Serving
from tests.support.e2e.task_node import DOMAIN, PAGE, PROBLEM, goals
from tests.support.files import ROOT
from tests.support.processes import Program


@pytest.fixture(scope="module")
def robots(deployment_of_module: PlanDeployment) -> SimulationProgram:
    options = ["--speed", "20", "--log", "/dev/stdout"]
    return deployment_of_module.pnm(SimulationProgram, "simulate", DOMAIN, PROBLEM, *options).ready()


@pytest.fixture(scope="module")
def served(deployment_of_module: PlanDeployment, robots: SimulationProgram) -> PlanDeployment:
    """Robots, and the node that takes goals for them."""
    deployment_of_module.write({"goals.yaml": "goals:\n  in the yard: (and (at r1 yard) (not (at r2 yard)))"})
    deployment_of_module.pnm(Serving, "serve", DOMAIN, PROBLEM, "--goals", str(deployment_of_module.folder / "goals.yaml")).ready()
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


def test_run_status_history_and_page_of_a_node_count_alike_and_have_one_word_for_a_state(deployment: PlanDeployment) -> None:
    domain, problem = (str(ROOT / folder / "delivery" / file) for folder, file in (("domains", "domain.pddl"), ("problems", "p01.pddl")))
    faults = str(ROOT / "problems" / "delivery" / "faults.yaml")
    deployment.pnm(SimulationProgram, "simulate", domain, problem, "--faults", faults).ready()
    journal = deployment.folder / "node.journal"
    node = deployment.pnm(Serving, "serve", domain, problem, "--journal", str(journal)).ready()
    ended = deployment.pnm(RunProgram, "goal", "--json").result()[1]
    (status,) = deployment.pnm(RunProgram, "status", "--json").result()[1]["tasks"]
    node.stop()
    history = deployment.pnm(RunProgram, "history", "-v", "--json", str(journal)).result()[1]
    (page,) = Reader(journal).newest().tasks.values()
    assert {status["state"], page["state"]} == {"over"}
    assert {history["code"], page["code"], status["code"]} == {"goal_reached"}
    assert {history["reason"], page["reason"], status["reason"]} == {ended["message"] or status["reason"]}
    assert {status["replans"], history["counts"]["replans"], len(history["replanned"]), ended["replans"]} == {status["replans"]}
    assert status["replans"] > 0, "a way is blocked"
    assert page["counts"] == ", ".join(f"{number} {name[: None if number != 1 else -1]}" for name, number in history["counts"].items())
