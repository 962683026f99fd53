"""The household's problems in PyRoboSim's simulator, in this process: what is said of the goal is what the simulator says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from pyrobosim.planning.actions import ExecutionResult, ExecutionStatus

from planner_bridge.model.plan import Plan, PlanStep
from planner_bridge.pipeline.loading import load
from planner_bridge.planning.validate import why_invalid
from planner_bridge.tasks.result import TaskResult
from pnm.core.logic.conditions import Holds
from tests.support.e2e.household.in_process import HOUSEHOLD, SimulatorBackend, in_world, problem_of, pursue
from tests.support.e2e.household.mishaps import with_mishaps
from tests.support.e2e.household.simulator import has_reached


def pursued(problem: int, backend: SimulatorBackend) -> TaskResult:
    result = pursue(backend)
    assert result.goal_reached is has_reached(backend.world, problem)
    return result


@pytest.mark.parametrize("problem", [3, 4])
def test_the_goal_is_reached(problem: int) -> None:
    result = pursued(problem, backend := in_world(problem, seed=1))
    assert result.goal_reached
    assert backend.work.battery > 0
    if problem == 3:  # in which attempts fail by chance, and are made again
        assert backend.work.actions == sum(call.attempts for call in result.calls) > len(result.calls)
        assert not result.replans
    else:  # in which the battery would not last
        assert "charge" in {call.call.action.name for call in result.calls if call.attempts}


def test_what_cannot_be_done_has_the_simulators_reason() -> None:
    backend = in_world(3, seed=1)
    jammed = ExecutionResult(ExecutionStatus.PRECONDITION_FAILURE, "The fridge is jammed.")
    open_location = backend.world.open_location
    backend.world.open_location = lambda what: jammed if what.name == "fridge" else open_location(what)
    result = pursued(3, backend)
    assert not result.goal_reached
    assert sum(call.attempts for call in result.calls if call.call.action.name == "open" and "fridge" in call.call.action.arguments) <= 2
    assert "The fridge is jammed." in {failure.observed for failure in result.failures}


def test_what_is_locked_is_not_tried() -> None:
    backend = in_world(3, seed=1)
    backend.world.get_location_by_name("fridge").is_locked = True
    result = pursued(3, backend)
    assert not result.goal_reached
    assert not backend.work.actions
    assert "locked" in result.reason


def test_only_what_the_problem_calls_hidden_is_detected(tmp_path: Path) -> None:
    backend = in_world(3, seed=1)
    text = (HOUSEHOLD / "problem3.pddl").read_text()
    file = tmp_path / "problem.pddl"
    file.write_text(text.replace("(free robot)", "(free robot) (hidden bread0)"))
    backend.problem = load(HOUSEHOLD / "domain.pddl", file)
    result = pursued(3, backend)
    assert result.goal_reached
    assert {call.call.action.arguments[1] for call in result.calls if call.call.action.name == "detect"} == {"bread0"}


def test_a_charger_to_which_no_path_is_found_is_reached_from_elsewhere() -> None:
    backend = in_world(4, seed=1)
    world, robot = backend.world, backend.world.robots[0]
    world.open_location("hall_closet_dining")
    robot.battery_level = 20.0
    plan_path = robot.plan_path
    robot.plan_path = lambda start, goal: None if (robot.location.name, goal) == ("dining", "charger") else plan_path(start, goal)
    assert pursued(4, backend).goal_reached


def test_no_drive_leads_to_work_for_which_the_battery_does_not_last() -> None:
    problem = problem_of(4)
    for charge, goes in ((30, True), (23, False)):
        near = replace(problem, init={**problem.init, ("battery", "robot"): charge, ("open", "hall_closet_dining"): True})
        drive = Plan((PlanStep("navigate", ("robot", "dining", "pantry", "kitchen")),))
        assert (not why_invalid(replace(near, goal=Holds(("at", "robot", "pantry"))), drive)) is goes


def test_what_has_dropped_is_detected_without_a_new_plan_where_the_domain_says_that_it_may_drop() -> None:
    result = pursued(3, with_mishaps(3, seed=1, is_declared=True))
    assert result.goal_reached
    assert (result.plans, result.replans, result.failures) == (1, 0, ())
    ends = [(call.call.action.name, call.declared) for call in result.calls]
    after = ends.index(("pick", "dropped")) + 1
    assert ends[after][0] == "detect", "which nothing else asks for"
    assert {one for one in ends if one[0] == "pick"} >= {("pick", "done"), ("pick", "nothing")}


def test_a_door_that_falls_shut_is_opened_again() -> None:
    backend = in_world(2, seed=1)
    doors = backend.world.get_hallways_attached_to_room("dining")
    performed = backend.performed

    def shut(kind: str) -> None:
        if kind == "place":
            for door in doors:
                backend.world.close_location(door)
        performed(kind)

    backend.performed = shut
    result = pursued(2, backend)
    assert result.goal_reached
    assert result.replans
