"""Robot time: the seconds that calls are expected to take, and those until all calls of a plan are carried out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from math import ceil, log10, prod
from statistics import mean
from types import MappingProxyType
from typing import Final

from planner_bridge.model.guards import unused_name
from planner_bridge.model.plan import Plan
from planner_bridge.model.problem import Domain, Metric, Problem, once_per_domain
from planner_bridge.model.progression import calls_of
from planner_bridge.model.rates import BEFORE, NO_RATES, Basis, Call, Chance, Counts, Durations, Rates, Rests, Times
from planner_bridge.ordering.plan_to_graph import plan_graph
from pnm.core.logic.domain import ActionSchema, Declaration
from pnm.core.logic.effects import Alternative, Set
from pnm.core.logic.expressions import Fluent, Value, ValueOf, bind, is_number
from pnm.core.machine.bindings import NO_BINDINGS, Bindings, placeholders
from pnm.core.machine.plan_graph import GroundAction, PlanGraph, PlanGraphError

UNMADE: Final = 0.9
"""The quantile of the seconds of an action that a call of it takes which was never made."""
MOST_PRICES: Final = 500
"""Calls of an action that have a price of their own for planners, or beginnings of calls."""


@dataclass(frozen=True)
class ExpectedTimes:
    """What is known about calls before they are made: how long an attempt takes, and how often it succeeds."""

    bindings: Bindings = NO_BINDINGS
    learned: Rates = NO_RATES
    known: Mapping[Fluent, Value] = field(default_factory=dict)
    """The values of the functions that bindings name for seconds."""

    @cached_property
    def _found(self) -> dict[tuple[str, tuple[str, ...], float | None], float]:
        """The expected seconds of calls that were asked for."""
        return {}

    def expected(self, action: GroundAction) -> float:
        """Return the seconds until a call has succeeded, attempts that fail included.

        Of a call that was never made while others of its action were, these are what most of them take: else plans would be made of the
        calls whose time is guessed too short.

        Those of an attempt are learned, else as the domain says, else as the binding says, else `ASSUMED_SECONDS`. A function of the
        problem says it for each call: what was learned of others does not count then. All attempts succeed as long as nothing else was
        learned.
        """
        key = action.name, action.arguments, action.duration
        if key not in self._found:
            declared, call, chance = self.declared(action), self._call(action), self.learned.chance(self._call(action))
            told = self.told(action)
            lasts = self.learned.mean(call, declared) if told is None else told.mean
            if declared is None and call.arguments and call.action in self._learned_apart and not self._own(action).n:
                lasts = max(lasts, self.learned.seconds(Call("", call.action), declared).quantile(UNMADE))
            if chance.rests.basis is Basis.LEARNED:
                lasts += (1.0 / chance.success - 1.0) * self.learned.mean(call, declared, succeeded=False)
            self._found[key] = lasts
        return self._found[key]

    def told(self, action: GroundAction) -> Durations | None:
        """Return the seconds of an attempt that succeeds, if a function of the problem says them, beside what that very call has taken."""
        if (declared := self.declared(action)) is None or function_of(action, self.bindings) is None:
            return None
        own, known = self._own(action), Rests(Basis.DECLARED)
        buckets = (*(own.seconds(known).buckets if own.n else ()), (declared, BEFORE))
        return Durations(buckets, (own.total / 1000.0 + BEFORE * declared) / (own.n + BEFORE), known)

    def _own(self, action: GroundAction) -> Times:
        """Return the measured times of the calls that begin like this one, as far as calls of its action are told apart."""
        depth = self.depth(action.name, action.parameters)
        return self.learned.groups.get(self._call(action).group[: 2 + depth], Counts()).took

    def outcomes(self, action: GroundAction, ways: Sequence[Alternative]) -> Chance:
        """Return how likely the outcomes of an action are."""
        return self.learned.outcomes(self._call(action), ways)

    def _call(self, action: GroundAction) -> Call:
        names_server = set(placeholders(self.bindings.of(action.name).server or "")) <= set(action.parameters)
        return Call.of(action, self.bindings) if action.arguments and names_server else Call("", action.name)

    def of(self, schema: ActionSchema, arguments: tuple[str, ...]) -> float:
        """Return the expected seconds of the calls of an action that begin with these arguments."""
        return self.expected(GroundAction(schema.name, arguments, schema.names[: len(arguments)]))

    def declared(self, action: GroundAction) -> float | None:
        """Return the seconds of a call as the domain or the binding says; None if neither does.

        They are the mean of all calls that begin so, and where the function that the binding names has no value those of the longest.
        """
        if action.duration is not None:
            return action.duration
        if (own := function_of(action, self.bindings)) is None:
            seconds = self.bindings.of(action.name).seconds
            return None if isinstance(seconds, tuple) else seconds
        if is_number(value := self.known.get(own)):
            return float(value)
        times = {fluent: float(value) for fluent, value in self.known.items() if fluent[0] == own[0] and is_number(value)}
        named = [(place, name) for place, name in enumerate(own) if not name.startswith("?")]
        alike = [time for fluent, time in times.items() if all(fluent[place] == name for place, name in named)]
        return mean(alike) if alike else max(times.values(), default=None)

    @cached_property
    def _learned_apart(self) -> dict[str, int]:
        return {call.action: len(call.arguments) for call in self.learned.calls}

    def depth(self, action: str, parameters: Sequence[str]) -> int:
        """Return the number of first arguments by which calls of an action are told apart."""
        seconds = self.bindings.of(action).seconds
        named = {term[1:] for term in seconds[1:]} if isinstance(seconds, tuple) else set[str]()
        return max([self._learned_apart.get(action, 0), *(number for number, name in enumerate(parameters, 1) if name in named)])

    @property
    def tell_apart(self) -> bool:
        """Whether calls of one action may take differently long."""
        return bool(self.learned.calls) or any(isinstance(binding.seconds, tuple) for binding in self.bindings.actions.values())

    def are_measure(self, problem: Problem) -> bool:
        """Return whether plans are measured by them: the domain has no metric and no times, and something is known about its actions."""
        names = problem.domain.actions
        is_known = any(self.bindings.of(name).seconds is not None or (name,) in self.learned.groups for name in names)
        return is_known and problem.metric is None and not problem.is_timed

    def have_turns(self, problem: Problem) -> bool:
        """Return whether no two calls can go on at the same time: there is a resource that all of them need."""
        needed: list[set[str]] = []
        for schema in problem.domain.actions.values():
            able = {v.name[1:]: {name for kind in v.types for name in problem.objects_by_type.get(kind, ())} for v in schema.parameters}
            only = {name: members.pop() for name, members in able.items() if len(members) == 1}
            patterns = self.bindings.of(schema.name).resources
            needed.append({pattern.format_map(only) for pattern in patterns if only.keys() >= {*placeholders(pattern)}})
        return bool(needed) and bool(set[str].intersection(*needed))


def function_of(action: GroundAction, bindings: Bindings) -> Fluent | None:
    """Return the function that says how long a call takes; None if its domain says it, or the binding names none."""
    seconds = bindings.of(action.name).seconds
    if action.duration is not None or not isinstance(seconds, tuple):
        return None
    return bind(seconds, {f"?{name}": value for name, value in zip(action.parameters, action.arguments, strict=True)})


def robot_time(problem: Problem, plan: Plan, rates: ExpectedTimes) -> float:
    """Return the seconds until all calls are carried out; a plan with times takes as long as these say."""
    if plan.temporal:
        return plan.makespan
    try:
        graph = plan_graph(problem, plan)
    except PlanGraphError:  # a plan that is valid, but not by causes alone: its calls can be made one after the other
        return sum(rates.expected(call.action) for call in calls_of(problem, plan))
    return max(ends_of(graph, rates), default=0.0)


def ends_of(graph: PlanGraph, rates: ExpectedTimes, left: Mapping[int, float] = MappingProxyType({})) -> list[float]:
    """Return the seconds until each call is over, if it begins as soon as those are over that it has to wait for.

    Calls that need the same resource take turns, in the order of the plan.

    Args:
        left: the seconds that calls under way still take, by number.
    """
    ends: list[float] = []
    free: dict[str, float] = {}
    for call in graph.calls:
        resources = rates.bindings.resources(call.action)
        begins = max((*(ends[other] for other in graph.waits_for[call.index]), *(free.get(name, 0.0) for name in resources)), default=0.0)
        ends.append(left[call.index] if call.index in left else begins + rates.expected(call.action))
        free |= dict.fromkeys(resources, ends[-1])
    return ends


def priced(problem: Problem, rates: ExpectedTimes, *, by_call: bool = False) -> Problem:
    """Return the problem with a metric that adds up the seconds of calls, if plans are measured by them and they differ.

    Planners that minimise it know nothing of calls that go on at the same time.

    Args:
        by_call: with the seconds of each call, as far as they are told apart, and not only those of its action.
    """
    if not rates.are_measure(problem):
        return problem
    prices, known = dict[str, dict[tuple[str, ...], float]](), problem.objects_by_type
    for schema in problem.domain.actions.values():
        able = [[name for kind in variable.types for name in known.get(kind, ())] for variable in schema.parameters]
        able = able[: by_call * rates.depth(schema.name, schema.names)]
        while prod(map(len, able)) > MOST_PRICES:
            able.pop()
        prices[schema.name] = {arguments: rates.of(schema, arguments) for arguments in product(*able)}
    every = {price for table in prices.values() for price in table.values()}
    if len(every) <= 1:
        return problem
    places = 2 - ceil(log10(max(every)))  # of what differs by a hundredth of the largest, planners need not weigh one against the other
    depths = tuple((name, len(next(iter(table)))) for name, table in prices.items() if table)
    domain, total, functions = domain_with_prices(problem.domain, depths)
    table = {
        (functions[name], *arguments): max(10.0**-places, round(price, places))
        for name, table in prices.items()
        for arguments, price in table.items()
    }
    return replace(problem, domain=domain, init={**problem.init, **table, (total,): 0.0}, metric=Metric("minimize", ValueOf((total,))))


@once_per_domain
def domain_with_prices(domain: Domain, depths: tuple[tuple[str, int], ...]) -> tuple[Domain, str, dict[str, str]]:
    """Return the domain whose actions add their seconds to a function, its name, and those of the functions with the seconds.

    Args:
        depths: for each action, the number of its first arguments on which its seconds depend.
    """
    total, functions = unused_name("robot-time", domain), {name: unused_name(f"seconds-of-{name}", domain) for name, _ in depths}
    actions, declared = dict(domain.actions), {total: Declaration(total)}
    for name, depth in depths:
        variables = actions[name].parameters[:depth]
        declared[functions[name]] = Declaration(functions[name], variables)
        added = Set((total,), ValueOf((functions[name], *(variable.name for variable in variables))), "increase")
        actions[name] = replace(actions[name], end_effects=(*actions[name].end_effects, added))
    requirements = tuple(dict.fromkeys((*domain.requirements, ":numeric-fluents")))
    return replace(domain, requirements=requirements, functions={**domain.functions, **declared}, actions=actions), total, functions
