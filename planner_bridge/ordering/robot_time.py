"""Robot time: the seconds that calls are expected to take, and those until all calls of a plan are carried out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType

from planner_bridge.model.forbidden_actions import unused_name
from planner_bridge.model.plan import Plan
from planner_bridge.model.problem import Domain, Metric, Problem, once_per_domain
from planner_bridge.model.progression import calls_of
from planner_bridge.model.rates import NO_RATES, Basis, Call, Rates
from planner_bridge.ordering.plan_to_graph import plan_graph
from pnm.core.logic.domain import Declaration
from pnm.core.logic.effects import Set
from pnm.core.logic.expressions import Constant, ValueOf
from pnm.core.machine.bindings import NO_BINDINGS, Bindings, placeholders
from pnm.core.machine.plan_graph import GroundAction, PlanGraph, PlanGraphError


@dataclass(frozen=True)
class ExpectedTimes:
    """What is known about calls before they are made: how long an attempt takes, and how often it succeeds."""

    bindings: Bindings = NO_BINDINGS
    learned: Rates = NO_RATES

    @cached_property
    def _found(self) -> dict[tuple[str, tuple[str, ...], float | None], float]:
        """The expected seconds of calls that were asked for."""
        return {}

    def expected(self, action: GroundAction) -> float:
        """Return the seconds until a call has succeeded, attempts that fail included.

        Those of an attempt are learned, else as the domain says, else as the binding says, else `ASSUMED_SECONDS`. All attempts succeed
        as long as nothing else was learned.
        """
        key = action.name, action.arguments, action.duration
        if key not in self._found:
            declared = self.bindings.of(action.name).seconds if action.duration is None else action.duration
            is_whole = len(action.arguments) == len(action.parameters) > 0  # else the action at large is meant
            call = Call.of(action, self.bindings) if is_whole else Call("", action.name)
            chance, lasts = self.learned.chance(call), self.learned.seconds(call, declared).mean
            if chance.rests.basis is Basis.LEARNED:
                lasts += (1.0 / chance.success - 1.0) * self.learned.seconds(call, declared, succeeded=False).mean
            self._found[key] = lasts
        return self._found[key]

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
    waits: list[list[int]] = [[] for _ in graph.calls]
    for ordering in graph.orderings:
        waits[ordering.after.call].append(ordering.before.call)
    for call in graph.calls:
        resources = rates.bindings.resources(call.action)
        begins = max((*(ends[other] for other in waits[call.index]), *(free.get(name, 0.0) for name in resources)), default=0.0)
        ends.append(left[call.index] if call.index in left else begins + rates.expected(call.action))
        free |= dict.fromkeys(resources, ends[-1])
    return ends


def priced(problem: Problem, rates: ExpectedTimes) -> Problem:
    """Return the problem with a metric that adds up the seconds of calls, if plans are measured by them and they differ.

    Planners that minimise it know nothing of calls that go on at the same time.
    """
    if not rates.are_measure(problem):
        return problem
    seconds = tuple((name, rates.expected(GroundAction(name))) for name in problem.domain.actions)
    if len({price for _, price in seconds}) == 1:
        return problem
    domain, name = domain_with_prices(problem.domain, seconds)
    return replace(problem, domain=domain, init={**problem.init, (name,): 0.0}, metric=Metric("minimize", ValueOf((name,))))


@once_per_domain
def domain_with_prices(domain: Domain, seconds: tuple[tuple[str, float], ...]) -> tuple[Domain, str]:
    """Return the domain whose actions add their seconds to a function, and its name."""
    name = unused_name("robot-time", domain)
    actions = dict(domain.actions)
    for action, price in seconds:
        added = Set((name,), Constant(price), "increase")
        actions[action] = replace(actions[action], end_effects=(*actions[action].end_effects, added))
    requirements = tuple(dict.fromkeys((*domain.requirements, ":numeric-fluents")))
    return replace(domain, requirements=requirements, functions={**domain.functions, name: Declaration(name)}, actions=actions), name
