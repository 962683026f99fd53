"""Plans of real problems: those of the project, and the pairs beside it, where their folder is present."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Final

import pytest

from planner_bridge.model.problem import Problem
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.pipeline.loading import load
from planner_bridge.planning.solve import solve
from pnm.core.machine.plan_graph import PlanGraph
from tests.support.pddl.files import OWN, REFUSED, pairs

UNSOLVED: Final = {
    "rosplan_test_no_solution": "proved unsolvable",
    "simple_2": "proved unsolvable",
    "childsnack-sat14_s": "Kairos finds no plan within a minute",
}
"""Pairs that are read and have no plan, and why."""


LARGE: Final = ("transport-sat14_s", "driverlog_l", "gripper_l", "logistics98_m")
"""Pairs whose machines have more than 3,000 nodes; 12,000 the first."""


def solved(*, large: bool = True) -> list[object]:
    """Return the domain and the problem file of everything that has a plan, as parameters of a test."""
    left_out = {*REFUSED, *UNSOLVED, *(() if large else LARGE)}
    beside = [(folder / "domain.pddl", folder / "problem.pddl") for folder in pairs() if folder.name not in left_out]
    return [pytest.param(domain, file, id=f"{domain.parent.name} {file.stem}") for domain, file in (*OWN, *beside)]


@cache
def planned(domain: Path, file: Path) -> tuple[Problem, PlanGraph]:
    """Read a pair and plan for it; the plan is there within a minute, on a machine that does nothing else within ten seconds."""
    problem = load(domain, file)
    plan = solve(problem, timeout=60.0).plan
    assert plan is not None
    return problem, plan_graph(problem, plan)
