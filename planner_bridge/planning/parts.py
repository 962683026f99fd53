"""Parts of a plan, each replaced by a better one: from the state before it to what the rest of the plan needs.

A part of a long plan is a short problem, which Kairos solves best in milliseconds where the whole would take hours (Siddiqui and
Haslum 2015, *Continuing Plan Quality Optimisation*, on windows of plans). Detours over places where nothing is done, things that are
put down to be picked up again, and ways that could be gone once for two things, all lie in such parts. Most of them have a better one
of calls like those of the plan: of these there are few, so that longer parts can be searched.

What the rest needs is guessed from what it reads; a whole plan with another part is valid only by the validator.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from math import ceil, floor, inf
from typing import Final

from planner_bridge.model.grounding import conditions_of, initial_knowledge
from planner_bridge.model.guards import unused_name
from planner_bridge.model.plan import Plan, PlanStep
from planner_bridge.model.problem import Domain, Problem, once_per_domain
from planner_bridge.model.progression import NotApplicable, Progression, calls_of, snapshot
from planner_bridge.ordering.plan_to_graph import causal_links
from pnm.core.logic.conditions import All, Any, Compare, Condition, Holds, Not, conjunction, evaluate, every_part, fluents
from pnm.core.logic.domain import Declaration
from pnm.core.logic.effects import constants
from pnm.core.logic.expressions import Arithmetic, Constant, Fluent, State, Unknown, Value, ValueOf, is_number, value_of

_SIGNS: Final = {">": 1.0, ">=": 1.0, "<": -1.0, "<=": -1.0}
SHORTEST: Final = 6
"""Calls of the parts that are tried first; each round tries parts that are longer by half."""


def can_have_parts(problem: Problem) -> bool:
    """Return whether a plan is a sequence of calls of which only the end matters."""
    watched = problem.constraints or problem.domain.constraints or problem.has_preferences or problem.network
    return not (problem.is_timed or watched)


def narrowed(problem: Problem, steps: Sequence[PlanStep]) -> Problem:
    """Return the problem with only those calls each of whose arguments a step of the same action has at the same place."""
    domain, has_argument = _that_names_arguments(problem.domain)
    init: dict[Fluent, Value] = dict(problem.init)
    for step in steps:
        init |= dict.fromkeys(zip(has_argument[step.action], step.arguments, strict=True), True)
    return replace(problem, domain=domain, init=init)


@once_per_domain
def _that_names_arguments(domain: Domain) -> tuple[Domain, dict[str, tuple[str, ...]]]:
    """Return the domain in which every action needs a fact for each of its arguments, and the predicates of these facts."""
    predicates, actions, named = dict(domain.predicates), dict(domain.actions), dict[str, tuple[str, ...]]()
    for name, schema in domain.actions.items():
        named[name] = tuple(unused_name(f"{name}-argument-{place}", domain) for place in range(len(schema.parameters)))
        needed = list(zip(named[name], schema.parameters, strict=True))
        predicates |= {predicate: Declaration(predicate, (variable,)) for predicate, variable in needed}
        facts = (Holds((predicate, variable.name)) for predicate, variable in needed)
        actions[name] = replace(schema, precondition=conjunction([schema.precondition, *facts]))
    return replace(domain, predicates=predicates, actions=actions), named


def better_parts(
    problem: Problem, plan: Plan, solve: Callable[[Problem, Sequence[PlanStep], float | None], Plan | None], take: Callable[[Plan], bool]
) -> Iterator[bool]:
    """Replace parts of a plan by better ones: yield True after each part that was tried, the longest of which is all but the whole.

    They are tried with arguments that the plan has, and then all once more with any.

    Args:
        solve: finds a better plan for a part, of which it gets the steps so far, and the metric after them; or none in a short time.
        take: takes a plan if it is better, and returns whether it was taken.
    """
    comparisons = [part for condition in conditions_of(problem) for part in every_part(condition) if isinstance(part, Compare)]
    sides = [(part.left, part.right, part.operation) for part in comparisons]
    sides += [(right, left, {">": "<", "<": ">", ">=": "<=", "<=": ">="}.get(operation, "=")) for left, right, operation in sides]
    wanted = [(side.fluent[0], operation) for side, _, operation in sides if isinstance(side, ValueOf)]
    large = frozenset(name for name, _ in wanted) - {name for name, operation in wanted if not operation.startswith(">")}
    rest = _Rest(problem, plan, large)
    for is_narrow in (True, False):
        length = SHORTEST
        while length < len(plan.steps):
            first = 0
            while first < len(plan.steps) - 1:
                last = min(first + length, len(plan.steps))
                part = rest.part(first, last)
                found = solve(narrowed(part, plan.steps) if is_narrow else part, plan.steps[first:last], rest.metric(last))
                if found is not None:
                    other = replace(plan, steps=(*plan.steps[:first], *found.steps, *plan.steps[last:]))
                    with suppress(NotApplicable):
                        rest_of_other = _Rest(problem, other, large)
                        if rest_of_other.reaches_goal and take(other):
                            plan, rest, first = other, rest_of_other, first - length
                first = max(0, first + length // 2)
                yield True
            length += length // 2


def _spare(condition: Condition, states: tuple[State, State], fluent: Fluent) -> float:
    """Return by how much a number may be less with the condition still true, in whole steps; less than 0 if it is not.

    Args:
        states: one, and the same with one less.
    """
    match condition:
        case All(operands):
            return min((_spare(operand, states, fluent) for operand in operands), default=inf)
        case Any(operands):
            return max((_spare(operand, states, fluent) for operand in operands), default=-1.0)
        case _ if evaluate(condition, states[0]) is not True:
            return -1.0
        case Compare(operation, left, right) if operation in _SIGNS:
            now, then = [value_of(Arithmetic("-", (left, right)), state) for state in states]
            assert isinstance(now, float)
            assert isinstance(then, float)
            gap, loss = _SIGNS[operation] * now, _SIGNS[operation] * (now - then)
            return inf if loss <= 0.0 else floor(gap / loss) if operation.endswith("=") else ceil(gap / loss) - 1
        case _:
            return inf if fluent not in fluents(condition, states[0]) else 0.0


class _Rest:
    """The states of a plan, and what its rest reads from each on; raises `NotApplicable` if it cannot be carried out.

    Args:
        large: the functions that conditions want to be large, such as a battery's charge, and never small.
    """

    def __init__(self, problem: Problem, plan: Plan, large: frozenset[str]) -> None:
        self._problem = problem
        calls = calls_of(problem, plan)
        simulation, links = Progression(initial_knowledge(problem)), causal_links(problem, [call.action for call in calls])
        self._states = [snapshot(simulation.state)]
        for call, start, end in zip(calls, links.starts, links.ends, strict=True):
            simulation.advance([(start, call.action), (end, call.action)])
            self._states.append(snapshot(simulation.state))
        self.reaches_goal = evaluate(problem.goal, simulation.state) is True
        needed = links.relevant_of(fluents(problem.goal, simulation.state))
        self._reads = [needed]
        """By position: what the rest reads before it writes it."""
        for call, start, end in zip(reversed(calls), reversed(links.starts), reversed(links.ends), strict=True):
            needed = (needed - (constants(call.action.end_effects) or {}).keys()) | links.reads[start] | links.reads[end]
            self._reads.append(needed)
        self._reads.reverse()
        self._spare = {fluent: [inf] for fluent in simulation.state.facts() if fluent[0] in large}
        """By position: by how much a large number may be less there with the rest still going on to the goal."""
        demands = [*((call.action.precondition, call.action.end_effects) for call in calls), (problem.goal, ())]
        for fluent, spare in self._spare.items():
            for (condition, effects), state in zip(reversed(demands), reversed(self._states), strict=True):
                less, value = snapshot(state), state.value(fluent)
                less.update({fluent: value - 1.0} if is_number(value) else {})
                later = inf if fluent in (constants(effects) or {}) else spare[-1]
                spare.append(min(later, _spare(condition, (state, less), fluent)))
            spare.reverse()
        own = (fluents(condition, simulation.state) for condition in (problem.goal, *(call.action.precondition for call in calls)))
        self._mentioned = frozenset().union(*own)
        """What conditions mention themselves, and not only what derived facts follow from."""

    def metric(self, position: int) -> float | None:
        """Return the value of the metric at a position; None if there is none, or only the number of steps counts."""
        metric = self._problem.metric
        value = None if metric is None else value_of(metric.expression, self._states[position])
        return value if isinstance(value, float | int) else None

    def part(self, first: int, last: int) -> Problem:
        """Return the problem of coming from one position to what the rest from another on needs."""
        state, goals = self._states[last], list[Condition]()
        for fluent in sorted(self._reads[last]):
            match state.value(fluent):
                case True:
                    goals.append(Holds(fluent))
                case False | None if fluent in self._mentioned and fluent[0] in self._problem.domain.predicates:
                    goals.append(Not(Holds(fluent)))
                case int() | float() as value if (spare := self._spare.get(fluent)) and value is not False:
                    goals += [Compare(">=", ValueOf(fluent), Constant(value - spare[last]))] if 0.0 <= spare[last] < inf else []
                case int() | float() | str() as value if value is not False:
                    goals.append(Compare("=", ValueOf(fluent), Constant(value)))
        facts = self._states[first].facts()
        init = {fluent: value for fluent, value in facts.items() if not isinstance(value, Unknown)}
        return replace(self._problem, init=init, goal=conjunction(goals))
