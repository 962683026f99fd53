"""The household's files fit each other; simulated robots reach the four goals as well."""

from __future__ import annotations

import pytest

from planner_bridge.pipeline.achieve import achieve
from planner_bridge.pipeline.loading import bindings_for, load
from pnm.knowledge.sensor_file import read_sensing
from tests.support.files import ROOT

HOUSEHOLD = ROOT / "domains" / "household"


@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_a_problem_is_planned_and_simulated(number: int) -> None:
    result = achieve(HOUSEHOLD / "domain.pddl", HOUSEHOLD / f"problem{number}.pddl")
    assert (result.goal_reached, result.failures) == (True, ())


def test_everything_that_actions_change_is_sensed_or_assumed() -> None:
    problem = load(HOUSEHOLD / "domain.pddl", HOUSEHOLD / "problem4.pddl")
    bindings = bindings_for(HOUSEHOLD / "domain.pddl", None, problem.vocabulary)
    assert bindings.actions.keys() == problem.domain.actions.keys()
    sensed = read_sensing(HOUSEHOLD / "sensing.yaml", problem.vocabulary).names
    assert sensed == {"at", "free", "holding", "on", "open", "battery"}
    assert bindings.assumed == {"seen", "came_from"}
