"""Kairos as our planner: what it says is said in words that our users know."""

from __future__ import annotations

import re

from planner_bridge.model.plan import PlanningStatus
from planner_bridge.planning.solve import solve
from tests.support.pddl.problems import hard


def test_a_limit_that_is_over_is_said_without_advice_about_options_that_are_not_ours() -> None:
    found = solve(hard(), timeout=0.5)
    assert found.status is PlanningStatus.TIMED_OUT
    assert found.message.startswith("no plan within the time limit of 0.5 s")
    assert found.message.endswith("; a longer limit (--planner-timeout) or another planner (--planner race) may find one")
    assert set(re.findall(r"--[\w-]+", found.message)) == {"--planner-timeout", "--planner"}
    assert "SolveOptions" not in found.message
