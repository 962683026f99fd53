"""Conditions of effects that are decided at the start mean the same in plans, runs and replanning."""

from __future__ import annotations

import pytest

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.problem import Problem
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.tasks.replanning import Progress, why_not
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.core.machine.bindings import Binding, Bindings
from tests.support.runs.plan_graphs import shown
from tests.support.tasks.planned_runs import SimulatedSite, timed, with_site

MOPS = parse_domain("""
(define (domain mops) (:requirements :durative-actions :conditional-effects)
  (:predicates (wet) (clean) (streaked) (seen))
  (:durative-action mop :parameters () :duration (= ?duration 5) :condition ()
    :effect (and (at start (not (wet))) (when (at start (wet)) (at end (clean))) (at end (when (wet) (streaked)))))
  (:durative-action wipe :parameters () :duration (= ?duration 5) :condition () :effect (when (at start (wet)) (at end (clean))))
  (:durative-action hose :parameters () :duration (= ?duration 2) :condition () :effect (at end (wet)))
  (:durative-action look :parameters () :duration (= ?duration 1) :condition (at start (clean)) :effect (at end (seen))))
""")


def mops(init: str, goal: str) -> Problem:
    return parse_problem(f"(define (problem p) (:domain mops) (:init {init}) (:goal {goal}))", MOPS)


@pytest.mark.parametrize("assumed", [frozenset[str](), frozenset({"wet", "clean", "streaked"})])
@pytest.mark.parametrize("wet", [True, False])
def test_an_early_condition_is_decided_before_the_start_changes_it(wet: bool, assumed: frozenset[str]) -> None:
    problem = mops("(wet)" if wet else "", f"(and {'(clean)' if wet else '(not (clean))'} (not (streaked)))")
    graph = plan_graph(problem, timed("0 5 mop"))
    assert why_not(Progress.beginning(graph), initial_knowledge(problem)) == ""

    async def scenario(simulation: SimulatedSite) -> None:
        result = await simulation.run(graph)
        assert result.goal, result.reason
        for state in (simulation.truth, simulation.knowledge.value):
            assert (state(("clean",)) is True, state(("streaked",)) is True) == (wet, False)

    with_site(problem, scenario, bindings=Bindings(assumed=assumed))


def test_a_condition_that_is_not_early_is_decided_at_the_end() -> None:
    problem = mops("", "(and (streaked) (not (clean)))")
    plan = timed("0 5 mop", "1 2 hose")
    assert why_not(Progress.beginning(plan_graph(problem, plan)), initial_knowledge(problem)) == ""

    async def scenario(simulation: SimulatedSite) -> None:
        assert (await simulation.run(plan_graph(problem, plan))).goal

    with_site(problem, scenario)


def test_an_effect_decided_at_the_start_is_missed_at_the_end() -> None:
    problem = mops("(wet)", "(clean)")

    async def scenario(simulation: SimulatedSite) -> None:
        result = await simulation.run(plan_graph(problem, timed("0 5 mop")))
        assert [(one.cause, one.expected) for one in result.failures] == [("effects_missing", "(not (wet)) (clean)")]

    with_site(problem, scenario, Faults((Fault("mop", FaultKind.NO_EFFECT),)), Bindings({"mop": Binding(retries=0)}))


def test_the_start_reads_an_early_condition_and_the_end_writes() -> None:
    problem = mops("", "(seen)")
    graph = plan_graph(problem, timed("0 2 hose", "2.001 5 wipe", "7.002 1 look"))
    assert shown(graph) == ["end of #0 < start of #1 ((wet))", "end of #1 < start of #2 ((clean))"]
    later = plan_graph(problem, timed("0 5 wipe", "1 2 hose"))
    assert "start of #0 < end of #1 ((wet))" in shown(later)
