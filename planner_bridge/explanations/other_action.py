"""Why a plan does not have an action: it can never be carried out, no plan uses it, or plans that use it are no better.

The action is *forced*: a copy of it, with these arguments, makes a fact true that the goal asks for besides.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

from planner_bridge.explanations.answer import Answer, Best, Claim, Known, Solves, Unsolvable
from planner_bridge.explanations.no_plan import AnswerLimit, why_no_plan, why_unreachable
from planner_bridge.model.forbidden_actions import unused_name
from planner_bridge.model.grounding import ground_action, initial_knowledge
from planner_bridge.model.plan import Plan, PlanningResult, PlanningStatus, PlanStep
from planner_bridge.model.problem import TOTAL_TIME, Problem
from planner_bridge.planning.validate import DURATION_TOLERANCE
from pnm.core.logic.conditions import Holds, conjunction, ground, observed, unmet
from pnm.core.logic.domain import ActionSchema, Declaration
from pnm.core.logic.effects import Set, ground_effects
from pnm.core.logic.expressions import Constant, Environment, Fluent, ValueOf, ground_expression
from pnm.errors import counted

_IMPROVE: Final = 0.3
"""Seconds for which a better plan is looked for, with the action and without it."""


@dataclass(frozen=True, slots=True)
class Forced:
    """A problem whose plans have to use an action once at least: a copy of it, with these arguments, makes a fact of the goal true."""

    problem: Problem
    fact: Fluent
    copy: str
    action: PlanStep

    @staticmethod
    def of(problem: Problem, action: PlanStep) -> Forced:
        """Return the problem for an action, with objects of the right types."""
        domain, schema = problem.domain, problem.domain.actions[action.action]
        fact, copy = (unused_name("used", domain),), f"{schema.name}-used"
        while copy in domain.actions:
            copy += "-"
        env: Environment = {variable.name: name for variable, name in zip(schema.parameters, action.arguments, strict=True)}
        bounds = schema.duration and tuple(replace(bound, bound=ground_expression(bound.bound, env)) for bound in schema.duration)
        used = ActionSchema(
            copy,
            (),
            ground(schema.precondition, env),
            ground(schema.invariant, env),
            ground(schema.end_condition, env),
            ground_effects(schema.start_effects, env),
            (*ground_effects(schema.end_effects, env), Set(fact, Constant(True))),
            bounds,
        )
        named = {name: problem.objects[name] for name in action.arguments}
        domain = replace(
            domain,
            constants={**domain.constants, **named},
            predicates={**domain.predicates, fact[0]: Declaration(fact[0])},
            actions={**domain.actions, copy: used},
        )
        own = {name: types for name, types in problem.own_objects.items() if name not in named}
        goal = conjunction((problem.goal, Holds(fact)))
        return Forced(replace(problem, domain=domain, own_objects=own, goal=goal), fact, copy, action)

    def plan(self, plan: Plan) -> Plan:
        """Return a plan of this problem as one of the problem that it was made of."""
        steps = (
            replace(step, action=self.action.action, arguments=self.action.arguments) if step.action == self.copy else step
            for step in plan.steps
        )
        return replace(plan, steps=tuple(steps))


def why_not(problem: Problem, action: PlanStep, found: PlanningResult, limit: AnswerLimit) -> Answer:
    """Return why a plan does not use an action.

    Args:
        problem: what is planned for.
        action: with its arguments, which are objects of the right types.
        found: a plan, or why there is none.
        limit: until when to look.
    """
    same = (action.action, action.arguments)
    if found.plan and (numbers := [number for number, step in enumerate(found.plan.steps) if (step.action, step.arguments) == same]):
        return Answer(f"the plan does use {action}: it is call #{numbers[0]}", Known.PLAN, (), (Solves(problem, found.plan),))
    asked = Forced.of(problem, action)
    if never := why_unreachable(asked.problem, Holds(asked.fact), limit):
        closed = never.reasons[0].reasons  # of the fact, whose only way is the copy
        claim = Unsolvable(replace(asked.problem, goal=Holds(asked.fact), constraints=()))
        return Answer(f"{action} can never be carried out", Known.RELAXATION, closed[0].reasons if closed else (), (claim,))
    now = tuple(_now(problem, action))
    if problem.has_tasks or problem.domain.actions[action.action].preferences:
        what = "a network of tasks" if problem.has_tasks else "a preference of the action"
        return Answer(f"whether a plan can use {action} was not looked at: there is {what}", Known.NOT_PROVED, now)
    result = limit.solve(asked.problem, share=0.6, improve=_IMPROVE)
    if result.plan and found.plan:
        better = limit.solve(problem, share=0.8, improve=_IMPROVE).plan or found.plan
        return _compared(problem, asked, better, result.plan, now)
    if result.plan:
        plan = asked.plan(result.plan)
        return Answer(f"a plan can use {action}: one with {counted(len(plan.steps), 'call')}", Known.PLAN, now, (Solves(problem, plan),))
    if result.status is not PlanningStatus.UNSOLVABLE:
        return Answer(f"whether a plan can use {action} was not found out: {result.reason}", Known.NOT_PROVED, now)
    if found.plan is None:
        now += (why_no_plan(problem, found, limit),)
    return Answer(f"no plan that reaches the goal uses {action}", Known.SEARCH, now, (Unsolvable(asked.problem),))


def _now(problem: Problem, action: PlanStep) -> Iterator[Answer]:
    """Yield whether the action could be the first one, and what keeps it from that."""
    state = initial_knowledge(problem)
    missing = unmet(ground_action(problem.domain.actions[action.action], action.arguments).precondition, state)
    for part in missing:
        yield Answer(f"at first it cannot begin: it needs {part}; observed {observed(part, state)}", Known.GIVEN)
    if not missing:
        yield Answer("at first it could begin", Known.GIVEN)


def _compared(problem: Problem, asked: Forced, plan: Plan, its: Plan, now: tuple[Answer, ...]) -> Answer:
    """Return how a plan that has to use the action compares with one that has not."""
    action, other = asked.action, asked.plan(its)
    claims: tuple[Claim, ...] = (Solves(problem, plan), Solves(problem, other))
    worth, its_worth = _worth(problem, plan), _worth(problem, its)
    if worth is None or its_worth is None:
        return Answer(f"a plan can use {action}, and nothing says how good it is", Known.PLAN, now, claims)
    unit = "s" if plan.temporal else "calls"
    if problem.metric and problem.metric.expression != ValueOf(TOTAL_TIME):
        unit = "of the metric"
    gap = (worth - its_worth) if problem.metric and problem.metric.direction == "maximize" else its_worth - worth
    by, shown = f"{round(gap, 2):g} {unit}", f"{round(its_worth, 2):g} against {round(worth, 2):g} {unit}"
    if abs(gap) <= DURATION_TOLERANCE:
        return Answer(f"a plan that uses {action} is as good: {shown}", Known.PLAN, now, claims)
    if gap < 0.0:
        return Answer(f"a plan that uses {action} is even better: {shown}; the search ended before it was found", Known.PLAN, now, claims)
    if plan.is_best and its.is_best:
        claims = (*claims, Best(problem, plan), Best(asked.problem, its))
        return Answer(f"a plan that uses {action} is worse by {by} at least: {shown}", Known.SEARCH, now, claims)
    now += (Answer("that no plan with it is better is not proved: not all plans were looked at", Known.NOT_PROVED),)
    return Answer(f"the best plan found that uses {action} is worse by {by}: {shown}", Known.PLAN, now, claims)


def _worth(problem: Problem, plan: Plan) -> float | None:
    """Return what counts of a plan."""
    if problem.has_preferences or (problem.metric and problem.metric.expression != ValueOf(TOTAL_TIME)):
        return plan.cost
    return plan.makespan if plan.temporal else float(len(plan.steps))
