"""Start effects that are looked for at the end of their call: those that nothing else can overwrite before, in any order of the plan."""

from __future__ import annotations

import pytest

from planner_bridge.model.problem import Problem
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.pddl import parse_domain, parse_problem
from tests.support.tasks.planned_runs import SimulatedSite, timed, with_site

LAMPS = parse_domain("""
(define (domain lamps) (:requirements :durative-actions :negative-preconditions :timed-initial-literals)
  (:predicates (light) (mended) (tested) (seen))
  (:durative-action mend :parameters () :duration (= ?duration 5) :condition (at start (light))
    :effect (and (at start (not (light))) (at end (mended))))
  (:durative-action test :parameters () :duration (= ?duration 1) :condition (at start (not (light)))
    :effect (and (at end (light)) (at end (tested))))
  (:durative-action inspect :parameters () :duration (= ?duration 1) :condition (at start (mended))
    :effect (and (at end (light)) (at end (seen)))))
""")


def lamps(goal: str, timed_facts: str = "") -> Problem:
    return parse_problem(f"(define (problem p) (:domain lamps) (:init (light) {timed_facts}) (:goal (and {goal})))", LAMPS)


@pytest.mark.parametrize(
    ("plan", "timed_facts", "lasts"),
    [
        (("0 5 mend",), "", True),
        (("0 5 mend", "1 1 test"), "", False),
        (("0 5 mend", "6 1 test"), "", False),  # which may as well come at once
        (("0 5 mend", "6 1 inspect"), "", True),  # which waits for the end
        (("0 5 mend",), "(at 3 (light))", False),
        (("0 5 mend",), "(at 9 (light))", False),  # nothing says that the call has ended by then
    ],
)
def test_a_start_effect_is_expected_at_the_end_unless_something_may_overwrite_it(
    plan: tuple[str, ...], timed_facts: str, lasts: bool
) -> None:
    mend = plan_graph(lamps("(mended)", timed_facts), timed(*plan)).calls[0]
    assert mend.lasting == ({("light",)} if lasts else frozenset())


def test_what_comes_earlier_than_planned_is_no_failure_of_the_call_that_it_overwrites() -> None:
    problem = lamps("(mended) (tested) (light)")

    async def scenario(simulation: SimulatedSite) -> None:
        result = await simulation.run(plan_graph(problem, timed("0 5 mend", "6 1 test")))
        assert result.goal, result.reason
        assert not result.failures

    with_site(problem, scenario)
