"""What plans need and change: whether they can go on side by side, plans around others, and when others are done with what they need."""

from __future__ import annotations

import random
from dataclasses import replace
from itertools import combinations, permutations, zip_longest

import pytest

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.plan import Plan
from planner_bridge.model.problem import Problem
from planner_bridge.model.progression import NotApplicable, Progression, calls_of, snapshot
from planner_bridge.ordering.interference import (
    FootprintIndex,
    Forecast,
    ReadWriteSets,
    avoid_interference,
    awaited,
    forecast,
    interference,
    read_write_sets,
    with_forecasts,
)
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.planning.solve import solve
from planner_bridge.planning.validate import why_invalid
from pnm.core.knowledge_base import parse_fluent
from pnm.core.logic.conditions import evaluate
from pnm.core.logic.expressions import Fluent
from pnm.core.machine.plan_graph import Moment, PlanGraph
from tests.support.pddl.problems import rooms, tanks
from tests.support.pddl.vans import vans


def graph_of(problem: Problem) -> PlanGraph:
    found = solve(problem)
    assert found.plan is not None, found
    return plan_graph(problem, found.plan)


def footprint_of(problem: Problem) -> ReadWriteSets:
    graph = graph_of(problem)
    return read_write_sets(graph.calls, graph.goal, initial_knowledge(problem))


R1_TO_C = footprint_of(rooms(goal="(at r1 c)"))
R1_IN_A = ReadWriteSets(facts={("at", "r1", "a"): frozenset({True})})
CLEAN = frozenset({True})
KEEPS_CLEAN = ReadWriteSets(facts={("clean", "a"): CLEAN}, writes={("clean", "a"): CLEAN})


@pytest.mark.parametrize(
    ("one", "other", "said"),
    [
        (R1_TO_C, footprint_of(rooms(goal="(at r2 c)")), ""),
        (R1_TO_C, footprint_of(rooms(goal="(at r1 d)")), "(at r1 "),
        (R1_TO_C, R1_IN_A, "it would change (at r1 a), which the other needs"),  # a goal that holds is needed until the task is over
        (KEEPS_CLEAN, KEEPS_CLEAN, ""),
        # it sweeps what must not be clean yet
        (footprint_of(rooms("(at r1 a) (at r2 a)", "(clean a)")), KEEPS_CLEAN, "it needs (clean a), which the other is going to change"),
        (footprint_of(tanks()), ReadWriteSets(writes={("level", "a"): frozenset({None})}), "(level a)"),
    ],
)
def test_plans_are_in_conflict_over_what_one_changes_and_the_other_needs(one: ReadWriteSets, other: ReadWriteSets, said: str):
    assert said in interference(one, other)
    assert bool(interference(one, other)) is bool(interference(other, one)) is bool(said)


def test_who_may_interfere_is_found_by_what_is_used_and_written():
    rng, index, noted = random.Random(0), FootprintIndex[int](), dict[int, ReadWriteSets | None]()
    fluents: list[Fluent] = [("f", str(number)) for number in range(12)]

    def drawn() -> ReadWriteSets:
        facts, reads, writes = (rng.sample(fluents, rng.randrange(3)) for _ in range(3))
        return ReadWriteSets(dict.fromkeys(facts, CLEAN), frozenset(reads), dict.fromkeys(writes, frozenset({None})))

    def touch(one: ReadWriteSets, other: ReadWriteSets) -> bool:
        return not (one.used.isdisjoint(other.writes) and other.used.isdisjoint(one.writes))

    for _ in range(500):
        key, mine = rng.randrange(8), drawn()
        if rng.random() < 0.3:
            index.forget(key)
            noted.pop(key, None)
        else:
            noted[key] = None if rng.random() < 0.1 else drawn()
            index.note(key, noted[key])
        assert index.near(mine) == {one for one, sets in noted.items() if sets is None or touch(sets, mine)}
        assert index.near(mine) >= {one for one, sets in noted.items() if sets and interference(mine, sets)}
        assert index.has_other(key) == bool(noted.keys() - {key})


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


# --- when others are done with what they need ---


PLACES = ("home near 15", "near shop 1", "depot far 10", "far shop 60")


def world(goal: str) -> Problem:
    return vans("v1 home v2 depot", *PLACES, goal=goal)


def plan_for(problem: Problem) -> Plan:
    result = solve(problem)
    assert result.plan is not None, result
    return result.plan


def expected(goal: str, *, under_way: float | None = None, lost: str = "") -> Forecast:
    """Forecast a plan for the goal; its first call may be under way, with so many seconds left, and a fact may be lost."""
    problem = world(goal)
    graph = plan_graph(problem, plan_for(problem))
    state = initial_knowledge(problem)
    events, left = graph.order, dict[int, float]()
    if under_way is not None:
        events, left = tuple(event for event in events if (event.call, event.moment) != (0, Moment.START)), {0: under_way}
        state.update({("at", "v1", "home"): False})
    if lost:
        state.update({parse_fluent(lost): False})
    return forecast(graph, events, left, state)


def released(forecast: Forecast, fact: str) -> float | None:
    return forecast.released.get(parse_fluent(fact))


def test_each_fact_is_released_when_the_last_call_that_needs_it_is_over() -> None:
    both = expected("(and (at v1 shop) (at v2 far))")
    assert released(both, "(at v1 home)") == pytest.approx(15.0)
    assert released(both, "(at v1 near)") == pytest.approx(16.0)
    assert released(both, "(at v2 depot)") == pytest.approx(10.0)


def test_what_the_goal_says_is_released_with_the_last_call() -> None:
    both = expected("(and (at v1 shop) (at v2 far))")
    assert released(both, "(at v2 far)") == released(both, "(at v1 shop)") == pytest.approx(16.0)


def test_what_is_left_behind_is_known() -> None:
    values = expected("(at v1 shop)").values
    assert values == {("at", "v1", "home"): False, ("at", "v1", "near"): False, ("at", "v1", "shop"): True}


def test_of_a_call_that_is_under_way_the_seconds_that_are_left_count() -> None:
    assert released(expected("(at v1 shop)", under_way=4.0), "(at v1 shop)") == pytest.approx(5.0)


def test_of_a_plan_that_does_not_work_any_more_nothing_is_expected() -> None:
    broken = expected("(at v1 shop)", lost="(at v1 home)")
    assert (dict(broken.released), dict(broken.values)) == ({}, {})
    assert parse_fluent("(at v1 shop)") in broken.needed.writes


@pytest.mark.parametrize(("goal", "van", "waits"), [("(at v1 near)", "v1", 15.0), ("(at v1 shop)", "v1", 16.0)])
def test_a_planner_weighs_waiting_for_a_busy_robot(goal: str, van: str, waits: float) -> None:
    problem, other = world("(served shop)"), expected(goal)
    waiting = with_forecasts(problem, [other])
    plan = plan_for(waiting)
    assert {step.arguments[0] for step in plan.steps} == {van}
    assert plan.steps[0].start >= waits
    needed = read_write_sets(calls_of(waiting, plan), problem.goal, initial_knowledge(waiting))
    assert awaited(needed, other) == (("at", "v1", goal[7:-1]), pytest.approx(waits))


def test_before_its_release_nothing_that_others_need_is_had_and_after_it_everything() -> None:
    problem = world("(at v1 depot)")
    with_way_back = replace(problem, init={**problem.init, ("way", "near", "depot"): True, ("seconds", "near", "depot"): 1.0})
    waiting = with_forecasts(with_way_back, [expected("(at v1 near)")])
    too_early = plan_for(replace(with_way_back, goal=problem.goal))
    assert why_invalid(waiting, too_early)
    assert plan_for(waiting).steps[0].start >= 15.0


def test_without_a_forecast_what_others_need_is_not_to_be_had_at_all() -> None:
    needed = expected("(at v1 near)").needed
    problem = with_forecasts(world("(at v1 shop)"), [Forecast(needed)])
    assert solve(problem).plan is None
    assert awaited(needed, Forecast(needed)) is None


def test_a_call_that_has_to_begin_anew_is_not_under_way_any_more() -> None:
    problem = world("(served shop)")
    graph = plan_graph(problem, plan_for(problem))
    begins_anew = replace(graph, steps=(replace(graph.steps[0], under_way=True), *graph.steps[1:]))
    state = initial_knowledge(problem)
    assert forecast(begins_anew, graph.order, {}, state) == forecast(graph, graph.order, {}, state)
