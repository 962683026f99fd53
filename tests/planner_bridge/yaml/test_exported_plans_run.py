"""A plan that is exported and run does what running its PDDL files does: the same calls, and the same world in the end."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import pytest

from planner_bridge.cli.convert import exported
from planner_bridge.model.world import simulated_backend
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.pipeline.achieve import achieve_at
from planner_bridge.pipeline.loading import load
from planner_bridge.planning.solve import solve
from planner_bridge.tasks.settings import Settings, TaskObserver
from pnm.clock import run_async
from pnm.core.execution.call_results import CallResult
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.expressions import Fluent, Unknown, Value
from pnm.language.plan import HandWrittenPlan, merge_bindings, parse_plans, read_plans
from pnm.language.runner import PlanRunner, Program
from tests.support.pddl.files import OWN, Pair, name_of, pairs

Told = tuple[bool, list[tuple[str, ...]], dict[Fluent, Value | Unknown]]

SMALLEST: Final = (
    *("rosplan_test", "lights", "match_cellar", "simple_1", "turtlebot", "amazon", "test_2", "ipc2011-match-cellar-temporal_s", "blocks_m"),
    *("gripper_s", "miconic_s", "zenotravel_s", "satellite_s", "ipc2008-openstacks-temporal-adl_s"),
)
"""Those of the smallest for which there is a plan."""
BESIDE: Final = [(folder / "domain.pddl", folder / "problem.pddl") for folder in pairs() if folder.name in SMALLEST]
FEW: Final = [pair for pair in OWN if pair[0].parent.name in ("delivery", "mall_guide", "patrol") and pair[1].stem in ("p01", "p02")]


def calls_told(calls: tuple[CallResult, ...]) -> list[tuple[str, ...]]:
    return sorted((one.call.action.name, *one.call.action.arguments, one.outcome, str(one.attempts)) for one in calls)


def planned(domain: Path, problem: Path) -> Told:
    loaded = load(domain, problem)
    backend = simulated_backend(loaded, Settings().bindings)
    result = run_async(achieve_at(backend, loaded, Settings(improve=0.0), TaskObserver()), virtual=True)
    return result.goal_reached, calls_told(result.calls), backend.robots.world.truth.facts()


def run_exported(plan: HandWrittenPlan) -> Told:
    backend = simulated_backend(plan, merge_bindings([plan]))

    async def performed() -> Told:
        runner = PlanRunner({plan.name: Program.of(plan)}, backend, KnowledgeBase(plan.facts, objects=plan.objects, rules=plan.rules))
        await backend.open(runner.world)
        result = await runner.execute(runner.prepare_run(plan.name))
        await backend.close()
        return result.goal, calls_told(result.calls), backend.robots.world.truth.facts()

    return run_async(performed(), virtual=True)


@pytest.mark.parametrize("pair", [*FEW, *BESIDE], ids=name_of)
def test_the_exported_plan_does_the_same(pair: Pair, tmp_path: Path) -> None:
    file = tmp_path / "exported.yaml"
    file.write_text(exported(*pair, with_plan=True, improve=0.0).text, encoding="utf-8")  # the same plan every time
    (plan,) = read_plans(file).values()
    expected = planned(*pair)
    assert expected[0]
    assert run_exported(plan) == expected


TIMED = """(define (domain d) (:requirements :durative-actions :timed-initial-literals) (:predicates (tide) (done))
  (:durative-action dig :parameters () :duration (= ?duration 4) :condition {condition} :effect (at end (done))))"""


@pytest.mark.parametrize(
    ("condition", "init", "goal"),
    [
        ("()", "(at 7 (tide))", "(and (done) (tide))"),
        ("()", "(tide) (at 7 (not (tide)))", "(and (done) (not (tide)))"),
        ("(at end (tide))", "(at 7 (tide)) (at 9 (not (tide)))", "(done)"),
        ("(at start (tide))", "(at 3 (tide)) (at 6 (not (tide)))", "(done)"),
    ],
)
def test_time_is_waited_for_as_without_the_export(condition: str, init: str, goal: str, tmp_path: Path) -> None:
    files = tmp_path / "domain.pddl", tmp_path / "problem.pddl"
    files[0].write_text(TIMED.format(condition=condition))
    files[1].write_text(f"(define (problem p) (:domain d) (:init {init}) (:goal {goal}))")
    plan_file = tmp_path / "plan.yaml"
    plan_file.write_text(exported(*files, with_plan=True, improve=0.0).text)
    (plan,) = read_plans(plan_file).values()
    problem = load(*files)
    found = solve(problem, improve=0.0).plan
    assert found
    graph = plan_graph(problem, found)
    assert plan.graph.due == graph.due
    assert [(call.release, call.latest_start, call.deadline) for call in plan.graph.calls] == [
        (call.release, call.latest_start, call.deadline) for call in graph.calls
    ]
    expected = planned(*files)
    assert expected[0]
    assert run_exported(plan) == expected


def test_simulated_sensors_report_what_any_action_of_the_domain_changes() -> None:
    (plan,) = parse_plans("predicates: [(a), (b)]\nactions: {x: {effects: [(a)]}, y: {effects: [(b)]}}\nplan: [x: ]").values()
    assert simulated_backend(plan, merge_bindings([plan])).robots.world.reported() == {"a", "b"}
