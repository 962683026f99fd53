"""Laws of what can be reached: no lack that is found could be cheaper, and a limit of time is kept."""

from __future__ import annotations

import time

import pytest
from hypothesis import HealthCheck, given, settings

from planner_bridge.model.problem import Problem
from planner_bridge.planning.reachability import GoalLiteral, Reachability, TooLarge, literal_of
from tests.support.pddl.problems import rooms
from tests.support.pddl.random_problems import problems as random_problems


@given(random_problems())
@settings(suppress_health_check=list(HealthCheck))
def test_no_achiever_has_a_cheaper_lack_than_what_it_achieves(problem: Problem) -> None:
    reachability = Reachability(problem, problem.unknown)
    reachability.settle(problem.goal)
    seen = set[GoalLiteral]()
    waiting = [literal for lack in reachability.of(problem.goal) if (literal := literal_of(lack))]
    while waiting:
        literal = waiting.pop()
        if literal in seen:
            continue
        seen.add(literal)
        way = reachability.way(literal)
        for achiever in way.achievers if way.lack else ():
            lack = reachability.of(achiever.condition, achiever.env)
            assert reachability.cost(lack) >= reachability.cost(way.lack)
            waiting += [literal for condition in lack if (literal := literal_of(condition))]


def test_a_time_that_is_over_ends_the_search() -> None:
    problem = rooms(ways="ab")
    with pytest.raises(TooLarge):
        Reachability(problem, problem.unknown).settle(problem.goal, time.monotonic() - 1.0)
