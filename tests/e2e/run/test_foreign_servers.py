"""Action servers of other people's types are used as they are, also with the files that `pnm init` writes for them."""

from __future__ import annotations

import pytest

from tests.support.e2e.deployment import RunProgram, SimulationProgram
from tests.support.files import written
from tests.support.processes import Program

WITHOUT = "tests.support.e2e.programs.without_our_messages"
DOMAIN = """
(define (domain foreign)
  (:requirements :strips)
  (:predicates (counted) (measured) (measured_again))
  (:action count :parameters () :precondition () :effect (counted))
  (:action measure :parameters () :precondition (counted) :effect (measured))
  (:action measure_again :parameters () :precondition (measured) :effect (measured_again)))
"""
PROBLEM = "(define (problem p) (:domain foreign) (:init) (:goal (measured_again)))"

BINDINGS = """
actions:
  count: {goal: {order: 3}, store: {sequence: numbers}, retries: 0}
  measure: {goal: {nested_field: {int32_value: 21}}, store: {nested_field: reading}, retries: 0}
  measure_again: {server: measure, goal: {nested_field: $reading}, retries: 0}
"""


@pytest.fixture(scope="module")
def world(deploy_for_module):
    """The little domain, and the servers."""
    deployment = deploy_for_module("foreign", texts=(DOMAIN, PROBLEM), bindings=BINDINGS, quick=True)
    servers = deployment.module(Program, "tests.support.e2e.programs.foreign_servers")
    servers.until(lambda: servers.out)
    return deployment, servers


def test_goals_are_filled_from_bindings_and_from_results_of_earlier_actions(world):
    deployment, servers = world
    status, result = deployment.run("--replans", "0").result()
    assert (status, result["goal_reached"], result["failures"]) == (0, True, [])
    goals = servers.objects()
    assert goals == [{"server": "count", "order": 3}, {"server": "measure", "number": 21}, {"server": "measure", "number": 42}]
    assert all(call["assumed"] for call in result["calls"]), "nothing senses what these actions have done"


@pytest.mark.parametrize("command", ["planner_bridge", WITHOUT])
def test_the_first_files_for_them_pass_the_check_and_reach_their_goal(world, tmp_path, command: str) -> None:
    deployment, _ = world

    def ends(status: int, *arguments: str) -> Program:
        program = deployment.module(Program, command, *arguments)
        assert program.ended() == status, str(program)
        return program

    folder = tmp_path / "mine"
    assert "lines need a decision" in ends(0, "init", str(folder)).out[-1]
    files = [str(folder / "domain.pddl"), str(folder / "problem.pddl"), "--sensing", str(folder / "sensing.yaml")]
    ends(0, "check", *files)
    ends(0, "run", *files, "--actions", "ros2")
    assert "domain.pddl" in ends(2, "init", str(folder)).err[-1]


def test_a_node_and_its_commands_say_which_messages_they_need(world) -> None:
    deployment, _ = world
    for command in (["serve", *deployment.files, "--journal", "none"], ["simulate", *deployment.files], ["status"]):
        program = deployment.module(Program, WITHOUT, *command)
        assert program.ended() == 2, str(program)
        assert "pnm_interfaces" in program.err[-1]
        assert "`pip install ./ros/pnm_interfaces`, or its wheel" in program.err[-1]


def test_robots_of_other_types_are_rehearsed_without_our_messages(deploy_for_module) -> None:
    measured = "{type: test_msgs/action/NestedMessage, goal: {nested_field: {int32_value: 21}}}"
    bindings = (
        f"actions:\n  count: {{type: test_msgs/action/Fibonacci, goal: {{order: 3}}}}\n  measure: {measured}\n  measure_again: {measured}\n"
    )
    deployment = deploy_for_module("foreign", texts=(DOMAIN, PROBLEM), bindings=bindings, quick=True)
    simulation = deployment.simulate(WITHOUT).ready()
    run = deployment.run(program=WITHOUT)
    assert deployment.finish(run, simulation).status == 0
    assert any("no facts are reported" in line for line in simulation.err), str(simulation)


ROUND = """
types: robot place
constants: [r1 - robot, hall - place]
predicates: ["(seen ?p - place)"]
actions:
  look:
    params: ?robot - robot ?place - place
    server: "/{robot}/look"
    effects: ["(seen ?place)"]
    retries: 1
  count: {type: kb_action, params: [operation]}
params: [robot, times]
results: [done]
initial_knowledge: {done: 0, times: 2}
plan:
  - while:
      condition: {Comparison: ["<", [LocalQuery: done, LocalQuery: times]]}
      actions:
        - look: {robot: {LocalQuery: robot}, place: hall}
        - count: {operation: {LocalUpdate: [done, {Operation: ["+", [LocalQuery: done, 1]]}]}}
"""


def test_hand_written_plans_are_rehearsed_over_ros(deploy) -> None:
    deployment = deploy("foreign", texts=(DOMAIN, PROBLEM), faults="faults: [{action: look, do: abort, times: 1}]", quick=True)
    plan = ["--plan", str(written(deployment.folder / "round.yaml", ROUND))]
    unknown = deployment.pnm(Program, "simulate", *plan)
    assert unknown.ended() == 2
    assert "the server /{robot}/look of look depends on robot, which is not known; give --set robot=…" in unknown.err[-1]
    answers = ROUND.replace("retries: 1", "simulated: {place: hall}")
    silent = deployment.pnm(Program, "simulate", "--plan", str(written(deployment.folder / "told.yaml", answers)), "--set", "robot=r1")
    assert silent.ended() == 2
    assert "a result of pnm_interfaces/action/GroundAction has no field place, which the action has under 'simulated'" in silent.err[-1]
    options = ["--faults", str(deployment.folder / "faults.yaml"), "--log", "/dev/stdout"]
    simulation = deployment.pnm(SimulationProgram, "simulate", *plan, "--set", "robot=r1", *options).ready()
    assert deployment.pnm(Program, "check", *plan, "--set", "robot=r1", "--wait", "30").ended() == 0
    status, result = deployment.pnm(RunProgram, "run", *plan, "--set", "robot=r1", "--actions", "ros2", "--json").result()
    simulation.stop()
    assert (status, result["results"]) == (0, {"done": 2})
    ends = [event["outcome"] for event in simulation.objects() if event["event"] == "end"]
    assert ends == ["aborted", "succeeded"], "what is seen is reported, so the second round finds nothing to do"
    assert simulation.objects()[-1]["facts"] == ["(seen hall)"]
