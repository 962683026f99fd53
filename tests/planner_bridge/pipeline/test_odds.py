"""Odds of plans: laws, an independent calculation, and runs of the machine itself."""

from __future__ import annotations

from dataclasses import replace
from math import prod, sqrt
from pathlib import Path
from random import Random

import numpy as np
import pytest
import stormpy
from hypothesis import given, settings, strategies as st

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.plan import Plan
from planner_bridge.model.problem import Problem
from planner_bridge.model.rates import Call, Counts, End, Rates, Times, step_of
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.ordering.robot_time import ExpectedTimes
from planner_bridge.pipeline.odds import (
    AttemptEnd,
    AttemptOdds,
    Attempts,
    CallOdds,
    KnownRobots,
    Leads,
    Odds,
    chance_of,
    declared,
    exact,
    learned,
    odds_of_calls,
)
from planner_bridge.pipeline.roll_outs import in_one_world, odds_of_goal, played
from planner_bridge.planning.solve import solve
from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.settings import Settings
from pnm.actions.faults import NO_FAULTS, Fault, FaultKind, Faults
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.expressions import Fluent, Value
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.plan_graph import ActionCall, GroundAction, Moment, Ordering, PlanEvent, PlanGraph
from pnm.tasks import percent
from tests.support.pddl.vans import vans

chances = st.floats(0.0, 1.0)
ENDS = tuple(AttemptEnd(leads, share, ((1.0, 1.0),)) for leads, share in ((Leads.DONE, 0.6), (Leads.AGAIN, 0.4)))


def attempt(done: float, again: float) -> AttemptOdds:
    kinds = zip(Leads, (done, again, max(0.0, 1.0 - done - again)), (3.0, 1.0, 2.0), strict=True)
    return AttemptOdds(tuple(AttemptEnd(leads, chance, ((seconds, 1.0),)) for leads, chance, seconds in kinds), "declared")


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
    faults = tuple(Fault(str(call.action), FaultKind.ABORT, chance=random.uniform(0.0, 0.05)) for call in calls)
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


def test_the_chance_of_200_calls_is_that_of_a_model_checker(tmp_path: Path) -> None:
    plan = series(200, 2)
    moves = chain(*plan)
    goal = max(state for state, _, _ in moves) + 1
    moves += [(goal, goal, 1.0), (goal + 1, goal + 1, 1.0)]
    lines = ["@type: DTMC", "@parameters", "", "@reward_models", "", "@nr_states", f"{goal + 2}", "@nr_choices", f"{goal + 2}", "@model"]
    labels = {0: "init", goal: "goal"}
    for state in range(goal + 2):
        lines += [f"state {state} {labels.get(state, '')}", "\taction 0"]
        lines += [f"\t\t{after} : {chance!r}" for before, after, chance in moves if before == state]
    file = tmp_path / "chain.drn"
    file.write_text("\n".join((*lines, "")))
    model = stormpy.build_model_from_drn(str(file))
    result = stormpy.model_checking(model, stormpy.parse_properties('P=? [F "goal"]')[0])
    assert odds_of(*plan).chance == pytest.approx(result.get_value(model.initial_states[0]), abs=1e-9)


@given(st.lists(st.integers(0, 4), min_size=1, max_size=8))
def test_the_chance_of_calls_that_rest_on_one_estimate_is_its_mean_over_what_that_may_be(retries: list[int]) -> None:
    alike = [CallOdds(ActionCall(0, GroundAction("a")), AttemptOdds(ENDS, "learned", total=5.0), number) for number in retries]
    nodes, weights = np.polynomial.legendre.leggauss(64)  # of what is a polynomial, this integral is exact
    again = (1.0 - nodes) / 2.0
    density = 6.0 * (1.0 - again) ** 2 * again  # of a beta distribution with 3 successes and 2 failures, on half of the length
    mean = float(weights @ (density * prod(1.0 - again ** (number + 1) for number in retries)))
    assert chance_of(alike) == pytest.approx(mean, abs=1e-9)
    assert chance_of([replace(call, attempt=replace(call.attempt, total=1e12)) for call in alike]) == pytest.approx(
        prod(call.chance() for call in alike), abs=1e-9
    )


def test_in_one_world_all_that_rests_on_one_estimate_has_the_same_chance() -> None:
    def chances(rests: str, number: int) -> set[float]:
        world = in_one_world(lambda action: AttemptOdds(ENDS, rests, total=5.0), Random(number))
        return {found.chance(Leads.DONE) for name in "ab" if (found := world(GroundAction(name)))}

    assert [len(chances("learned", number)) for number in (1, 2)] == [1, 1]
    assert chances("learned", 1) != chances("learned", 2)
    assert chances("assumed", 1) == {0.6}


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
    bindings = Bindings({name: Binding(retries=retries) for name in ("drive", "serve")})
    declaring = Faults((Fault("drive", kind, chance=chance), Fault("serve", FaultKind.ABORT, chance=0.2)))
    calls = odds_of_calls(graph_of(problem), bindings, declared(declaring, bindings, 0.0))
    assert calls is not None
    agree(exact(graph_of(problem), calls, initial_knowledge(problem)), rolled(problem, bindings, declaring, replans=0))


def test_odds_of_learned_rates_are_those_of_robots_that_play_them() -> None:
    problem, bindings = WORLDS[1], Bindings({"drive": Binding(retries=1)})
    ends = {End.SUCCEEDED: 70, End.ABORTED: 20, End.ABORTED_FOR_GOOD: 5, End.REJECTED: 10}
    counts = Counts(ends, Times({80: 30, 100: 40}, 350_000), Times({20: 35}, 60_000))
    rates = Rates({Call("drive", "drive", ("v", "a", "b")): counts})
    attempts = learned(ExpectedTimes(bindings, rates))
    calls = odds_of_calls(graph_of(problem), bindings, attempts)
    assert calls is not None
    odds = exact(graph_of(problem), calls, initial_knowledge(problem))
    assert odds is not None
    assert odds.interval[0] < odds.chance < odds.interval[1]
    assert {call.attempt.rests for call in calls} == {"learned from 105 of drive", "assumed"}
    agree(odds, rolled(problem, bindings, played(attempts), replans=0))


def test_seconds_that_nobody_has_measured_are_those_of_the_binding() -> None:
    attempt = learned(ExpectedTimes(Bindings({"wave": Binding(seconds=7.0)})))(GroundAction("wave"))
    assert attempt is not None
    assert {seconds for end in attempt.endings for seconds, _ in end.seconds} == {7.0}


def test_a_function_of_the_problem_says_how_long_each_call_takes() -> None:
    bindings = Bindings({"drive": Binding(seconds=("lasts", "?from", "?to"))})
    told: dict[Fluent, Value] = {("lasts", "a", "b"): 40.0, ("lasts", "c", "d"): 2.0}
    attempts = KnownRobots().attempts(bindings, told, is_timed=False)
    seen = Rates({Call("drive", "drive", ("v", "a", "b")): Counts({End.SUCCEEDED: 2}, Times({step_of(10.0): 2}, 20_000))})
    both = KnownRobots(seen).attempts(bindings, told, is_timed=False)
    drives = [GroundAction("drive", (van, *way), ("van", "from", "to")) for van, way in (("v", "ab"), ("w", "cd"))]

    def seconds(action: GroundAction, attempts: Attempts) -> float:
        ((ending,),) = [[one for one in found.endings if one.leads is Leads.DONE] for found in [attempts(action)] if found]
        return sum(time * weight for time, weight in ending.seconds) / sum(weight for _, weight in ending.seconds)

    assert [seconds(drive, attempts) for drive in drives] == [40.0, 2.0]
    assert [seconds(drive, both) for drive in drives] == pytest.approx([25.0, 2.0]), "what was learned of another call does not count"


def graph_of(problem: Problem) -> PlanGraph:
    return plan_graph(problem, plan_of(problem))


def plan_of(problem: Problem) -> Plan:
    found = solve(problem, improve=0.0).plan
    assert found is not None
    return found


def rolled(problem: Problem, bindings: Bindings, faults: Faults, *, replans: int) -> Odds:
    """The odds by 150 runs, even where they are known exactly: the last fault never happens, and makes nothing exact."""
    chosen = Settings(improve=0.0, bindings=bindings, limits=Limits(replans=replans))
    never = replace(faults, faults=(*faults.faults, Fault("drive", FaultKind.ABORT, times=0)))
    odds = odds_of_goal(problem, plan_of(problem), chosen, never, seconds=600.0, most=150).rolled
    assert odds is not None
    assert odds.runs == 150
    return odds


def agree(odds: Odds | None, runs: Odds) -> None:
    assert odds is not None
    assert abs(runs.chance - odds.chance) <= 4.0 * sqrt(odds.chance * (1.0 - odds.chance) / runs.runs) + 1e-9
    mean = sum(odds.times) / len(odds.times)
    spread = sqrt(sum((time - mean) ** 2 for time in odds.times) / len(odds.times))
    if runs.times:
        assert abs(sum(runs.times) / len(runs.times) - mean) <= 4.0 * spread / sqrt(len(runs.times)) + 0.1


def test_new_plans_raise_the_chance() -> None:
    bindings, faults = Bindings({"drive": Binding(retries=0)}), Faults((Fault("drive", FaultKind.ABORT, chance=0.4),))
    alone, many = (rolled(WORLDS[0], bindings, faults, replans=replans) for replans in (0, 10))
    assert alone.interval[1] < many.interval[0]


def test_what_is_known_exactly_is_not_estimated_again() -> None:
    bindings, faults = Bindings({"drive": Binding(retries=0)}), Faults((Fault("drive", FaultKind.ABORT, chance=0.1),))
    settings = Settings(improve=0.0, bindings=bindings)
    exactly = rolled(WORLDS[0], bindings, faults, replans=100)
    found = odds_of_goal(WORLDS[0], plan_of(WORLDS[0]), settings, faults, seconds=600.0, most=150)
    assert found.alone is not None
    assert found.rolled is not None
    assert found.alone.chance <= found.rolled.interval[0] <= found.rolled.chance <= found.rolled.interval[1]
    assert max(found.rolled.interval[0], exactly.interval[0]) <= min(found.rolled.interval[1], exactly.interval[1])
    hardly = odds_of_goal(WORLDS[0], plan_of(WORLDS[0]), settings, Faults((Fault("drive", FaultKind.ABORT, chance=1e-9),)), most=1).rolled
    assert hardly is not None
    assert hardly.chance > 1.0 - 1e-8


@pytest.mark.parametrize(("chance", "words"), [(1.0, "100 %"), (0.0, "0 %"), (0.5, "50.0 %"), (0.99996, "99.996 %"), (0.00001, "0.001 %")])
def test_a_chance_in_words_is_told_from_certainty(chance: float, words: str) -> None:
    assert percent(chance) == words
