"""Guards: what keeps actions from being used, compiled into the problem as preconditions."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement, product
from string import Formatter
from typing import Final, TypeAlias

from planner_bridge.model.problem import Domain, Problem, once_per_domain
from pnm.core.logic.conditions import All, Condition, Holds, Not, conjuncts
from pnm.core.logic.domain import ActionSchema, Declaration
from pnm.core.logic.effects import Effects, Set
from pnm.core.logic.expressions import Constant, Fluent, Value, Variable, bind
from pnm.core.machine.bindings import Bindings, placeholders, with_parts
from pnm.core.machine.plan_graph import GroundAction

# --- forbidden actions ----------------------------------------------------------------------------
# Ground actions that no plan may use any more.


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


def without_guards(problem: Problem) -> Problem:
    """Return the problem as it was before calls were forbidden."""
    names = {fluent[0] for fluent in problem.guards}

    def unguarded(schema: ActionSchema) -> ActionSchema:
        condition = schema.precondition
        while isinstance(condition, All) and condition.operands and not names.isdisjoint(_guard(condition.operands[0])[:1]):
            condition = condition.operands[1]
        return replace(schema, precondition=condition)

    predicates = {name: declared for name, declared in problem.domain.predicates.items() if name not in names}
    actions = {name: unguarded(schema) for name, schema in problem.domain.actions.items()}
    init = {fluent: value for fluent, value in problem.init.items() if fluent not in problem.guards}
    return replace(problem, domain=replace(problem.domain, predicates=predicates, actions=actions), init=init, guards={})


def is_forbidden(problem: Problem, action: str, arguments: tuple[str, ...]) -> bool:
    """Return whether a guard of the problem forbids the ground action."""
    schema = problem.domain.actions[action]
    env = schema.environment(arguments)
    return any(bind(_guard(part), env) in problem.guards for part in conjuncts(schema.precondition))


def _guard(condition: Condition) -> Fluent:
    """Return the fact that must not be true; empty if the condition is another one."""
    match condition:
        case Not(Holds(fluent)):
            return fluent
    return ()


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


def calls_needing(problem: Problem, bindings: Bindings, names: Collection[str]) -> frozenset[ForbiddenCall]:
    """Return the calls that need one of these robots, objects and resources, as `Bindings.named` says it of one call."""

    def patterns(action: str) -> Iterable[str]:
        parameters = (f"{{{variable.name.removeprefix('?')}}}" for variable in problem.domain.actions[action].parameters)
        return dict.fromkeys((*parameters, *with_parts(bindings.of(action).resources)))

    return _calls_naming(problem, names, patterns)


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


# --- exclusive resources --------------------------------------------------------------------------
# No plan with times has a robot in two places at once.
#
# The machine lets calls that need the same resource take turns, so a plan that has them at the same time would be late from the
# beginning. A domain may leave this to the bindings; then the planner has to be told.


_Uses = tuple[tuple[str, tuple[str, ...], str], ...]
"""Actions, the parameters in the name of a resource that they need, and its pattern without them."""
_ANYTHING: Final = "{}"


def with_turns(problem: Problem, bindings: Bindings) -> Problem:
    """Return the problem in which actions with durations that need the same resource cannot go on at the same time."""
    uses = _uses(problem.domain, bindings)
    return replace(problem, domain=domain_with_turns(problem.domain, uses)) if uses else problem


def relied_on(domain: Domain, bindings: Bindings) -> dict[str, tuple[str, ...]]:
    """Return the resources without which the domain would have actions at the same time, by pattern, and these actions."""
    found: dict[str, set[str]] = {}
    for (first, its, pattern), (second, others, same) in combinations_with_replacement(_uses(domain, bindings), 2):
        one, other = domain.actions[first], domain.actions[second]
        if pattern == same and not (_keeps_out(one, its, other, others) and _keeps_out(other, others, one, its)):
            named = pattern
            for parameter in its:
                named = named.replace(_ANYTHING, f"{{{parameter}}}", 1)
            found.setdefault(named, set()).update((first, second))
    return {name: tuple(sorted(actions)) for name, actions in found.items()}


def _uses(domain: Domain, bindings: Bindings) -> _Uses:
    lasting = (schema.name for schema in domain.actions.values() if schema.duration is not None)
    uses = []
    for name in lasting:
        for pattern in bindings.of(name).resources:
            parameters = tuple(placeholders(pattern))
            uses.append((name, parameters, pattern.format_map(dict.fromkeys(parameters, _ANYTHING))))
    return tuple(uses)


@once_per_domain
def domain_with_turns(domain: Domain, uses: _Uses) -> Domain:
    """Return the domain in which a fact about each resource is true while an action needs it, and keeps others out."""
    predicates, actions, facts = dict(domain.predicates), dict(domain.actions), dict[str, str]()
    for name, parameters, pattern in uses:
        if pattern not in facts:
            word = "".join(character if character.isalnum() else "-" for character in pattern.lower())
            facts[pattern] = unused_name(f"in-use-{word}", replace(domain, predicates=predicates))
            variables = tuple(Variable(f"?r{number}", ("object",)) for number in range(len(parameters)))
            predicates[facts[pattern]] = Declaration(facts[pattern], variables)
        fact: Fluent = (facts[pattern], *(f"?{parameter}" for parameter in parameters))
        schema = guarded(actions[name], Not(Holds(fact)))
        begun, over = (Set(fact, Constant(value)) for value in (True, False))
        actions[name] = replace(schema, start_effects=(*schema.start_effects, begun), end_effects=(*schema.end_effects, over))
    return with_guards(domain, predicates, actions)


def _keeps_out(running: ActionSchema, its: tuple[str, ...], other: ActionSchema, others: tuple[str, ...]) -> bool:
    """Return whether, by the domain alone, an action that goes on keeps another from beginning that needs the same resource.

    It takes away what the other needs at its start or all the time, or needs all the time what the other takes away: a fact about
    the resource. A robot is taken to be in one place at a time, whatever the domain says about the others.
    """

    def about(fluents: Iterator[Fluent], parameters: tuple[str, ...]) -> set[tuple[object, ...]]:
        own = {f"?{name}": number for number, name in enumerate(parameters)}
        return {(fluent[0], *(own.get(argument) for argument in fluent[1:])) for fluent in fluents if not own or own.keys() & {*fluent[1:]}}

    taken, needed = about(_deleted(running.start_effects), its), about(_needed(running, throughout=True), its)
    return bool(
        taken & about(_needed(other, throughout=False), others)
        or needed & about(_deleted((*other.start_effects, *other.end_effects)), others)
    )


def _deleted(effects: Effects) -> Iterator[Fluent]:
    return (effect.fluent for effect in effects if isinstance(effect, Set) and effect.value == Constant(False))


def _needed(schema: ActionSchema, *, throughout: bool) -> Iterator[Fluent]:
    conditions = (schema.invariant,) if throughout else (schema.precondition, schema.invariant)
    return (part.fluent for condition in conditions for part in conjuncts(condition) if isinstance(part, Holds))
