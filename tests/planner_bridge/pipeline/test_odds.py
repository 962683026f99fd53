"""Odds of plans: laws, an independent calculation, and runs of the machine itself."""

from __future__ import annotations

from dataclasses import replace
from math import prod, sqrt
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.problem import Problem
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.pipeline.odds import Attempt, CallOdds, Ending, Leads, Odds, declared, exact, odds_of_calls, percent
from planner_bridge.pipeline.roll_outs import roll_outs_of_goal
from planner_bridge.planning.solve import solve
from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.settings import Settings
from pnm.actions.faults import NO_FAULTS, Fault, FaultKind, Faults
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.plan_graph import ActionCall, GroundAction, Moment, Ordering, PlanEvent, PlanGraph
from tests.support.pddl.vans import vans

chances = st.floats(0.0, 1.0)


def attempt(done: float, again: float) -> Attempt:
    kinds = zip(Leads, (done, again, max(0.0, 1.0 - done - again)), (3.0, 1.0, 2.0), strict=True)
    return Attempt(tuple(Ending(leads, chance, ((seconds, 1.0),)) for leads, chance, seconds in kinds), "declared")


@st.composite
def calls(draw: st.DrawFn) -> CallOdds:
    done = draw(chances)
    return CallOdds(ActionCall(0, GroundAction("a")), attempt(done, (1.0 - done) * draw(chances)), draw(st.integers(0, 5)))


@given(calls(), st.integers(0, 4))
def test_more_retries_never_lower_the_chance(call: CallOdds, more: int) -> None:
    assert 0.0 <= call.chance() <= call.chance(more) <= 1.0 + 1e-12


@given(calls())
def test_a_time_is_that_of_some_number_of_attempts(call: CallOdds) -> None:
    if call.chance():
        assert {*call.draws(Random(1), 20)} <= {3.0 + failed for failed in range(call.retries + 1)}


def series(length: int, seed: int) -> tuple[PlanGraph, Faults, Bindings]:
    """A plan of calls one after the other, each with a chance of its own to abort, and actions with retries of their own."""
    random, steps = Random(seed), range(length)
    calls = tuple(ActionCall(number, GroundAction(f"a{number % 4}", (str(number),), duration=2.0)) for number in steps)
    orderings = tuple(Ordering(PlanEvent(number, Moment.END), PlanEvent(number + 1, Moment.START)) for number in steps[:-1])
    faults = tuple(Fault(str(call.action), FaultKind.ABORT, chance=random.uniform(0.0, 0.3)) for call in calls)
    return PlanGraph(calls, orderings), Faults(faults), Bindings({f"a{retries}": Binding(retries=retries) for retries in range(4)})


def odds_of(graph: PlanGraph, faults: Faults, bindings: Bindings) -> Odds:
    found = odds_of_calls(graph, bindings, declared(faults, bindings, 1.0))
    assert found is not None
    odds = exact(graph, found, KnowledgeBase())
    assert odds is not None
    return odds


def chain(graph: PlanGraph, faults: Faults, bindings: Bindings) -> list[tuple[int, int, float]]:
    """The Markov chain of a series: transitions between attempts, then the goal, then failure; written down without the code under test."""
    first, moves = 0, list[tuple[int, int, float]]()
    number = sum(bindings.of(call.action.name).retries + 1 for call in graph.calls)
    for call, fault in zip(graph.calls, faults.faults, strict=True):
        tries = bindings.of(call.action.name).retries + 1
        for state in range(first, first + tries):
            is_last = state + 1 == first + tries
            moves += [(state, first + tries, 1.0 - fault.chance), (state, number + 1 if is_last else state + 1, fault.chance)]
        first += tries
    return moves


def test_the_chance_of_200_calls_is_that_of_the_linear_equations_of_their_chain() -> None:
    plan = series(200, 1)
    moves = chain(*plan)
    inner = max(state for state, _, _ in moves) + 1
    among, out = np.zeros((inner, inner)), np.zeros(inner)
    for before, after, chance in moves:
        if after < inner:
            among[before, after] += chance
        elif after == inner:
            out[before] += chance
    assert odds_of(*plan).chance == pytest.approx(np.linalg.solve(np.eye(inner) - among, out)[0], abs=1e-9)


def test_what_never_fails_is_certain_and_takes_as_long_as_it_is_long() -> None:
    graph, _, bindings = series(20, 1)
    odds = odds_of(graph, NO_FAULTS, bindings)
    assert (odds.chance, odds.interval, {*odds.times}) == (1.0, (1.0, 1.0), {40.0})


def test_calls_that_depend_on_each_other_have_no_exact_odds() -> None:
    graph, faults, bindings = series(3, 1)
    for fault in (Fault("a1", FaultKind.ABORT, times=1), Fault("a1", FaultKind.LOSE_SERVER), Fault("a1", FaultKind.ABORT, after=1)):
        assert odds_of_calls(graph, bindings, declared(Faults((fault,)), bindings, 1.0)) is None
    late = replace(graph, steps=(replace(graph.calls[0], deadline=9.0), *graph.calls[1:]))
    assert odds_of_calls(late, bindings, declared(faults, bindings, 1.0)) is None


WORLDS = (
    vans("v a", "a b 4", "b c 6", goal="(and (served b) (served c))"),
    vans("v a w a", "a b 4", "a c 6", "c d 2", goal="(and (served b) (served c) (served d))"),
)


@settings(max_examples=6, deadline=None, derandomize=True)
@given(st.sampled_from(WORLDS), st.sampled_from([*FaultKind][:5]), st.floats(0.05, 0.6), st.integers(0, 2))
def test_exact_odds_are_those_of_runs_of_the_machine(problem: Problem, kind: FaultKind, chance: float, retries: int) -> None:
    found = solve(problem, improve=0.0).plan
    assert found is not None
    bindings = Bindings({name: Binding(retries=retries) for name in ("drive", "serve")})
    faults = Faults((Fault("drive", kind, chance=chance), Fault("serve", FaultKind.ABORT, chance=0.2)))
    graph = plan_graph(problem, found)
    calls = odds_of_calls(graph, bindings, declared(faults, bindings, 0.0))
    assert calls is not None
    odds = exact(graph, calls, initial_knowledge(problem))
    assert odds is not None
    limits = Limits(replans=0)
    runs = roll_outs_of_goal(problem, found, Settings(improve=0.0, bindings=bindings, limits=limits), faults, 60.0, most=150)
    assert runs is not None
    assert runs.runs == 150
    assert abs(runs.chance - odds.chance) <= 4.0 * sqrt(odds.chance * (1.0 - odds.chance) / runs.runs) + 1e-9
    mean = sum(odds.times) / len(odds.times)
    spread = sqrt(sum((time - mean) ** 2 for time in odds.times) / len(odds.times))
    if runs.times:
        assert abs(sum(runs.times) / len(runs.times) - mean) <= 4.0 * spread / sqrt(len(runs.times)) + 0.1
    assert odds.chance == pytest.approx(prod(call.chance() for call in calls))


def test_new_plans_raise_the_chance() -> None:
    problem, bindings = WORLDS[0], Bindings({"drive": Binding(retries=0)})
    found = solve(problem, improve=0.0).plan
    assert found is not None
    faults = Faults((Fault("drive", FaultKind.ABORT, chance=0.4),))
    alone, many = (
        roll_outs_of_goal(problem, found, Settings(improve=0.0, bindings=bindings, limits=Limits(replans=replans)), faults, 60.0, most=60)
        for replans in (0, 10)
    )
    assert alone is not None
    assert many is not None
    assert alone.interval[1] < many.interval[1]
    assert alone.chance < many.chance


@pytest.mark.parametrize(("chance", "words"), [(1.0, "100 %"), (0.0, "0 %"), (0.5, "50.0 %"), (0.99996, "99.996 %"), (0.00001, "0.001 %")])
def test_a_chance_in_words_is_told_from_certainty(chance: float, words: str) -> None:
    assert percent(chance) == words
