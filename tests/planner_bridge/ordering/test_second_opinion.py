"""A second opinion on the machines of real plans and on policies: z3 excludes, from the net alone, that they hang or end badly."""

from __future__ import annotations

from random import Random
from typing import Final

import pytest

from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.pipeline.loading import load
from planner_bridge.planning.policies.net import PolicyNet
from planner_bridge.planning.policies.policy import policies
from planner_bridge.planning.solve import solve
from pnm.core.machine.generate import generate
from tests.support.pddl.chance import uncertain_problem
from tests.support.pddl.files import OWN, REFUSED, Pair, name_of, pairs
from tests.support.runs.mutation.changes import without_transition
from tests.support.runs.mutation.machines import random_machine
from tests.support.runs.mutation.policies import OF_STEPS, broken_net
from tests.support.runs.mutation.state_equation import QUESTIONS, StateEquation, has_distances

UNSOLVED: Final = ("rosplan_test_no_solution", "simple_2", "childsnack-sat14_s")
"""Pairs that have no plan, or for which Kairos finds none within a minute."""
LARGE: Final = ("transport-sat14_s", "driverlog_l", "gripper_l", "logistics98_m")
"""Pairs whose machines have more than 3,000 nodes, 12,000 the first: z3 needs half a minute for each."""
BESIDE: Final = [folder for folder in pairs() if folder.name not in (*REFUSED, *UNSOLVED, *LARGE)]


@pytest.mark.parametrize("pair", [*OWN, *((folder / "domain.pddl", folder / "problem.pddl") for folder in BESIDE)], ids=name_of)
def test_no_marking_of_a_real_machine_hangs_or_ends_badly(pair: Pair) -> None:
    problem = load(*pair)
    plan = solve(problem, timeout=60.0).plan  # it is there within ten seconds, on a machine that does nothing else
    assert plan is not None
    machine = generate(plan_graph(problem, plan))
    assert len(machine.net.places) + len(machine.net.transitions) <= 3_000
    equation = StateEquation(machine)
    assert [question for question in QUESTIONS if not equation.excludes(question)] == []


@pytest.mark.parametrize("seed", range(30))
def test_the_net_of_a_policy_is_sure_exactly_if_there_are_distances(seed: int) -> None:
    random = Random(seed)
    for best in [*policies(uncertain_problem(seed), 60.0)][-1:]:
        nets = [("", PolicyNet(best.steps())), *(broken_net(PolicyNet(best.steps()), random) for _ in range(20))]
        of_steps = [net for edit, net in nets if edit in ("", *OF_STEPS)]
        assert [net.is_sure for net in of_steps] == [has_distances(net.steps) for net in of_steps]


def test_what_is_wrong_is_not_excluded() -> None:
    machine = random_machine(0)
    assert StateEquation(machine).excludes("a hang")
    name = next(name for name in machine.net.transitions if name.endswith("fork"))
    assert not StateEquation(without_transition(machine, name)).excludes("a bad end")
