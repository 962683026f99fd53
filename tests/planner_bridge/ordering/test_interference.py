"""What plans need and change, whether they can go on side by side, and plans that leave others alone."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations, permutations, zip_longest

import pytest

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.problem import Problem
from planner_bridge.model.progression import NotApplicable, Progression, snapshot
from planner_bridge.ordering.interference import ReadWriteSets, avoid_interference, interference, read_write_sets
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.planning.solve import solve
from pnm.core.logic.conditions import evaluate
from pnm.core.machine.plan_graph import PlanGraph
from tests.support.pddl.problems import rooms, tanks


def graph_of(problem: Problem) -> PlanGraph:
    found = solve(problem)
    assert found.plan is not None, found
    return plan_graph(problem, found.plan)


def footprint_of(problem: Problem) -> ReadWriteSets:
    graph = graph_of(problem)
    return read_write_sets(graph.calls, graph.goal, initial_knowledge(problem))


def test_plans_of_different_robots_are_in_no_conflict():
    one, two = footprint_of(rooms(goal="(at r1 c)")), footprint_of(rooms(goal="(at r2 c)"))
    assert interference(one, two) == interference(two, one) == ""


def test_plans_of_one_robot_are_in_conflict_and_both_say_over_what():
    one, two = footprint_of(rooms(goal="(at r1 c)")), footprint_of(rooms(goal="(at r1 d)"))
    assert "(at r1 " in interference(one, two)
    assert "(at r1 " in interference(two, one)


def test_a_goal_that_holds_is_needed_until_the_task_is_over():
    resting = ReadWriteSets(facts={("at", "r1", "a"): frozenset({True})})
    assert interference(footprint_of(rooms(goal="(at r1 c)")), resting) == "it would change (at r1 a), which the other needs"


def test_what_both_make_so_is_no_conflict():
    one = footprint_of(rooms("(at r1 a) (at r2 a)", "(clean a)"))
    two = ReadWriteSets(facts={("clean", "a"): frozenset({True})}, writes={("clean", "a"): frozenset({True})})
    assert interference(two, two) == ""
    assert interference(one, two) == "it needs (clean a), which the other is going to change"  # it sweeps what must not be clean yet


def test_numbers_that_are_compared_must_not_be_changed_by_others():
    one = footprint_of(tanks())
    assert interference(one, ReadWriteSets(writes={("level", "a"): frozenset({None})}))


def test_what_calls_are_under_way_for_is_needed_to_their_end_only():
    problem = rooms(goal="(at r1 b)", ways="ab")
    (call,) = graph_of(problem).calls
    left = read_write_sets([replace(call, under_way=True)], problem.goal, initial_knowledge(problem))
    assert ("at", "r1", "a") not in left.facts
    assert left.writes[("at", "r1", "b")] == {True}


def test_a_plan_around_another_one_uses_another_robot():
    problem = rooms(goal="(exists (?r - robot) (at ?r c))")
    first = graph_of(problem)
    mine = read_write_sets(first.calls, first.goal, initial_knowledge(problem))
    second = solve(avoid_interference(problem, [mine])).plan
    assert second is not None
    assert {step.arguments[0] for step in second.steps} != {call.action.arguments[0] for call in first.calls}
    graph = plan_graph(problem, second)
    assert interference(read_write_sets(graph.calls, graph.goal, initial_knowledge(problem)), mine) == ""


def test_there_may_be_no_plan_around_another_one():
    problem = rooms(goal="(at r1 c)")
    assert solve(avoid_interference(problem, [footprint_of(rooms(goal="(at r1 d)"))])).plan is None


def test_a_fact_that_others_need_is_not_changed_by_a_plan_around_them():
    problem = rooms(goal="(exists (?r - robot) (at ?r b))")
    for robot, other in permutations(("r1", "r2")):
        found = solve(avoid_interference(problem, [ReadWriteSets(facts={("at", robot, "a"): frozenset({True})})])).plan
        assert found is not None
        assert {step.arguments[0] for step in found.steps} == {other}


def test_a_fact_that_must_stay_false_is_not_made_true():
    problem = rooms(goal="(at r1 c)")
    kept = ReadWriteSets(facts={("at", "r1", "b"): frozenset({False})})
    found = solve(avoid_interference(problem, [kept])).plan
    assert found is not None
    assert "b" not in {argument for step in found.steps for argument in step.arguments}


@pytest.mark.parametrize("goals", list(combinations(["(at r1 c)", "(at r2 c)", "(at r1 d)", "(clean a)", "(clean c)", "(at r2 b)"], 2)))
def test_plans_without_conflict_work_in_every_order_of_their_events(goals: tuple[str, str]):
    """The oracle: carry both plans out, one event of either at a time, in some orders of each kind."""
    problem = rooms()
    graphs = [graph_of(rooms(goal=goal)) for goal in goals]
    one, two = (read_write_sets(graph.calls, graph.goal, initial_knowledge(problem)) for graph in graphs)
    works = all(_works(problem, graphs, first) for first in range(4))
    assert works or interference(one, two)


def _works(problem: Problem, graphs: list[PlanGraph], pattern: int) -> bool:
    """Carry the plans out: one after the other, or taking turns."""
    course = Progression(snapshot(initial_knowledge(problem)))
    queues = [[(number, graph, event) for event in graph.order] for number, graph in enumerate(graphs)]
    if pattern % 2:
        queues.reverse()
    mixed = [*queues[0], *queues[1]] if pattern < 2 else [one for pair in zip_longest(*queues) for one in pair if one]
    try:
        for number, graph, event in mixed:
            moved = type(event)(event.call + 1000 * number, event.moment)
            course.advance([(moved, graph.calls[event.call].action)])
    except NotApplicable:
        return False
    return all(evaluate(graph.goal, course.state) is True for graph in graphs)
