"""`pnm check`, and the same look at the start of `pnm run` and `pnm serve`: against real servers and sensors in other processes."""

from __future__ import annotations

import json

import pytest

from tests.support.files import written
from tests.support.processes import LIMIT, Program

DOMAIN = """
(define (domain foreign)
  (:requirements :typing :numeric-fluents)
  (:types place)
  (:constants hall kitchen - place)
  (:predicates (counted) (measured) (lit))
  (:functions (x ?p - place) (level))
  (:action count :parameters () :precondition () :effect (counted))
  (:action measure :parameters (?to - place) :precondition (counted) :effect (measured)))
"""
PROBLEM = "(define (problem p) (:domain foreign) (:init (= (x hall) 1) (= (x kitchen) 2)) (:goal (measured)))"

COUNT = "count: {goal: {order: 3}}"
MEASURE = 'measure: {goal: {nested_field: {int32_value: "(x ?to)"}}}'
FIBONACCI, NESTED = "test_msgs/action/Fibonacci", "test_msgs/action/NestedMessage"
BASIC = "test_msgs/msg/BasicTypes"
LAMP = {"topic": "/lamp", "type": BASIC, "fields": {"bool_value": True}}
GAUGE = {"service": "/gauge", "type": "test_msgs/srv/BasicTypes", "fields": {"float64_value": 0.5}}
SENSORS = """
sensors:
  - {topic: /lamp, facts: [{fact: (lit), field: bool_value}]}
  - {service: /gaug, facts: [{number: (level), field: float64_value}]}
  - {service: /deaf, limit: 0.2, facts: [{number: (x hall), field: float64_value}]}
"""


@pytest.fixture(scope="module")
def world(deploy_for_module):
    """Two action servers, of types that are not ours, a topic and a service."""
    deployment = deploy_for_module("foreign", texts=(DOMAIN, PROBLEM), quick=True)
    servers = deployment.module(Program, "tests.support.e2e.programs.foreign_servers")
    deaf = {"service": "/deaf", "type": "test_msgs/srv/BasicTypes", "fields": {}, "deaf": True}
    sensing = deployment.module(Program, "tests.support.ros.sensors", *map(json.dumps, (LAMP, GAUGE, deaf)))
    servers.until(lambda: servers.out)
    sensing.until(lambda: "ready" in sensing.out)
    deployment.servers = servers
    return deployment


@pytest.fixture
def started(world, tmp_path):
    """Start a command with bindings, and sensing if there is a text for it."""

    def start(command, *bindings, sensing="", options=()):
        files = ["--bindings", str(written(tmp_path / "bindings.yaml", "\n  ".join(("actions:", *bindings))))]
        files += ["--sensing", str(written(tmp_path / "sensing.yaml", sensing))] if sensing else []
        return world.pnm(Program, command, *world.files, *files, *options)

    return start


@pytest.fixture
def check(started):
    """Run `pnm check` and return its exit status and the state and advice for each name."""

    def run(*bindings, **options):
        program = started("check", *bindings, options=("--json",), **options)
        status = program.ended()
        (answer,) = program.objects()
        assert answer["ready"] is (status == 0)
        return status, {row["what"]: (row["state"], row["name"], row["advice"]) for row in answer["rows"]}

    return run


def test_what_is_there_and_fits_is_ready_and_what_is_not_there_yet_names_what_is_near(check):
    status, rows = check("count: {server: cuont, type: test_msgs/action/Fibonacci, goal: {order: 3}}", MEASURE, sensing=SENSORS)
    assert status == 1
    absent = "there is no action server /cuont of type test_msgs/action/Fibonacci; similar are /count"
    assert rows["count"] == ("absent", "/cuont", absent)
    assert rows["measure"][:2] == ("ready", "/measure")
    assert rows["(lit)"][:2] == ("ready", "/lamp")
    assert rows["(level)"] == ("absent", "/gaug", "there is no service /gaug; similar are /gauge")
    assert rows["(x hall)"][:2] == ("silent", "/deaf")
    assert rows["(x hall)"][2].startswith("/deaf has not answered yet")


@pytest.mark.parametrize("command", ["run", "serve"])
def test_run_and_serve_refuse_what_can_never_work_before_anything_is_sent(started, world, command):
    before = len(world.servers.out)
    options = ("--actions", "ros2") if command == "run" else ()
    program = started(command, COUNT, 'measure: {goal: {nested_field: {int32_value: "?to"}}}', options=options)
    assert program.ended() == 2
    assert "bindings.yaml:3:12: field nested_field.int32_value, which is filled from ?to, needs int32" in program.err[-1]
    assert len(world.servers.out) == before


def test_run_says_once_what_is_not_there_and_how_long_it_waits_and_is_quiet_otherwise(started):
    fine = started("run", COUNT, MEASURE, options=("--actions", "ros2"))
    assert fine.ended() == 0, str(fine)
    assert not fine.err
    absent = started("run", COUNT, f"{MEASURE[:-1]}, server: mesure, accept: 1}}", options=("--actions", "ros2", "--replans", "0"))
    assert absent.ended() == 1
    (line,) = absent.err
    assert line.startswith("measure: there is no action server /mesure; similar are /measure; it is waited for where it is needed, ")


def test_what_starts_a_little_later_is_waited_for(deploy):
    deployment = deploy("foreign", texts=(DOMAIN, PROBLEM), bindings="\n  ".join(("actions:", COUNT, MEASURE)), quick=True)
    files = [*deployment.files, "--bindings", str(deployment.folder / "bindings.yaml")]
    check = deployment.pnm(Program, "check", *files, "--wait", str(LIMIT))
    deployment.module(Program, "tests.support.e2e.programs.foreign_servers")
    assert check.ended() == 0
    assert [line.split() for line in check.out] == [
        ["what", "name", "type", "state", "what", "to", "do"],
        ["count", "/count", FIBONACCI, "ready"],
        ["measure", "/measure", NESTED, "ready"],
    ]


PATROL = """
actions:
  inspect: {params: [robot, target], server: "/{robot}/inspect", ros_type: KIND}
patrol:
  params: [robot]
  plan: [inspect: {robot: {LocalQuery: robot}, target: pump}]
"""


def checked(world, tmp_path, kind, *options):
    plan = written(tmp_path, PATROL.replace("KIND", kind))
    program = world.pnm(Program, "check", "--plan", str(plan), *options)
    return program.ended(), [line.split(maxsplit=4) for line in program.out[1:]]


def test_servers_whose_names_depend_on_a_parameter_are_not_called_ready(world, tmp_path):
    status, rows = checked(world, tmp_path, FIBONACCI)
    advice = "not looked for: it depends on robot, which has no value before the call starts"
    assert (status, rows) == (1, [["inspect", "/{robot}/inspect", FIBONACCI, "open", advice]])
    status, (row,) = checked(world, tmp_path, FIBONACCI, "--set", "robot=r1")
    assert (status, row[:4]) == (1, ["inspect", "/r1/inspect", FIBONACCI, "absent"])
