"""Exclusive resources of actions, compiled into the problem: no plan with times has a robot in two places at once.

The machine lets calls that need the same resource take turns, so a plan that has them at the same time would be late from the
beginning. A domain may leave this to the bindings; then the planner has to be told.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations_with_replacement
from typing import Final

from planner_bridge.model.forbidden_actions import guarded, unused_name, with_guards
from planner_bridge.model.problem import Domain, Problem, once_per_domain
from pnm.core.logic.conditions import Holds, Not, conjuncts
from pnm.core.logic.domain import ActionSchema, Declaration
from pnm.core.logic.effects import Effects, Set
from pnm.core.logic.expressions import Constant, Fluent, Variable
from pnm.core.machine.bindings import Bindings, placeholders

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
