"""Policies against exact answers: whether there is one that reaches the goal for certain, and that what is proved does."""

from __future__ import annotations

import pytest
from hypothesis import given, settings, strategies as st

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.pddl.reader import parse_domain, parse_problem
from planner_bridge.planning.policies.policy import find_policy
from planner_bridge.planning.policies.proof import unproved
from tests.support.pddl.chance import Exact, texts


@settings(max_examples=300)
@given(st.integers(0, 10**9))
def test_a_policy_is_found_where_there_is_one(seed: int) -> None:
    domain, of_problem = texts(seed)
    problem = parse_problem(of_problem, parse_domain(domain))
    exact = Exact(problem)
    policy = find_policy(problem, 60.0)
    assert (policy is not None) is exact.has_strong_cyclic_policy
    if policy is not None:
        assert policy.is_proved, unproved(problem, policy.entries, initial_knowledge(problem))
        chance, expected, ends_at_goal = exact.played(policy)
        assert ends_at_goal
        assert chance == pytest.approx(1.0)
        entry = policy.entry(exact.knowledge(exact.initial))
        assert exact.is_goal(exact.initial) or (entry is not None and expected <= entry.expected * 1.001)
