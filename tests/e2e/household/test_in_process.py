"""The household's problems in PyRoboSim's simulator, in this process: what is said of the goal is what the simulator says."""

from __future__ import annotations

import pytest

from planner_bridge.tasks.result import TaskResult
from tests.support.e2e.household.in_process import SimulatorBackend, in_world, pursue
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
    backend.world.get_location_by_name("fridge").is_locked = True
    result = pursued(3, backend)
    assert not result.goal_reached
    assert sum(call.attempts for call in result.calls if call.call.action.name == "open" and "fridge" in call.call.action.arguments) <= 2
    assert "Location: fridge is locked." in {failure.observed for failure in result.failures}


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
