"""Plan reduction: calls that a plan does not need are left out, one by one or with those that rest on them.

Greedy action elimination (Nakhost and Müller, Action Elimination and Plan Neighborhood Graph Search, 2010): a step is left out, and
with it all steps that cannot be carried out then; if the goal is reached all the same, and at no higher cost, the plan stays so.
Steps without which no part of the plan reaches the goal (`indispensable`) are not tried, and where one of them is lost the rest need not
be looked at: robots wait for this. When the time is over, the plan stays as it is by then.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from math import inf
from typing import TYPE_CHECKING, Final

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.plan import Plan, PlanningResult
from planner_bridge.model.problem import TOTAL_TIME, Problem
from planner_bridge.model.progression import Happening, NotApplicable, Progression, Stage, calls_of, happenings, refuse, snapshot
from planner_bridge.planning.kairos import validate
from planner_bridge.planning.validate import InvalidPlan, last_state
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import Condition, Holds, Not, conjuncts, evaluate, fluents, names
from pnm.core.logic.effects import possible_assignments
from pnm.core.logic.expressions import Constant, Fluent, State, Unknown, Value, ValueOf, value_of
from pnm.core.machine.plan_graph import GroundAction, Moment

if TYPE_CHECKING:
    import kairos

MAX_STEPS: Final = 250
"""Steps of a plan that is reduced: the work may grow with the square of their number."""


def reduced(problem: Problem, result: PlanningResult, parsed: kairos.Problem | None = None, *, until: float = inf) -> PlanningResult:
    """Return the result with a plan that has no needless step; one of a task network, or with preferences, is more than a way to a goal.

    Args:
        problem: what the plan is for.
        result: a plan, or none.
        parsed: the problem as Kairos reads it, if that is there already.
        until: when to stop looking, on the clock of `time.monotonic`; the plan may have needless steps then.
    """
    plan = result.plan
    if plan is None or problem.network or problem.has_preferences or len(plan.steps) > MAX_STEPS:
        return result
    if problem.metric is not None:
        plan = replace(plan, cost=_cost(problem, plan, last_state(problem, plan)))
    shorter = _Elimination(problem, plan).without_needless(until)
    is_shorter = len(shorter.steps) < len(plan.steps)
    return result if is_shorter and validate(problem, shorter, parsed) else replace(result, plan=shorter)


def indispensable(problem: Problem, actions: Sequence[GroundAction]) -> frozenset[int]:
    """Return numbers of actions that are in every part of the plan that reaches the goal; not all of them are found.

    What does not hold at first has to be made true. If a single action can do that, it is needed, and then what it demands is as well.
    """
    state, derived = initial_knowledge(problem), problem.domain.rules.derived
    by_itself = {fluent for change in problem.timed for fluent in change.changes}
    makers: dict[Fluent, dict[int, set[Value | None]]] = {}
    """The actions that may write a fluent, each with the values that it may write: None for one that is computed."""
    for number, action in enumerate(actions):
        for fluent, effect, _ in possible_assignments((*action.start_effects, *action.end_effects), state):
            value = effect.value.value if isinstance(effect.value, Constant) and effect.operation == "assign" else None
            makers.setdefault(fluent, {}).setdefault(number, set()).add(value)
    needed: set[int] = set()
    demands = [*conjuncts(problem.goal)]
    while demands:
        demand = demands.pop()
        if evaluate(demand, state) is True or not derived.isdisjoint(names(demand)):
            continue
        match demand:
            case Holds():
                useless: set[Value | None] = {False}
            case Not(Holds()):
                useless = {True}
            case _:
                useless = set()
        mentioned = fluents(demand, state)
        able = {number for fluent in mentioned for number, values in makers.get(fluent, {}).items() if not values <= useless}
        if by_itself.isdisjoint(mentioned) and len(able) == 1 and not able <= needed:
            needed |= able
            action = actions[able.pop()]
            demands += (part for condition in (action.precondition, action.end_condition) for part in conjuncts(condition))
    return frozenset(needed)


class _Elimination:
    """The search for needless steps: one simulation of the plan, and one of the rest for every step that may be needless.

    The mutable state is the plan, the numbers of the steps that were left out, and which of the first plan's steps are left.
    """

    def __init__(self, problem: Problem, plan: Plan) -> None:
        self._problem = problem
        self._first = plan
        self._actions = [call.action for call in calls_of(problem, plan)]
        self._happenings = happenings(problem, plan)
        self._needed = indispensable(problem, self._actions)
        self._plan = plan
        self._lost = frozenset[int]()

    def without_needless(self, until: float) -> Plan:
        """Return the plan without its needless steps, as far as they are found by then.

        Who gets in whose way is not looked at here, so the results have still to be validated.
        """
        simulation = Progression(initial_knowledge(self._problem))
        for position, happening in enumerate(self._happenings):
            for index in (event.call for event in happening.events if event.moment is Moment.START):
                if index in self._lost or index in self._needed:
                    continue
                if time.monotonic() >= until:
                    return self._plan
                self._try_without(index, position, simulation)
            try:
                self._advance(simulation, happening, self._lost)
            except NotApplicable:
                break
        return self._plan

    def _advance(self, simulation: Progression, happening: Happening, lost: Collection[int]) -> None:
        events = [(event, self._actions[event.call]) for event in happening.events if event.call not in lost]
        simulation.advance(events, happening.changes)

    def _try_without(self, index: int, position: int, before: Progression) -> None:
        """Leave a step out, and those after it that cannot be carried out without it, unless that is no better plan."""
        lost = self._lost_without(index, position, before)
        if lost is None:
            return
        left = [number for number in range(len(self._first.steps)) if number not in lost]
        while True:
            shorter = replace(self._first, steps=tuple(self._first.steps[number] for number in left))
            try:
                cost = _cost(self._problem, shorter, last_state(self._problem, shorter))
            except InvalidPlan as error:
                # the goal is not reached, or an earlier step cannot go on
                if error.step is None or left[error.step] < index:
                    return
                del left[error.step]
            else:
                rises = 0.0 if cost is None or self._plan.cost is None else cost - self._plan.cost
                is_worse = rises < 0.0 if self._problem.metric and self._problem.metric.direction == "maximize" else rises > 0.0
                if not is_worse:
                    self._plan, self._lost = replace(shorter, cost=cost), frozenset(range(len(self._first.steps))).difference(left)
                return

    def _lost_without(self, index: int, position: int, before: Progression) -> set[int] | None:
        """Return the steps that cannot be carried out when one more is left out; None if the others do not reach the goal."""
        lost = {*self._lost, index}

        def drop(call: int, stage: Stage, condition: Condition, state: KnowledgeBase) -> bool:
            if stage != "start" or call in self._needed:
                return refuse(call, stage, condition, state)
            lost.add(call)
            return False

        simulation = Progression(snapshot(before.state), before.running, drop)
        try:
            for happening in self._happenings[position:]:
                self._advance(simulation, happening, lost)
        except NotApplicable:
            return None
        return lost if evaluate(self._problem.goal, simulation.state) is True else None


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
