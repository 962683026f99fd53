"""Action servers of other people's types are used as they are, and ours tell how far they have come."""

from __future__ import annotations

import threading

import pytest

from pnm.ros.node.messages import import_type
from pnm.ros.node.ros_thread import RosThread
from tests.support.processes import LIMIT, Program

DOMAIN = """
(define (domain foreign)
  (:requirements :strips)
  (:predicates (counted) (measured) (measured_again))
  (:action count :parameters () :precondition () :effect (counted))
  (:action measure :parameters () :precondition (counted) :effect (measured))
  (:action measure_again :parameters () :precondition (measured) :effect (measured_again)))
"""
PROBLEM = "(define (problem p) (:domain foreign) (:init) (:goal (measured_again)))"

COUNT = "count: {goal: {order: 3}, store: {sequence: numbers}, retries: 0}"
MEASURE = "measure: {goal: {nested_field: {int32_value: 21}}, store: {nested_field: reading}, retries: 0}"
AGAIN = "measure_again: {server: measure, goal: {nested_field: $reading}, retries: 0}"


@pytest.fixture
def execute(deploy):
    """Run the little domain with the given bindings; return the exit status, the result, and the goals that the servers got."""

    def run(*bindings: str):
        deployment = deploy("foreign", texts=(DOMAIN, PROBLEM), bindings="\n  ".join(("actions:", *bindings)), quick=True)
        servers = deployment.start(Program(["-m", "tests.support.e2e.programs.foreign_servers"], deployment.environment))
        servers.until(lambda: servers.out)
        status, result = deployment.run("--replans", "0").result()
        return status, result, servers.objects()

    return run


def test_goals_are_filled_from_bindings_and_from_results_of_earlier_actions(execute):
    status, result, goals = execute(COUNT, MEASURE, AGAIN)
    assert (status, result["goal_reached"], result["failures"]) == (0, True, [])
    assert goals == [{"server": "count", "order": 3}, {"server": "measure", "number": 21}, {"server": "measure", "number": 42}]
    assert all(call["assumed"] for call in result["calls"]), "nothing senses what these actions have done"


def test_simulated_robots_tell_how_far_they_have_come(deploy, monkeypatch):
    deployment = deploy("delivery/p01", speed="2", quick=True)
    deployment.simulate().ready()
    for name, value in deployment.environment.items():
        monkeypatch.setenv(name, value)
    ros, told, over = RosThread("listener"), [], threading.Event()
    ground = import_type("pnm_interfaces/action/GroundAction")

    def answered(future):
        future.result().get_result_async().add_done_callback(lambda _: over.set())

    def send():
        from rclpy.action import ActionClient

        client = ActionClient(ros.node, ground, "/r1/move")
        client.wait_for_server(LIMIT)
        goal = ground.Goal(action="move", arguments=["r1", "store", "hall"])
        client.send_goal_async(goal, lambda message: told.append(message.feedback.progress)).add_done_callback(answered)

    try:
        ros.call(send)
        assert over.wait(LIMIT)
    finally:
        assert ros.close()
    assert len(told) >= 2
    assert told == sorted(told)
    assert all(0.0 < share <= 1.0 for share in told)
