"""Why not another action: never possible, in no plan, or no better; and what of that is proved."""

from __future__ import annotations

from dataclasses import replace

import pytest

from planner_bridge.explanations.answer import Answer, Best, Known, Unsolvable
from planner_bridge.explanations.needed_call import Forced, why_not
from planner_bridge.explanations.no_plan import AnswerLimit
from planner_bridge.model.plan import PlanningResult, PlanningStatus, PlanStep
from planner_bridge.model.problem import Problem
from planner_bridge.planning.solve import solve
from planner_bridge.planning.validate import why_invalid
from tests.support.pddl.explanations.doors import house
from tests.support.pddl.problems import hard, matches, rooms, tanks


def ask(problem: Problem, action: str, *arguments: str, seconds: float = 30.0) -> Answer:
    limit = AnswerLimit.of(seconds)
    return why_not(problem, PlanStep(action, arguments), limit.first_plan(problem), limit)


def test_an_action_that_no_plan_uses_is_proved_to_be_so() -> None:
    once = rooms(ways="ab bc ad dc", goal="(and (at r1 c) (at r2 c) (not (at r1 d)))", init="(at r1 b) (at r2 a)")
    answer = ask(once, "move", "r1", "a", "d")
    assert answer.known is Known.RELAXATION
    answer = ask(rooms(ways="ab ac bc", goal="(and (at r1 a) (at r2 c))"), "move", "r1", "a", "b")
    assert (answer.statement, answer.known) == ("no plan that reaches the goal uses move(r1, a, b)", Known.SEARCH)
    assert [type(claim) for claim in answer.claims] == [Unsolvable]


def test_one_that_is_as_good_is_called_so() -> None:
    plan = solve(rooms(goal="(at r1 c)"), improve=0.0).plan
    assert plan
    other = "d" if "b" in plan.steps[0].arguments else "b"
    answer = ask(rooms(goal="(at r1 c)"), "move", "r1", "a", other)
    assert answer.statement == f"a plan that uses move(r1, a, {other}) is as good: 2 against 2 calls"


def test_one_that_the_plan_has_is_named() -> None:
    assert ask(house("(open door)", "(has r1 cup)"), "take", "r1", "cup", "kitchen").statement == (
        "the plan does use take(r1, cup, kitchen): it is call #1"
    )


def test_without_time_nothing_is_proved() -> None:
    found = PlanningResult(PlanningStatus.TIMED_OUT)
    problem = hard(4)
    name, schema = next(iter(problem.domain.actions.items()))
    arguments = tuple(problem.objects_by_type[variable.types[0]][0] for variable in schema.parameters)
    answer = why_not(problem, PlanStep(name, arguments), found, AnswerLimit.of(0.0))
    assert answer.known in (Known.NOT_PROVED, Known.RELAXATION)


@pytest.mark.parametrize("problem", [rooms(), matches(), tanks("4"), house("")], ids=["rooms", "time", "numbers", "house"])
def test_a_plan_of_the_forced_problem_is_one_of_the_problem_with_the_action(problem: Problem) -> None:
    for schema in problem.domain.actions.values():
        arguments = tuple(problem.objects_by_type[variable.types[0]][-1] for variable in schema.parameters)
        asked = Forced.of(problem, PlanStep(schema.name, arguments))
        result = solve(asked.problem, timeout=5.0, improve=0.0)
        if result.plan:
            plan = asked.plan(result.plan)
            assert why_invalid(problem, plan) == ""
            assert (schema.name, arguments) in [(step.action, step.arguments) for step in plan.steps]


class NeverSure(AnswerLimit):
    """The planner never proves that a plan is best."""

    def solve(self, problem: Problem, *, share: float = 1.0, improve: float = 0.0) -> PlanningResult:
        found = super().solve(problem, share=share, improve=improve)
        return replace(found, plan=found.plan and replace(found.plan, is_best=False))


@pytest.mark.parametrize("kind", [AnswerLimit, NeverSure])
def test_a_plan_with_it_is_worse_by_so_much_which_is_called_proved_only_if_it_is(kind: type[AnswerLimit]) -> None:
    problem, limit = house("(open door)", "(has r1 cup)"), kind(AnswerLimit.of(30).end)
    answer = why_not(problem, PlanStep("move", ("r1", "hall", "yard")), limit.first_plan(problem), limit)
    proved = [claim for claim in answer.claims if isinstance(claim, Best)]
    assert answer.statement == (
        "a plan that uses move(r1, hall, yard) is worse by 2 calls at least: 4 against 2 calls"
        if proved
        else "the best plan found that uses move(r1, hall, yard) is worse by 2 calls: 4 against 2 calls"
    )
    assert (answer.known, answer.reasons[-1].known is Known.NOT_PROVED) == ((Known.SEARCH, False) if proved else (Known.PLAN, True))
    assert not (proved and kind is NeverSure)
    assert answer.reasons[0].statement == "at first it could begin"
