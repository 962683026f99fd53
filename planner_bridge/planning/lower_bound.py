"""Lower bounds: no plan costs less, or takes less time.

In a relaxation of the problem nothing is ever undone, and only facts, true or false, count as conditions. Every plan is one of the
relaxation as well, so the bounds hold whatever else is left out. What adds up is bounded by landmark cuts: every plan has an action of
each (Helmert and Domshlak 2009, *Landmarks, Critical Paths and Abstractions: What's the Difference Anyway?*). The time until all is
carried out is bounded by the critical path, and by the work that resources have to share.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from heapq import heappop, heappush
from math import inf
from typing import TYPE_CHECKING, Final, NamedTuple, TypeAlias

from planner_bridge.model.grounding import dynamic_names, initial_knowledge, modelled_duration
from planner_bridge.model.problem import TOTAL_TIME, Problem
from planner_bridge.planning.normal_form import Assignment, schema_assignments
from pnm.core.logic.conditions import Condition, Holds, Not, conjuncts, evaluate, names
from pnm.core.logic.domain import ActionSchema
from pnm.core.logic.expressions import (
    Constant,
    Environment,
    Expression,
    Fluent,
    ValueOf,
    bind,
    choices,
    expression_fluents,
    is_number,
    value_of,
)
from pnm.core.machine.plan_graph import GroundAction

if TYPE_CHECKING:
    from planner_bridge.ordering.robot_time import ExpectedTimes

_MOST: Final = 20_000
"""Ground actions of one kind that are looked at."""
_ROUNDING: Final = 1e-9

_Literal: TypeAlias = tuple[Fluent, bool]
_AT_FIRST: Final = 0
"""The number that stands for all facts of the initial state."""


class _Action(NamedTuple):
    """A ground action of the relaxation, with facts by number."""

    needs: tuple[int, ...]
    makes: tuple[int, ...]
    cost: float
    resources: tuple[str, ...] = ()


class _NoBound(Exception):
    """The metric is more than a sum of what calls add, or there are too many ground actions for the time."""


def lower_bound(problem: Problem, rates: ExpectedTimes | None, until: float) -> float:
    """Return what no plan is better than: its metric, its makespan, its expected robot time or its number of calls, whichever counts.

    Minus infinity where no bound is known.

    Args:
        rates: what calls are expected to take; None where nothing is known.
        until: when to stop, on the clock of `time.monotonic`; the bound is lower then.
    """
    metric = problem.metric if problem.metric and problem.metric.expression != ValueOf(TOTAL_TIME) else None
    is_time = metric is None and (problem.is_timed or (rates is not None and rates.are_measure(problem)))
    try:
        relaxed = _Relaxation(problem, rates if is_time and not problem.is_timed else None, until)
    except _NoBound:
        return -inf
    if not is_time:
        return relaxed.first + relaxed.landmark_cuts(until)
    times, _ = relaxed.critical_path([action.cost for action in relaxed.actions])
    usable = [action for action in relaxed.actions if action.cost and all(times[fact] < inf for fact in action.needs)]
    resources = {name for action in usable for name in action.resources}
    if not (usable and all(action.resources for action in usable)):
        return times[relaxed.goal]
    return max(times[relaxed.goal], relaxed.landmark_cuts(until) / len(resources))


class _Relaxation:
    """The ground actions of a problem, and its goal as a fact that one more action makes.

    Args:
        rates: what calls are expected to take, if that is their cost, in a problem without times.
        until: when to give up, on the clock of `time.monotonic`.
    """

    def __init__(self, problem: Problem, rates: ExpectedTimes | None, until: float) -> None:
        self._problem, self._rates, self._until = problem, rates, until
        self._state, self._changing = initial_knowledge(problem), dynamic_names(problem)
        self._counted: Fluent | None = None
        """What the metric is, if there is one."""
        self.first = 0.0
        if problem.metric and problem.metric.expression != ValueOf(TOTAL_TIME):
            counted, by_itself = problem.metric.expression, {fluent for change in problem.timed for fluent in change.changes}
            value = self._state.value(counted.fluent) if isinstance(counted, ValueOf) and counted.fluent not in by_itself else None
            if not (isinstance(counted, ValueOf) and is_number(value) and problem.metric.direction == "minimize"):
                raise _NoBound
            self._counted, self.first = counted.fluent, float(value)
        self._numbers: dict[_Literal, int] = {}
        if problem.domain.uncertain or problem.domain.nature:
            raise _NoBound
        self.actions = [action for schema in problem.domain.actions.values() for action in self.ground(schema)]
        needs = self._needs(problem.goal, {})
        self.goal = len(self._numbers) + 1
        self.actions.append(_Action(needs, (self.goal,), 0.0))
        self._users: list[list[int]] = [[] for _ in range(self.goal + 1)]
        self._makers: list[list[int]] = [[] for _ in range(self.goal + 1)]
        for number, action in enumerate(self.actions):
            for fact in action.needs:
                self._users[fact].append(number)
            for fact in action.makes:
                self._makers[fact].append(number)

    # --- grounding ------------------------------------------------------------------------------

    def ground(self, schema: ActionSchema) -> Iterator[_Action]:
        """Yield the ground actions of a schema; two of one whose start and end have effects at different times."""
        at_start, at_end = schema_assignments(schema)
        bounds = [constraint.bound for constraint in schema.duration or () if constraint.operation != "<="]
        for env in self.choices(schema):
            if time.monotonic() > self._until:
                raise _NoBound
            arguments = tuple(str(env[variable.name]) for variable in schema.parameters)
            needs, early, late = self._needs(schema.precondition, env), self._makes(at_start, env), self._makes(at_end, env)
            if self._rates is not None:
                action = GroundAction(schema.name, arguments, schema.names)
                yield _Action(needs, late, self._rates.expected(action), self._rates.bindings.resources(action))
            elif self._problem.is_timed and self._counted is None:
                is_known = None not in [self._constant(bound, env) for bound in bounds]
                yield _Action(needs, early, 0.0)
                yield _Action(needs, late, (modelled_duration(schema, arguments, self._state) or 0.0) if is_known else 0.0)
            else:
                added = 1.0 if self._counted is None else 0.0
                for effect in (*at_start, *at_end):
                    if self._counted and effect.fluent[0] == self._counted[0]:
                        amount = self._constant(effect.value, env)
                        if effect.operation != "increase" or amount is None or amount < 0.0:
                            raise _NoBound
                        added += amount if effect.is_plain and bind(effect.fluent, env) == self._counted else 0.0
                yield _Action(needs, (*early, *late), added)

    def choices(self, schema: ActionSchema) -> Iterator[Environment]:
        """Yield the choices of objects for the parameters with which conditions that never change hold."""
        may_change = self._changing | self._state.rules.derived | {fluent[0] for fluent in self._problem.unknown}
        static = [part for part in conjuncts(schema.precondition) if may_change.isdisjoint(names(part))]
        facts = [part.fluent for part in static if isinstance(part, Holds)]
        found, known = list[Environment]([{}]), set[str]()
        for variable in schema.parameters:
            known.add(variable.name)
            ready = [fluent for fluent in facts if variable.name in fluent and all(term in known or term[0] != "?" for term in fluent)]
            wider = ({**env, variable.name: value} for env in found for value in self._state.objects(variable.types))
            found = [env for env in wider if all(self._state.value(bind(fluent, env)) is True for fluent in ready)]
            if len(found) > _MOST or time.monotonic() > self._until:
                raise _NoBound
        yield from (env for env in found if all(evaluate(part, self._state, env) is not False for part in static))

    def _needs(self, condition: Condition, env: Environment) -> tuple[int, ...]:
        needs = {_AT_FIRST}
        for part in conjuncts(condition):
            match part:
                case Holds(fluent) | Not(Holds(fluent)):
                    if fluent[0] in self._problem.domain.predicates and fluent[0] not in self._state.rules.derived:
                        needs.add(self._fact((bind(fluent, env), isinstance(part, Holds))))
                case _:
                    pass
        return tuple(needs) if len(needs) == 1 else tuple(needs - {_AT_FIRST})

    def _makes(self, effects: Iterable[Assignment], env: Environment) -> tuple[int, ...]:
        facts = (
            (bind(effect.fluent, inner), truth)
            for effect in effects
            if effect.fluent[0] in self._problem.domain.predicates
            for inner in choices(effect.variables, self._state, env)
            for truth in ((effect.value.value is True,) if isinstance(effect.value, Constant) else (True, False))
        )
        return tuple({number for fact in facts if (number := self._fact(fact)) != _AT_FIRST})

    def _fact(self, literal: _Literal) -> int:
        fluent, truth = literal
        by_itself = any(fluent in change.changes for change in self._problem.timed)
        if by_itself or fluent in self._problem.unknown or (self._state.value(fluent) is True) is truth:
            return _AT_FIRST
        return self._numbers.setdefault(literal, len(self._numbers) + 1)

    def _constant(self, expression: Expression, env: Environment) -> float | None:
        """Return the number that an expression always is; None for one that changes."""
        if any(fluent[0] in self._changing for fluent in expression_fluents(expression)):
            return None
        value = value_of(expression, self._state, env)
        return float(value) if is_number(value) else None

    # --- bounds ---------------------------------------------------------------------------------

    def critical_path(self, costs: Sequence[float]) -> tuple[list[float], list[int]]:
        """Return the least time at which each fact is there, and, for each action, the one of its needs that is there last."""
        times, last = [inf] * (self.goal + 1), [_AT_FIRST] * len(self.actions)
        missing = [len(action.needs) for action in self.actions]
        times[_AT_FIRST] = 0.0
        queue, done = [(0.0, _AT_FIRST)], set[int]()
        while queue:
            now, fact = heappop(queue)
            if fact in done:
                continue
            done.add(fact)
            for number in self._users[fact]:
                missing[number] -= 1
                if not missing[number]:
                    last[number], then = fact, now + costs[number]
                    for made in self.actions[number].makes:
                        if then < times[made]:
                            times[made] = then
                            heappush(queue, (then, made))
        return times, last

    def landmark_cuts(self, until: float) -> float:
        """Return the sum of the least costs of disjoint cuts: sets of actions of each of which every plan has one."""
        costs, total = [action.cost for action in self.actions], 0.0
        while time.monotonic() < until:
            times, last = self.critical_path(costs)
            if not _ROUNDING < times[self.goal] < inf:
                break
            zone, found = {self.goal}, [self.goal]
            while found:
                for number in self._makers[found.pop()]:
                    reachable = all(times[fact] < inf for fact in self.actions[number].needs)
                    if costs[number] <= _ROUNDING and reachable and last[number] not in zone:
                        zone.add(last[number])
                        found.append(last[number])
            cut, reached, found = set[int](), {_AT_FIRST}, [_AT_FIRST]
            while found:
                fact = found.pop()
                for number in (one for one in self._users[fact] if last[one] == fact):
                    makes = self.actions[number].makes
                    if all(times[need] < inf for need in self.actions[number].needs):
                        if not zone.isdisjoint(makes):
                            cut.add(number)
                        else:
                            new = [made for made in makes if made not in reached]
                            reached.update(new)
                            found += new
            least = min(costs[number] for number in cut)
            total += least
            for number in cut:
                costs[number] -= least
        return total * (1.0 - _ROUNDING)
