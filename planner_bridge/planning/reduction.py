"""Plan reduction: calls that a plan does not need are left out, one by one or with those that rest on them.

Greedy action elimination (Nakhost and Müller, Action Elimination and Plan Neighborhood Graph Search, 2010): a step is left out, and
with it all steps that cannot be carried out then; if the goal is reached all the same, and at no higher cost, the plan stays so.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from planner_bridge.model.grounding import ground_action, initial_knowledge
from planner_bridge.model.plan import Plan, PlanningResult, PlanStep
from planner_bridge.model.plan_simulation import NotApplicable, PlanSimulation
from planner_bridge.model.problem import TOTAL_TIME, Problem
from planner_bridge.planning.kairos import validate
from planner_bridge.planning.validate import InvalidPlan, last_state
from pnm.core.logic.evaluation import evaluate
from pnm.core.logic.expressions import Fluent, State, Unknown, Value, ValueOf, value_of
from pnm.core.machine.plan_graph import GroundAction, Moment, PlanEvent

if TYPE_CHECKING:
    import kairos

MAX_STEPS: Final = 250
"""Steps of a plan that is reduced: the work grows with the square of their number."""


def reduced(problem: Problem, result: PlanningResult, parsed: kairos.Problem | None = None) -> PlanningResult:
    """Return the result with a plan that has no needless step; one of a task network, or with preferences, is more than a way to a goal.

    `parsed` is the problem as Kairos reads it, if that is there already.
    """
    plan = result.plan
    if plan is None or problem.network or problem.has_preferences or len(plan.steps) > MAX_STEPS:
        return result
    actions: dict[PlanStep, GroundAction] = {}  # once: every step is left out in turn
    for step in plan.steps:
        schema = problem.domain.actions[step.action]
        actions[step] = ground_action(schema, step.arguments, None if schema.duration is None else step.duration)
    number, plan = 0, replace(plan, cost=_cost(problem, plan, last_state(problem, plan)))
    while number < len(plan.steps):
        shorter = _without(problem, plan, number, actions)
        if shorter is None:
            number += 1
        else:
            plan = shorter
    is_shorter = result.plan is not None and len(plan.steps) < len(result.plan.steps)
    return result if is_shorter and validate(problem, plan, parsed) else replace(result, plan=plan)


def _without(problem: Problem, plan: Plan, number: int, actions: Mapping[PlanStep, GroundAction]) -> Plan | None:
    """Return the plan without the step, and those after it that cannot be carried out without it; None if that is no better plan."""
    steps = surviving(problem, plan, number, actions)
    if steps is None:
        return None
    while True:
        shorter = replace(plan, steps=tuple(steps))
        try:
            cost = _cost(problem, shorter, last_state(problem, shorter))
        except InvalidPlan as error:
            if error.step is None or error.step < number:  # the goal is not reached, or an earlier step cannot go on
                return None
            del steps[error.step]
        else:
            rises = 0.0 if cost is None or plan.cost is None else cost - plan.cost
            is_worse = rises < 0.0 if problem.metric and problem.metric.direction == "maximize" else rises > 0.0
            return None if is_worse else replace(shorter, cost=cost)


def surviving(problem: Problem, plan: Plan, number: int, actions: Mapping[PlanStep, GroundAction]) -> list[PlanStep] | None:
    """Return the steps that can be carried out when one is left out, by one simulation; None if they do not reach the goal.

    What happens at one moment happens here one after the other, so the result has still to be validated.
    """
    simulation, lost = PlanSimulation(initial_knowledge(problem)), {number}
    ends, timed, starts = range(3)  # of one moment
    moments = [(change.time, timed, index) for index, change in enumerate(problem.timed)]
    for index, step in enumerate(plan.steps):
        start = step.start if plan.temporal else float(index)
        moments += [(start, starts, index), *([(start + step.duration, ends, index)] if plan.temporal and step.duration else [])]
    for _, kind, index in sorted(moments):
        if kind == timed:
            simulation.state.update(problem.timed[index].changes)
        elif index not in lost:
            step = plan.steps[index]
            happening = [Moment.END] if kind == ends else [Moment.START] if plan.temporal and step.duration else [Moment.START, Moment.END]
            try:
                simulation.advance([(PlanEvent(index, moment), actions[step]) for moment in happening])
            except NotApplicable as error:
                if kind == ends or error.stage == "go on":
                    return None
                lost.add(index)
    if evaluate(problem.goal, simulation.state) is not True:
        return None
    return [step for index, step in enumerate(plan.steps) if index not in lost]


def _cost(problem: Problem, plan: Plan, state: State) -> float | None:
    """Return what the metric makes of a plan that leads to the state; None where time is all that counts."""
    if problem.metric is None or problem.metric.expression == ValueOf(TOTAL_TIME):
        return None
    total_time = plan.makespan if plan.temporal else float(len(plan.steps))
    cost = value_of(problem.metric.expression, _Timed(state, total_time))
    return float(cost) if isinstance(cost, int | float) else plan.cost


@dataclass(frozen=True, slots=True)
class _Timed:
    """The state after a plan that has taken this time."""

    state: State
    total_time: float

    def value(self, fluent: Fluent, /) -> Value | Unknown | None:
        return self.total_time if fluent == TOTAL_TIME else self.state.value(fluent)

    def objects(self, types: tuple[str, ...], /) -> tuple[str, ...]:
        return self.state.objects(types)
