"""What an action of another program has measured becomes a fact, with which the run goes on, and which the journal keeps."""

from __future__ import annotations

import json

from tests.support.e2e.command_line import pnm
from tests.support.processes import Program

DOMAIN = """
(define (domain measuring)
  (:requirements :typing :numeric-fluents)
  (:types tank)
  (:predicates (measured ?t - tank) (reported))
  (:functions (temperature ?t - tank))
  (:action measure :parameters (?t - tank) :effect (and (measured ?t) (assign (temperature ?t) 30)))
  (:action report :parameters (?t - tank) :precondition (and (measured ?t) (> (temperature ?t) 20)) :effect (reported)))
"""
PROBLEM = "(define (problem p) (:domain measuring) (:objects boiler - tank) (:goal (and (reported) (> (temperature boiler) 25))))"
BINDINGS = """
actions:
  measure: {goal: {nested_field: {int32_value: 21}}, store: {nested_field.int32_value: "(temperature ?t)"}, retries: 0}
  report: {server: measure, goal: {nested_field: {int32_value: "(temperature ?t)"}}, retries: 0}
"""


def test_a_result_sets_a_fluent_that_the_next_goal_is_filled_from(deploy) -> None:
    deployment = deploy("measuring", texts=(DOMAIN, PROBLEM), bindings=BINDINGS, quick=True)
    servers = deployment.module(Program, "tests.support.e2e.programs.foreign_servers")
    servers.until(lambda: servers.out)
    journal = str(deployment.folder / "run.journal")
    status, result = deployment.run("--replans", "0", "--journal", journal).result()
    assert (status, result["goal_reached"], result["failures"]) == (0, True, [])
    assert servers.objects() == [{"server": "measure", "number": 21}, {"server": "measure", "number": 42}]
    told = [json.loads(line) for line in pnm("replay", journal, "--json").stdout.splitlines()]
    assert "42.0" in json.dumps([line for line in told if "temperature" in json.dumps(line)])
