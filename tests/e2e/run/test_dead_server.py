"""A server that is killed is one failure, whatever else it would have been asked, and the run says so in one sentence."""

from __future__ import annotations

from pnm.core.machine.bindings import Binding
from pnm.ros.action_client.goal import GRACE
from tests.support.pddl.problems import ROOMS
from tests.support.ros.middleware import LEASE

PROBLEM = """(define (problem p) (:domain rooms) (:objects r1 - robot a b c d - room)
 (:init (at r1 a) (way a b) (way b c) (way c d) (way a d) (way d c) (= (total-cost) 0)) (:goal (and (at r1 c) (clean b) (clean c))))"""
ONE = "actions: {move: {server: execute_action, retries: 8}, sweep: {server: execute_action, retries: 8}}"


def test_a_dead_server_is_one_failure_and_the_last_line_names_it(deploy):
    deployment = deploy("rooms", texts=(ROOMS, PROBLEM), bindings=ONE, speed="1", lease=3)
    deployment.simulate("tests.support.e2e.programs.dying_servers").ready()
    run = deployment.run()
    status, result = run.result()
    assert (status, result["code"], len(result["failures"])) == (1, "server_unavailable", 1), str(run)
    assert next((call["attempts"], call["outcome"]) for call in result["calls"]) == (1, "succeeded"), str(run)
    assert sum(call["attempts"] for call in result["calls"] if call["outcome"] in ("lost", "unavailable")) == 1
    assert "/execute_action went away before it answered; no plan without" in result["reason"]
    assert result["reason"].endswith("no plan without the action server execute_action, which is missing")


def test_a_request_is_not_given_up_before_its_server_is_known_to_be_gone() -> None:
    assert Binding().accept + Binding().cancel > LEASE + GRACE
