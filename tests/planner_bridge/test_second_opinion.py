"""A second opinion on the machines of real plans: z3 excludes, from the net alone, that they hang or end as they should not."""

from __future__ import annotations

from pathlib import Path

import pytest

from planner_bridge.loading import load
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.planning.solve import solve
from pnm.core.machine.generate import generate
from tests.support.files import ROOT, SHARED
from tests.support.runs.mutation.changes import without_transition
from tests.support.runs.mutation.machines import random_machine

pytest.importorskip("z3", reason="needs z3-solver, which the extra `test` brings")

from tests.support.runs.mutation.state_equation import QUESTIONS, StateEquation

FOLDERS = (SHARED / "pddl" / "robots", SHARED / "pddl" / "ipc")
UNSOLVED = {"blocks_observe", "rosplan_test_invalid", "rosplan_test_no_solution", "simple_2", "simple_3", "childsnack-sat14_s"}
PAIRS = [
    *((ROOT / "domains" / name / "domain.pddl", ROOT / "problems" / name / "p01.pddl") for name in ("delivery", "mall_guide", "patrol")),
    *((one / "domain.pddl", one / "problem.pddl") for folder in FOLDERS if folder.is_dir() for one in sorted(folder.iterdir())),
]
LIMIT = 3_000
"""Nodes of a net that z3 answers for within a second."""


@pytest.mark.parametrize(("domain", "file"), [pair for pair in PAIRS if pair[0].parent.name not in UNSOLVED and pair[0].is_file()])
def test_no_marking_of_a_real_machine_hangs_or_ends_badly(domain: Path, file: Path) -> None:
    problem = load(domain, file)
    plan = solve(problem, timeout=10.0).plan
    if plan is None:
        pytest.skip("Kairos needs longer for it")
    machine = generate(plan_graph(problem, plan))
    if len(machine.net.places) + len(machine.net.transitions) > LIMIT:
        pytest.skip("too large for z3")
    equation = StateEquation(machine)
    assert [question for question in QUESTIONS if not equation.excludes(question)] == []


def test_what_is_wrong_is_not_excluded() -> None:
    machine = random_machine(0)
    assert StateEquation(machine).excludes("a hang")
    name = next(name for name in machine.net.transitions if name.endswith("fork"))
    assert not StateEquation(without_transition(machine, name)).excludes("a bad end")
