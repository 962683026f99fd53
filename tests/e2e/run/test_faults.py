"""What goes wrong at the servers or in the world is found, named and got over; the world itself says so."""

from __future__ import annotations

import json

from tests.support.files import written
from tests.support.processes import Program

IMPATIENT = """
actions:
  move: {server: "/{robot}/move", timeout: 1, cancel: 1}
  return_home: {server: "/{robot}/move", timeout: 1}
  inspect: {server: "/{robot}/inspect", timeout: 1}
assumed: [effort]
"""


def both_ways(fault: str) -> str:
    """The way between gate and barn fails in either direction, so the ring of patrol/p01 is cut."""
    return f'faults: [{{call: "move(r1, gate, barn)", {fault}}}, {{call: "move(r1, barn, gate)", {fault}}}]'


def test_a_fact_changed_behind_the_robots_back_is_found_while_the_action_runs(deploy):
    finished = deploy(
        "delivery/p02",
        quick=True,
        faults="""
            faults: [{action: pass_door, do: hang, times: 1}]
            changes: [{on: start of pass_door, set: ["(not (open door2))"]}]
        """,
    ).execute()
    assert finished.result["goal_reached"]
    assert "invariant_false" in finished.causes("pass_door")
    assert finished.outcomes("pass_door")[0] == "canceled"
    assert finished.result["replans"] >= 1


def test_a_hung_server_that_ignores_cancelling_is_given_up_and_got_round(deploy):
    finished = deploy("patrol/p01", quick=True, faults=both_ways("do: hang, ignores_cancel: true"), bindings=IMPATIENT).execute()
    assert finished.result["goal_reached"]
    assert finished.causes("move") == {"timed_out"}
    assert {failure["observed"] for failure in finished.result["failures"]} == {"neither"}
    assert finished.result["plans"] >= 2


def test_what_a_lost_server_did_is_done_by_another_robot(deploy):
    faults = "faults: [{action: move, do: lose_server, times: 1}]"
    finished = deploy("delivery/p01", quick=True, faults=faults).execute()
    lost = next(event["action"] for event in finished.events if event["event"] == "end" and event["outcome"] == "lost")
    robot = lost[len("move(") :].split(",")[0]
    gone = [failure for failure in finished.result["failures"] if failure["cause"] in ("lost", "unavailable")]
    assert gone
    assert all(f"/{robot}/move" in failure["observed"] for failure in gone)
    assert finished.result["goal_reached"]
    moved = [event["action"] for event in finished.events if event["event"] == "end" and event["outcome"] == "succeeded"]
    assert not any(action.startswith(f"move({robot},") for action in moved)


def test_robots_killed_and_restarted_are_noticed_and_the_goal_is_reached_from_what_is_then_sensed(deploy):
    deployment = deploy("patrol/p01", speed="5")
    killed = deployment.simulate().ready()
    run = deployment.run()
    killed.happens("start", "move", 2)
    killed.kill()
    finished = deployment.finish(run, deployment.simulate())
    assert finished.result["goal_reached"]
    assert finished.result["replans"] >= 1
    first = next(event["action"] for event in killed.objects() if event["event"] == "start")
    assert first in [event["action"] for event in finished.events if event["event"] == "start"], "the new world starts from the beginning"


# --- a sensor that is killed ---

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
