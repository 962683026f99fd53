"""Plan reduction against its definition, and steps that no plan can do without."""

from __future__ import annotations

from itertools import count, product
from unittest.mock import patch

import pytest
from hypothesis import given, strategies as st

from planner_bridge.model.grounding import ground_action, initial_knowledge
from planner_bridge.model.plan import Plan, PlanningResult, PlanningStatus, PlanStep
from planner_bridge.model.problem import Problem
from planner_bridge.model.progression import NotApplicable, Progression
from planner_bridge.planning import solve
from planner_bridge.planning.solve import indispensable, reduced
from pnm.core.logic.conditions import evaluate
from pnm.core.machine.plan_graph import GroundAction, Moment, PlanEvent
from tests.support.pddl.problems import rooms

FACTS = ["(at r1 a)", "(at r1 c)", "(at r2 d)", "(clean a)", "(clean b)", "(clean d)", "(not (at r2 a))"]


def world(*goals: str) -> Problem:
    return rooms(goal=f"(and {' '.join(goals)})", ways="ab ba bc cb ad da dc")


def every_action(problem: Problem) -> list[GroundAction]:
    """Every ground action of the problem, in one order."""
    return [
        ground_action(schema, arguments)
        for schema in problem.domain.actions.values()
        for arguments in product(*(problem.objects_by_type[variable.types[0]] for variable in schema.parameters))
    ]


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
    number = 0
    while number < len(actions):
        left, is_reached = carried_out(problem, [*actions[:number], *actions[number + 1 :]])
        actions, number = (left, number) if is_reached else (actions, number + 1)
    return actions


def walk(choices: list[int]) -> list[GroundAction]:
    """Actions that can be carried out one after the other: of those that can be next, which one each choice says."""
    problem, walked = world(), list[GroundAction]()
    simulation = Progression(initial_knowledge(problem))
    for choice in choices:
        possible = [action for action in every_action(problem) if evaluate(action.precondition, simulation.state) is True]
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
    with patch.object(solve.time, "monotonic", side_effect=count().__next__):
        result = reduced(problem, PlanningResult(PlanningStatus.SOLVED, plan), until=looks).plan
    assert result is not None
    left = [ground_action(problem.domain.actions[step.action], step.arguments) for step in result.steps]
    assert carried_out(problem, left) == (left, True)
    assert len(left) == max(2, len(steps) - 2 * looks)


def test_the_limit_of_a_search_counts_for_that_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    ends, now = list[float](), solve.time.monotonic()

    def note(problem: Problem, result: PlanningResult, parsed: object, *, until: float) -> PlanningResult:
        ends.append(until)
        return result

    monkeypatch.setattr(solve, "reduced", note)
    assert solve.solve(world("(clean b)"), timeout=20.0, improve=0.0).plan
    assert now + 20.0 <= ends[0] <= solve.time.monotonic() + 20.0
