"""A node that asks people for help over topics when a goal cannot be reached."""

from __future__ import annotations

from tests.support.e2e.deployment import SimulationProgram
from tests.support.e2e.plan_deployment import ABORTED, PlanDeployment, Serving
from tests.support.e2e.task_node import DOMAIN, PROBLEM, goals
from tests.support.processes import Program


def test_a_person_on_the_topics_is_asked_and_the_result_says_what_came_of_it(deployment: PlanDeployment) -> None:
    answering = ["-m", "tests.support.ros.remote_sources", "person", "knowledge", "helpless"]
    person = deployment.start(Program(answering, deployment.environment))
    command = ["-m", "planner_bridge", "simulate", DOMAIN, PROBLEM]
    deployment.start(SimulationProgram(command, deployment.environment)).ready()
    deployment.start(Serving(["-m", "planner_bridge", "serve", DOMAIN, PROBLEM, "--ask-for-help"], deployment.environment)).ready()
    result = goals(deployment, "(at parcel1 yard)").result()
    assert (result["status"], result["reason"]) == (ABORTED, "no_plan")
    assert result["message"].endswith("a person was asked for help, and says to give up")
    assert any("This goal cannot be reached: no plan" in line and "(at parcel1 yard)" in line for line in person.out), str(person)
