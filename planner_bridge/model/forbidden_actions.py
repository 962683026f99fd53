"""Forbidden actions: ground actions that no plan may use any more, compiled into the problem as preconditions."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, replace
from itertools import product
from string import Formatter
from typing import Final, TypeAlias

from planner_bridge.model.problem import Domain, Problem, once_per_domain
from pnm.core.logic.conditions import All, Holds, Not
from pnm.core.logic.domain import ActionSchema, Declaration
from pnm.core.logic.expressions import Fluent, Value
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.plan_graph import GroundAction

ANY: Final = "?"
"""In the place of an argument: any object."""

_Kind: TypeAlias = tuple[str, tuple[int, ...]]
"""An action, and the positions of those arguments that are given."""


@dataclass(frozen=True, slots=True)
class ForbiddenCall:
    """A ground action that no plan may use any more, or all ground actions with these arguments."""

    action: str
    arguments: tuple[str, ...]
    awaited: bool = False
    """Whether it may be used as soon as more is known."""

    @staticmethod
    def of(action: GroundAction, *, awaited: bool = False) -> ForbiddenCall:
        """Return the value that forbids this ground action."""
        return ForbiddenCall(action.name, action.arguments, awaited)

    def covers(self, action: GroundAction) -> bool:
        """Whether the ground action is forbidden."""
        return self.action == action.name and all(mine in (ANY, its) for mine, its in zip(self.arguments, action.arguments, strict=True))

    @property
    def fixed(self) -> tuple[int, ...]:
        """The positions of the arguments that are given."""
        return tuple(number for number, argument in enumerate(self.arguments) if argument != ANY)

    def __str__(self) -> str:
        return f"{self.action}({', '.join(self.arguments)})"


def forbid(problem: Problem, forbidden: frozenset[ForbiddenCall]) -> Problem:
    """Return the problem in which every action concerned has a precondition that is false for the forbidden arguments."""
    if not forbidden:
        return problem
    domain, facts = _forbidding(problem.domain, frozenset((call.action, call.fixed) for call in forbidden))
    guards = {(facts[call.action, call.fixed], *(call.arguments[number] for number in call.fixed)): str(call) for call in forbidden}
    init: dict[Fluent, Value] = {**problem.init, **dict.fromkeys(guards, True)}
    return replace(problem, domain=domain, init=init, guards={**problem.guards, **guards})


@once_per_domain
def _forbidding(domain: Domain, kinds: frozenset[_Kind]) -> tuple[Domain, dict[_Kind, str]]:
    """Return the domain in which facts can forbid calls of these kinds, and the predicate of each."""
    predicates, actions = dict(domain.predicates), dict(domain.actions)
    facts: dict[_Kind, str] = {}
    for name, fixed in sorted(kinds):
        fact = facts[name, fixed] = unused_name(f"forbidden-{name}", replace(domain, predicates=predicates))
        parameters = tuple(actions[name].parameters[number] for number in fixed)
        predicates[fact] = Declaration(fact, parameters)
        actions[name] = guarded(actions[name], Not(Holds((fact, *(variable.name for variable in parameters)))))
    return with_guards(domain, predicates, actions), facts


def calls_acquiring(problem: Problem, bindings: Bindings, names: Collection[str]) -> frozenset[ForbiddenCall]:
    """Return the calls that acquire one of these resources, by the patterns of the bindings."""
    return _calls_naming(problem, names, lambda action: bindings.of(action).resources)


def calls_served_by(problem: Problem, bindings: Bindings, servers: Collection[str]) -> frozenset[ForbiddenCall]:
    """Return the calls that one of these action servers carries out, by the patterns of the bindings."""
    return _calls_naming(problem, servers, lambda action: (bindings.of(action).server or action,))


def _calls_naming(problem: Problem, names: Collection[str], patterns: Callable[[str], Iterable[str]]) -> frozenset[ForbiddenCall]:
    calls: set[ForbiddenCall] = set()
    for schema in problem.domain.actions.values() if names else ():
        for pattern, name in product(patterns(schema.name), names):
            values = _match_pattern(pattern, name)
            given = [(variable.types, (values or {}).get(variable.name.removeprefix("?"), ANY)) for variable in schema.parameters]
            # /d1/navigate may match the pattern of an action of other robots, which d1 is none of
            are_objects = (argument == ANY or problem.domain.matches(problem.objects.get(argument, ()), types) for types, argument in given)
            if values is not None and all(are_objects):
                calls.add(ForbiddenCall(schema.name, tuple(argument for _, argument in given)))
    return frozenset(calls)


def _match_pattern(pattern: str, name: str) -> dict[str, str] | None:
    """Return the values of the parameters in braces for which the pattern becomes the name; None if there are none."""
    parts = list(Formatter().parse(pattern))
    expression = "".join(re.escape(text) + ("" if parameter is None else "(.+)") for text, parameter, _, _ in parts)
    match = re.fullmatch(expression, name)
    if match is None:
        return None
    values: dict[str, str] = {}
    for parameter, value in zip((name for _, name, _, _ in parts if name is not None), match.groups(), strict=True):
        if values.setdefault(parameter, value) != value:
            return None
    return values


def unused_name(name: str, domain: Domain) -> str:
    """Return a name for a new predicate: this one, lengthened until the domain does not have it."""
    while name in domain.predicates or name in domain.functions:
        name += "-"
    return name


def guarded(schema: ActionSchema, guard: Not) -> ActionSchema:
    """Return the action with one more precondition."""
    return replace(schema, precondition=All((guard, schema.precondition)))


def with_guards(domain: Domain, predicates: dict[str, Declaration], actions: dict[str, ActionSchema]) -> Domain:
    """Return the domain with these predicates and guarded actions, and the requirement for negative preconditions."""
    requirements = tuple(dict.fromkeys((*domain.requirements, ":negative-preconditions")))
    return replace(domain, requirements=requirements, predicates=predicates, actions=actions)
