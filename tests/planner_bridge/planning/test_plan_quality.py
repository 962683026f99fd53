"""Plans worth executing: the metric counts, and no call can be left out."""

from __future__ import annotations

from dataclasses import replace
from itertools import count
from math import inf
from unittest.mock import patch

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from planner_bridge.model.grounding import ground_action, initial_knowledge
from planner_bridge.model.plan import Plan, PlanningResult, PlanningStatus, PlanStep
from planner_bridge.model.problem import Metric, Problem
from planner_bridge.model.progression import NotApplicable, Progression
from planner_bridge.ordering.robot_time import ExpectedTimes, robot_time
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.planning import solve as module
from planner_bridge.planning.lower_bound import lower_bound
from planner_bridge.planning.solve import WORK, cost_of, indispensable, reduced, solve
from planner_bridge.planning.validate import last_state, why_invalid
from pnm.core.logic.conditions import TRUE, evaluate
from pnm.core.logic.expressions import ValueOf
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.plan_graph import GroundAction, Moment, PlanEvent
from tests.support.pddl.problems import rooms
from tests.support.pddl.random_plans import goal_of, ground_calls, walks
from tests.support.pddl.random_problems import Features, fluents, problems
from tests.support.pddl.vans import vans

SHOP = """
(define (domain shop)
  (:requirements :strips :action-costs)
  (:predicates (asked) (bought) (paid))
  (:functions (total-cost))
  (:action ask :parameters () :effect (and (asked) (increase (total-cost) 1)))
  (:action buy_asked :parameters () :precondition (asked) :effect (and (bought) (increase (total-cost) 1)))
  (:action buy :parameters () :effect (and (bought) (increase (total-cost) 1000)))
  {more})
"""
RETURN = "(:action return_bottles :parameters () :precondition (bought) :effect (and (paid) (decrease (total-cost) 5)))"


def shop(metric: str = "(:metric minimize (total-cost))", rest: str = "", more: str = "") -> Problem:
    text = f"(define (problem p) (:domain shop) (:init (= (total-cost) 0)) (:goal (bought)) {rest} {metric})"
    return parse_problem(text, parse_domain(SHOP.format(more=more)))


def plan_of(*calls: str, cost: float | None = None) -> Plan:
    """A sequential plan of calls such as ``move r1 a b``."""
    words = [call.split() for call in calls]
    return Plan(tuple(PlanStep(name, tuple(arguments)) for name, *arguments in words), cost=cost)


def left(problem: Problem, plan: Plan) -> list[str]:
    """Return what is left of a valid plan."""
    assert not why_invalid(problem, plan)
    result = reduced(problem, PlanningResult(PlanningStatus.SOLVED, plan))
    assert result.plan is not None
    return [" ".join((step.action, *step.arguments)) for step in result.plan.steps]


# --- cost --------------------------------------------------------------------------------------


def test_the_metric_decides_and_the_best_plan_is_called_so() -> None:
    result = solve(shop())
    assert result.plan is not None
    assert (result.plan.cost, result.plan.is_best) == (2.0, True)
    assert str(result.plan).startswith("2 calls, cost 2, no plan is better\n")


def test_without_time_for_improvement_the_first_plan_is_taken_and_nothing_is_said_of_better_ones() -> None:
    result = solve(rooms(), improve=0.0)
    assert result.plan is not None
    assert not result.plan.is_best


def test_nothing_is_called_best_while_facts_are_unknown() -> None:
    result = solve(replace(shop(), unknown=frozenset({("asked",)})))
    assert result.plan is not None
    assert not result.plan.is_best


# --- lower bounds ------------------------------------------------------------------------------


@pytest.mark.parametrize("features", [Features(), Features(timed=True)], ids=["one after the other", "with times"])
def test_no_plan_is_better_than_the_lower_bound(features: Features) -> None:
    @settings(max_examples=60, suppress_health_check=list(HealthCheck))
    @given(st.data())
    def check(data: st.DataObject) -> None:
        drawn = data.draw(problems(features))
        plan = data.draw(walks(drawn))
        goal = goal_of(drawn, last_state(replace(drawn, goal=TRUE), plan).facts())
        counted = st.sampled_from([None, *fluents(drawn, drawn.domain.functions)])
        number, resources = data.draw(counted), data.draw(st.sampled_from([(), ("arm",), ("arm", "hand")]))
        problem = replace(drawn, goal=goal, metric=number and Metric("minimize", ValueOf(number)))
        seconds = {name: data.draw(st.sampled_from([0.5, 20.0])) for name in problem.domain.actions}
        of_robots = Bindings({name: Binding(seconds=lasts, resources=resources) for name, lasts in seconds.items()})
        measured = replace(plan, cost=cost_of(problem, plan))
        assert lower_bound(problem, None, inf) <= measured.value + 1e-6
        rates = ExpectedTimes(of_robots)
        expected = robot_time(problem, plan, rates) if rates.are_measure(problem) else measured.value
        assert lower_bound(problem, rates, inf) <= expected + 1e-6

    check()


def test_a_plan_that_is_as_good_as_the_bound_is_the_best_and_is_not_improved() -> None:
    many = " ".join(f"(clean {room})" for room in "bcdefgh")
    corridor = rooms(init="(at r1 a)", goal=f"(and {many})", ways="ab ba bc cb cd dc de ed ef fe fg gf gh hg")
    two = Bindings({name: Binding(seconds=3.0, resources=("{r}",)) for name in ("move", "sweep")})
    for bindings, value in ((None, 14.0), (two, 42.0)):
        found = solve(corridor, bindings=bindings, improve=60.0, is_looked_at=True, timeout=70.0).plan
        assert found is not None
        assert (found.value, found.is_best, found.above) == (value, True, 0.0)


def test_how_far_a_plan_is_from_the_best_at_most_is_said_unless_it_says_nothing() -> None:
    plan = Plan((PlanStep("move"),))
    assert str(replace(plan, above=0.111)).startswith("1 call, at most 12 % above the best\n")
    assert str(replace(plan, above=0.0, is_best=True)).startswith("1 call, no plan is better\n")
    assert str(replace(plan, above=1.5)).startswith("1 call\n")
    assert solve(rooms()).plan == replace(solve(rooms()).plan or plan, above=None), "robots do not wait for it"


# --- needless calls ------------------------------------------------------------------------------


def test_a_call_that_makes_the_plan_cheaper_stays() -> None:
    plan = plan_of("ask", "buy_asked", "return_bottles", cost=-3.0)
    assert left(shop(more=RETURN), plan) == ["ask", "buy_asked", "return_bottles"]
    assert left(shop(metric="", more=RETURN), plan) == ["ask", "buy_asked"]


def test_a_call_that_a_constraint_asks_for_stays() -> None:
    assert left(shop(rest="(:constraints (sometime (asked)))"), plan_of("ask", "buy", cost=1001.0)) == ["ask", "buy"]


def test_plans_with_preferences_stay_as_they_are() -> None:
    softly = rooms(goal="(and (clean a) (preference p (at r1 b)))", ways="ab ba")
    assert left(softly, plan_of("move r1 a b", "sweep r2 a")) == ["move r1 a b", "sweep r2 a"]


@pytest.mark.parametrize("calls", [250, 1000])
def test_the_work_is_bounded_however_long_the_plan(calls: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody can say of a single call of these that it is needed, and without one all others are carried out."""
    text = f"(define (problem p) (:domain shop) (:init (= (total-cost) 0)) (:goal (>= (total-cost) {calls - 1})))"
    problem, plan, simulated = parse_problem(text, parse_domain(SHOP.format(more=""))), plan_of(*["ask"] * calls), count()
    advance = Progression.advance
    monkeypatch.setattr(Progression, "advance", lambda *given: (next(simulated), advance(*given))[1])
    result = reduced(problem, PlanningResult(PlanningStatus.SOLVED, plan)).plan
    assert result is not None
    assert len(result.steps) == calls - 1
    assert next(simulated) < WORK + 5 * calls


@pytest.mark.parametrize(("condition", "is_dear"), [("(not (seen ?i))", True), ("(wet ?i)", False)], ids=["changes", "lasts"])
def test_calls_that_change_many_objects_are_simulated_less_often(condition: str, is_dear: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each takes as long as a hundred others, unless it is known before which objects it changes."""
    effect = f"(and (increase (asked) 1) (forall (?i - item) (when {condition} (seen ?i))))"
    domain = f"""(define (domain d) (:requirements :fluents :conditional-effects :typing) (:types item) (:functions (asked))
      (:predicates (wet ?i - item) (seen ?i - item)) (:action ask :parameters () :effect {effect}))"""
    text = f"(define (problem p) (:domain d) (:objects {' '.join(f'i{number}' for number in range(400))} - item)"
    problem = parse_problem(f"{text} (:init (= (asked) 0)) (:goal (>= (asked) 100)))", parse_domain(domain))
    simulated, advance = count(), Progression.advance
    monkeypatch.setattr(Progression, "advance", lambda *given: (next(simulated), advance(*given))[1])
    reduced(problem, PlanningResult(PlanningStatus.SOLVED, plan_of(*["ask"] * 100)))
    assert (next(simulated) < WORK // 100 + 500) is is_dear


def test_of_plans_with_times_needless_calls_are_left_out_as_well() -> None:
    steps = (PlanStep("drive", ("v1", "home", "shop"), 0.0, 4.0), PlanStep("drive", ("v2", "home", "far"), 0.0, 4.0))
    problem = vans("v1 home v2 home", "home shop 4", "home far 4", goal="(at v2 far)")
    assert left(problem, Plan(steps, temporal=True)) == ["drive v2 home far"]


# --- the definition --------------------------------------------------------------------------------

FACTS = ["(at r1 a)", "(at r1 c)", "(at r2 d)", "(clean a)", "(clean b)", "(clean d)", "(not (at r2 a))"]


def world(*goals: str) -> Problem:
    return rooms(goal=f"(and {' '.join(goals)})", ways="ab ba bc cb ad da dc")


def carried_out(problem: Problem, actions: list[GroundAction]) -> tuple[list[GroundAction], bool]:
    """The actions that can be carried out, one after the other, and whether the goal holds then."""
    simulation, done = Progression(initial_knowledge(problem)), list[GroundAction]()
    for action in actions:
        try:
            simulation.advance([(PlanEvent(0, moment), action) for moment in Moment])
        except NotApplicable:
            continue
        done.append(action)
    return done, evaluate(problem.goal, simulation.state) is True


def eliminated(problem: Problem, actions: list[GroundAction]) -> list[GroundAction]:
    """The definition: an action is left out, and with it all that cannot be carried out then, if the goal is reached all the same."""
    before = len(actions) + 1
    while len(actions) < before:  # until no pass leaves anything out
        before, number = len(actions), 0
        while number < len(actions):
            left, is_reached = carried_out(problem, [*actions[:number], *actions[number + 1 :]])
            actions, number = (left, number) if is_reached else (actions, number + 1)
    return actions


def walk(choices: list[int]) -> list[GroundAction]:
    """Actions that can be carried out one after the other: of those that can be next, which one each choice says."""
    problem, walked = world(), list[GroundAction]()
    every = [ground_action(problem.domain.actions[name], arguments) for name, arguments in ground_calls(problem)]
    simulation = Progression(initial_knowledge(problem))
    for choice in choices:
        possible = [action for action in every if evaluate(action.precondition, simulation.state) is True]
        walked.append(possible[choice % len(possible)])
        simulation.advance([(PlanEvent(0, moment), walked[-1]) for moment in Moment])
    return walked


@given(st.sets(st.sampled_from(FACTS)), st.lists(st.integers(0, 20), max_size=12))
def test_what_is_left_of_a_plan_is_what_elimination_by_trying_every_step_leaves(facts: set[str], choices: list[int]) -> None:
    walked = walk(choices)
    problem = world(*(goal for goal in sorted(facts) if carried_out(world(goal), walked)[1]))
    plan = Plan(tuple(PlanStep(action.name, action.arguments) for action in walked))
    result = reduced(problem, PlanningResult(PlanningStatus.SOLVED, plan)).plan
    assert result is not None
    left = [(step.action, step.arguments) for step in result.steps]
    assert left == [(action.name, action.arguments) for action in eliminated(problem, walked)]
    for number in indispensable(problem, walked):
        assert not carried_out(problem, [*walked[:number], *walked[number + 1 :]])[1]


def test_the_only_step_that_makes_a_goal_true_is_indispensable_and_so_is_what_it_rests_on() -> None:
    problem = world("(clean b)")
    steps = [("move", "r1", "a", "b"), ("sweep", "r1", "b"), ("move", "r2", "a", "b"), ("move", "r1", "b", "a")]
    actions = [ground_action(problem.domain.actions[name], tuple(arguments)) for name, *arguments in steps]
    assert indispensable(problem, actions) == {0, 1}


TO_AND_FRO = [("move", "r1", "a", "b"), ("move", "r1", "b", "a")] * 4


@given(st.integers(0, 9))
def test_when_the_time_is_over_the_plan_stays_as_it_is_by_then(looks: int) -> None:
    """What is left solves the problem; what was not looked at is kept."""
    problem = world("(clean b)")
    steps = [*TO_AND_FRO, ("move", "r1", "a", "b"), ("sweep", "r1", "b")]
    plan = Plan(tuple(PlanStep(name, tuple(arguments)) for name, *arguments in steps))
    with patch.object(module.time, "monotonic", side_effect=count().__next__):
        result = reduced(problem, PlanningResult(PlanningStatus.SOLVED, plan), until=looks).plan
    assert result is not None
    left = [ground_action(problem.domain.actions[step.action], step.arguments) for step in result.steps]
    assert carried_out(problem, left) == (left, True)
    assert len(left) == max(2, len(steps) - 2 * looks)


def test_the_limit_of_a_search_counts_for_that_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    ends, now = list[float](), module.time.monotonic()

    def note(problem: Problem, result: PlanningResult, parsed: object, *, until: float, rates: object) -> PlanningResult:
        ends.append(until)
        return result

    monkeypatch.setattr(module, "reduced", note)
    assert solve(world("(clean b)"), timeout=20.0, improve=0.0).plan
    assert now + 20.0 <= ends[0] <= module.time.monotonic() + 20.0
