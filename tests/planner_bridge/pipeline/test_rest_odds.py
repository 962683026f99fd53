"""The odds of what is left of a plan, and of calls that take turns."""

from __future__ import annotations

from math import sqrt

import pytest

from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.pipeline.odds import KnownRobots, exact, odds_of_calls
from planner_bridge.pipeline.policy_odds import RestOfPlan
from planner_bridge.pipeline.roll_outs import odds_of_goal
from planner_bridge.planning.solve import solve
from planner_bridge.tasks.settings import Settings
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.core.execution.call_results import CallResult
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.plan_graph import ActionCall, GroundAction, Moment, Ordering, PlanEvent, PlanGraph
from pnm.core.machine.requests import CallOutcome

SLIPPERY = KnownRobots(faults=Faults((Fault("go", FaultKind.ABORT, chance=0.5),)))
BOUND = Bindings({"go": Binding(retries=2)})
CALLS = tuple(ActionCall(number, GroundAction("go", (str(number),), ("place",), duration=4.0)) for number in range(3))
LINE = PlanGraph(CALLS, tuple(Ordering(PlanEvent(number, Moment.END), PlanEvent(number + 1, Moment.START)) for number in range(2)))


def rest(now: float, *results: CallResult, accepted: dict[int, float] | None = None) -> RestOfPlan:
    known = {result.call.index: result for result in results}
    return RestOfPlan(LINE, BOUND, {call.index: known.get(call.index, CallResult(call)) for call in CALLS}, accepted or {}, 0.0, now)


def done(number: int, ended: float) -> CallResult:
    return CallResult(CALLS[number], CallOutcome.SUCCEEDED, 1, 0.0, ended)


def test_what_is_done_is_certain_and_what_has_been_spent_is_missing() -> None:
    whole, half = 1.0 - 0.5**3, 1.0 - 0.5**2
    tried = CallResult(CALLS[1], CallOutcome.RUNNING, 2, 4.0)
    suspended = CallResult(CALLS[1], CallOutcome.SUSPENDED, 2, 4.0)
    for at, chance in (
        (rest(0.0), whole**3),
        (rest(4.0, done(0, 4.0)), whole**2),
        (rest(7.0, done(0, 4.0), tried, accepted={1: 6.0}), half * whole),
        (rest(7.0, done(0, 4.0), suspended), 0.5 * whole),
        (rest(12.0, done(0, 4.0), done(1, 8.0), done(2, 12.0)), 1.0),
    ):
        odds = at.odds(SLIPPERY)
        assert odds is not None
        assert odds.told is not None
        assert odds.told.chance == pytest.approx(chance)
        assert odds.told.rests == ("declared: go" if chance < 1.0 else "")


def test_time_goes_on_while_a_call_is_at_work_and_a_late_one_is_expected_to_be_as_late_again() -> None:
    going = CallResult(CALLS[0], CallOutcome.RUNNING, 1, 0.0)
    for now, left in ((0.0, 12.0), (1.0, 11.0), (3.5, 8.5), (6.0, 10.0)):
        odds = rest(now, going, accepted={0: 0.0}).odds(KnownRobots(faults=Faults((Fault("go", FaultKind.ABORT, chance=0.0),))))
        assert odds is not None
        assert odds.told is not None
        assert (odds.told.median, odds.told.ninety_percent) == (left, left)


def test_after_a_failure_there_are_none() -> None:
    assert rest(4.0, CallResult(CALLS[0], CallOutcome.FAILED, 3, 0.0, 4.0)).odds(SLIPPERY) is None


def test_a_plan_without_calls_is_certain_and_takes_no_time() -> None:
    odds = exact(PlanGraph(()), (), KnowledgeBase())
    assert odds is not None
    assert (odds.chance, odds.time(0.9)) == (1.0, 0.0)


@pytest.mark.parametrize(("resources", "lasts"), [((), 4.0), (("broom",), 12.0)])
def test_calls_that_need_the_same_thing_take_turns(resources: tuple[str, ...], lasts: float) -> None:
    bound = Bindings({"go": Binding(resources=resources)})
    calls = odds_of_calls(PlanGraph(CALLS), bound, KnownRobots().attempts(bound, {}, is_timed=True))
    assert calls is not None
    odds = exact(PlanGraph(CALLS), calls, KnowledgeBase())
    assert odds is not None
    assert min(odds.times) == lasts


RIVER = """(define (domain river) (:requirements :strips :non-deterministic) (:predicates (near) (far) (island))
  (:action wade :precondition (near) :effect (and (not (near)) (oneof (far) (and) (island) (island))))
  (:action swim :precondition (island) :effect (and (not (island)) (probabilistic 0.8 (far)))))"""


def test_what_outcomes_lead_to_is_rolled_out_by_the_policy() -> None:
    problem = parse_problem("(define (problem p) (:domain river) (:init (near)) (:goal (far)))", parse_domain(RIVER))
    result, certain = solve(problem), Faults((Fault("wade", FaultKind.ABORT, chance=0.0),))
    assert result.plan is not None
    odds = odds_of_goal(problem, result.plan, Settings(), certain, policy=result.policy, seconds=600.0, most=150)
    assert odds.alone is not None
    assert odds.alone.chance == pytest.approx(0.65)
    assert odds.rolled is not None
    assert abs(odds.rolled.chance - 0.65) < 4.0 * sqrt(0.65 * 0.35 / 150)
    graph = plan_graph(problem, result.plan)
    results = {call.index: CallResult(call) for call in graph.calls}
    assert RestOfPlan(graph, Bindings(), results, {}, 0.0, 0.0).odds(KnownRobots(faults=certain)) is None
