"""Another problem for a node is checked as its first one is: against bindings, sensors, and what is in the ROS graph."""

from __future__ import annotations

import json
import shutil
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from pnm.errors import RosError
from pnm.knowledge.source import SourceError
from pnm.ros.node.ros_thread import RosThread
from pnm.ros.node.services import ServiceClient
from tests.support.e2e.deployment import SimulationProgram
from tests.support.e2e.plan_deployment import PlanDeployment, Serving
from tests.support.e2e.task_node import DOMAIN as DELIVERY, PROBLEM as PARCELS
from tests.support.files import written
from tests.support.processes import LIMIT, Program
from tests.support.ros.child_process import run_bounded

DOMAIN = """
(define (domain foreign)
  (:requirements :typing :fluents)
  (:types place)
  (:predicates (counted) (measured) (lit) (bright ?p - place))
  (:functions (x ?p - place))
  (:action count :parameters (?to - place) :precondition () :effect (counted))
  (:action measure :parameters (?to - place) :precondition (counted) :effect (measured)))
"""
PROBLEM = "(define (problem p) (:domain foreign) (:objects hall - place) (:init (= (x hall) 1)) (:goal (measured)))"
BINDINGS = """
actions:
  count: {goal: {order: {of: "?to", table: {hall: 3, cellar: 4}}}}
  measure: {goal: {nested_field: {int32_value: "(x ?to)"}}}
"""
SENSING = """sensors:
  - {topic: /lamp, type: std_msgs/msg/Bool, facts: [{fact: (lit), field: data}]}
  - {topic: "/{p}/lamp", for: {p: place}, facts: [{fact: "(bright ?p)", field: bool_value}]}
"""
LAMP = {"topic": "/cellar/lamp", "type": "test_msgs/msg/BasicTypes", "fields": {"bool_value": True}}


@pytest.fixture(scope="module")
def serving(deployment_of_module: PlanDeployment) -> Iterator[PlanDeployment]:
    """A node with a problem, and two action servers of other people's types."""
    deployment, folder = deployment_of_module, deployment_of_module.folder
    files = [str(written(folder / name, text)) for name, text in (("domain.pddl", DOMAIN), ("problem.pddl", PROBLEM))]
    written(folder / "bindings.yaml", BINDINGS)
    sensing = str(written(folder / "sensing.yaml", SENSING))
    servers = deployment.module(Program, "tests.support.e2e.programs.foreign_servers")
    sensors = deployment.module(Program, "tests.support.ros.sensors", json.dumps(LAMP))
    servers.until(lambda: servers.out)
    sensors.until(lambda: sensors.out)
    deployment.pnm(Serving, "serve", *files, "--sensing", sensing, "--problems", str(folder)).ready()
    return deployment


Ask = Callable[..., Any]


@contextmanager
def asking(deployment: PlanDeployment, monkeypatch: pytest.MonkeyPatch) -> Iterator[Ask]:
    """Ask the node by a service of `pnm_interfaces`: its type, its name and the fields of the request."""
    for name, value in deployment.environment.items():
        monkeypatch.setenv(name, value)
    ros = RosThread("loader")

    async def answer(kind: str, name: str, fields: dict[str, object]) -> Any:
        client = ServiceClient(ros, f"pnm_interfaces/srv/{kind}", name)
        try:
            return await client.call(fields, LIMIT)
        except (RosError, SourceError) as error:
            raise AssertionError(str(error)) from error
        finally:
            await client.close()

    yield lambda kind, name, **fields: run_bounded(answer(kind, name, fields))
    ros.close()


def loaded(ask: Ask, domain: str, problem: str) -> tuple[str, str]:
    """Load a domain and a problem; return the message of the refusal, and the objects and functions known afterwards."""
    answer = ask("LoadProblem", "problem/load", domain=domain, problem=problem)
    assert answer.success is not bool(answer.message)
    return answer.message, ask("GetProblem", "problem/get").problem


@pytest.fixture
def ask(serving: PlanDeployment, monkeypatch: pytest.MonkeyPatch) -> Iterator[Ask]:
    with asking(serving, monkeypatch) as ask:
        yield ask


MORE_PLACES = PROBLEM.replace("hall - place", "hall attic - place")
OTHER_PARAMETER = DOMAIN.replace("count :parameters (?to - place)", "count :parameters ()")
OBJECTS = DOMAIN.replace("(:functions (x ?p - place))", "(:functions (x ?p - place) - place)").replace(":fluents", ":object-fluents")
AN_OBJECT = PROBLEM.replace("(= (x hall) 1)", "(= (x hall) hall)")
NO_LAMP = DOMAIN.replace("(lit)", "")


@pytest.mark.parametrize(
    ("domain", "problem", "said"),
    [
        ("", MORE_PLACES, "bindings.yaml:3:44: the table has no row for attic, which ?to of count may be"),
        (OTHER_PARAMETER, PROBLEM, "bindings.yaml:3:30: to is not a parameter of count"),
        (OBJECTS, AN_OBJECT, "bindings.yaml:4:12: field nested_field.int32_value, which is filled from (x ?to), needs int32"),
        (NO_LAMP, PROBLEM, "sensing.yaml:2:"),
    ],
)
def test_what_can_never_work_is_refused_and_nothing_changes(ask: Ask, domain: str, problem: str, said: str) -> None:
    message, now = loaded(ask, domain, problem)
    assert said in message
    assert "(= (x hall) 1)" in now
    assert "attic" not in now


def test_what_fits_is_taken_also_without_all_of_the_actions(ask: Ask) -> None:
    count = "(:action count :parameters (?to - place) :precondition () :effect (counted))"
    message, now = loaded(ask, DOMAIN.replace(count, ""), PROBLEM.replace("1", "7"))
    assert (message, "(= (x hall) 7)" in now) == ("", True)


def test_sensors_are_those_of_the_objects_of_the_new_problem(ask: Ask) -> None:
    message, now = loaded(ask, "", PROBLEM.replace("hall - place", "hall cellar - place"))
    assert (message, "(bright cellar)" in now) == ("", True)
    message, now = loaded(ask, "", PROBLEM.replace("(= (x hall) 1)", "(= (x hall) 7)"))
    assert (message, "cellar" in now) == ("", False)


def test_the_problem_is_saved_as_it_is_now_and_only_in_the_folder_of_the_node(serving: PlanDeployment, ask: Ask) -> None:
    assert ask("UpdateFacts", "knowledge/update", add=["(counted)"]).success
    saved = ask("SaveProblem", "problem/save", file="now.pddl")
    assert saved.success, saved.message
    now = ask("GetProblem", "problem/get").problem
    assert (Path(saved.path).read_text(), "(counted)" in now) == (now, True)
    assert "is not in the folder" in ask("SaveProblem", "problem/save", file="../now.pddl").message


def test_tasks_of_a_loaded_problem_go_on_in_it_when_the_node_has_died(deployment: PlanDeployment, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the domain of its files no robot puts down what it carries."""
    robots = deployment.pnm(SimulationProgram, "simulate", DELIVERY, PARCELS, "--speed", "4", "--log", "/dev/stdout").ready()
    whole, problem = (Path(file).read_text(encoding="utf-8") for file in (DELIVERY, PARCELS))
    domain = written(
        deployment.folder / "domain.pddl", whole.replace("(at start (takes_parcels ?place))", "(at start (at ?parcel ?place))")
    )
    shutil.copy(Path(DELIVERY).with_name("bindings.yaml"), deployment.folder)

    def serve() -> Serving:
        journal = str(deployment.folder / "tasks.journal")
        return deployment.pnm(Serving, "serve", str(domain), PARCELS, "--journal", journal, "--improve", "0").ready()

    def starts() -> Counter[str]:
        return Counter(event["action"] for event in robots.objects() if event["event"] == "start")

    first = serve()
    with asking(deployment, monkeypatch) as ask:
        assert loaded(ask, whole, problem)[0] == ""
    client = deployment.pnm(Program, "goal", "(at parcel1 hall)")
    robots.until(starts)
    first.process.kill()
    first.process.wait(LIMIT)
    second = serve()
    second.until(lambda: any("reached the goal holds" in line for line in second.out))
    assert client.ended() == 0, str(client)
    assert set(starts().values()) == {1}
    second.stop()
