"""A run that learns from a topic what is so, until whoever publishes it is killed."""

from __future__ import annotations

import json

from tests.support.files import written
from tests.support.processes import Program

DOMAIN = """(define (domain workshop)
  (:requirements :typing :durative-actions :numeric-fluents)
  (:types robot)
  (:predicates (charged ?r - robot) (warm ?r - robot) (done ?r - robot))
  (:functions (total-cost))
  (:durative-action warm_up :parameters (?r - robot) :duration (= ?duration 4)
    :condition (at start (charged ?r)) :effect (at end (warm ?r)))
  (:durative-action work :parameters (?r - robot) :duration (= ?duration 1)
    :condition (and (at start (warm ?r)) (at start (charged ?r))) :effect (at end (done ?r)))
  (:durative-action work_slowly :parameters (?r - robot) :duration (= ?duration 5)
    :condition (at start (warm ?r)) :effect (at end (done ?r))))"""
PROBLEM = """(define (problem p) (:domain workshop) (:objects r1 - robot) (:init (charged r1))
  (:goal (done r1)) (:metric minimize (total-time)))"""
SENSING = """
sensors:
  - topic: /{r}/battery
    for: {r: robot}
    facts:
      - fact: (charged ?r)
        when: {field: float32_value, ge: 0.8}
    stale: 1.0
"""


TIRED = """(define (domain tired)
  (:requirements :numeric-fluents)
  (:predicates (begun) (finished))
  (:functions (battery))
  (:action begin :parameters () :precondition (>= (battery) 0.5) :effect (begun))
  (:action finish :parameters () :precondition (and (begun) (>= (battery) 0.5)) :effect (finished))
  (:action charge :parameters () :precondition () :effect (assign (battery) 1)))"""
TWICE = "(define (problem p) (:domain tired) (:init (= (battery) 1)) (:goal (finished)))"
WORKS = "actions: {begin: {server: work, goal: {}}, finish: {server: work, goal: {}}, charge: {goal: {}}}"
ASKED = """
sensors:
  - service: /battery
    every: never
    facts:
      - {number: (battery), field: float64_value}
      - {fact: (begun), when: {field: int32_value, ge: 1}}
      - {fact: (finished), when: {field: int32_value, ge: 2}}
"""


def test_a_service_is_asked_after_every_action_and_what_it_says_changes_the_plan(deploy):
    deployment = deploy("tired", texts=(TIRED, TWICE), bindings=WORKS, quick=True)
    robot = deployment.start(Program(["-m", "tests.support.e2e.programs.tired_robot"], deployment.environment))
    robot.until(lambda: robot.out)
    status, result = deployment.run("--sensing", str(written(deployment.folder / "sensing.yaml", ASKED))).result()
    assert (status, result["goal_reached"]) == (0, True)
    assert [line for line in robot.out if "asked" not in line] == ["ready: 2 servers", "work", "charge", "work"]
    (failure,) = result["failures"]
    assert (failure["cause"], failure["observed"]) == ("precondition_false", "(battery) is 0.25")
    did, *_ = [number for number, line in enumerate(robot.out) if line == "work"]
    assert robot.out[did + 1] == "asked 0.25"


def test_what_is_unknown_because_its_sensor_was_killed_fails_a_call_and_is_planned_around(deploy):
    deployment = deploy("workshop", texts=(DOMAIN, PROBLEM), speed="2")
    battery = {"topic": "/r1/battery", "type": "test_msgs/msg/BasicTypes", "fields": {"float32_value": 0.8}}
    sensor = deployment.start(Program(["-m", "tests.support.ros.sensors", json.dumps(battery)], deployment.environment))
    sensor.until(lambda: "ready" in sensor.out)
    simulation = deployment.simulate().ready()
    run = deployment.run("--sensing", str(written(deployment.folder / "sensing.yaml", SENSING)))
    simulation.happens("start", "warm_up")
    sensor.process.kill()
    finished = deployment.finish(run, simulation)
    (failure,) = finished.result["failures"]
    assert (failure["call"], failure["cause"]) == ("work(r1)#1", "precondition_false")
    assert failure["expected"] == "(charged r1)"
    assert failure["observed"] == "(charged r1) is unknown (nothing was heard on /r1/battery for 1 s)"
    assert (finished.result["goal_reached"], finished.result["plans"], finished.result["replans"]) == (True, 2, 1)
    assert finished.attempts("work_slowly") == [1]
    assert any("nothing was heard on /r1/battery for 1 s; its facts are unknown" in line for line in run.err)
