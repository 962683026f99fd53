"""Derived facts: rules for when a fact holds that no action and no sensor sets (PDDL 2.2, derived predicates).

A derived fact holds if the condition of one of its rules does, and not otherwise: the derived facts are
the least fixpoint of the rules. Negation must be *stratified*:
no name may depend on its own negation. Then the names fall into strata; a rule negates only names
of lower ones, and each stratum has a least fixpoint once those below it are settled. With the truth
values ordered false < unknown < true that is so for three values as for two.

Names that no rule derives are *base* names. For `pnm.core.logic.derived_facts` a rule is split into *bodies*:
conjunctions with variables of their own, whose steps are ordered as a join: objects are looked up
among the recorded facts before all objects of a type are tried.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Final, TypeAlias

from pnm.core.logic.conditions import (
    All,
    Any,
    Compare,
    Computed,
    Condition,
    Exists,
    Holds,
    every_part,
    free_variables,
    ground,
    names,
    polarities,
)
from pnm.core.logic.expressions import Fluent, Variable, expression_fluents, variables_in
from pnm.errors import PnmError


class UnstratifiedError(PnmError):
    """A derived fact would depend on its own negation, so the rules have no unique least fixpoint."""


@dataclass(frozen=True, slots=True)
class DerivationRule:
    """The facts of this name hold for every choice of objects for which the condition does.

    Several rules may derive facts of one name: one that holds is enough.
    """

    name: str
    variables: tuple[Variable, ...]
    condition: Condition


@dataclass(frozen=True, slots=True)
class CheckCondition:
    """A step: the condition must hold; all of its variables are bound by now."""

    condition: Condition


@dataclass(frozen=True, slots=True)
class FindFact:
    """A step: some recorded fact must match this one, which binds its other variables."""

    condition: Holds
    known: tuple[int, ...]
    """Positions of the terms that are bound by now."""
    new: tuple[tuple[int, Variable], ...]
    """Positions of the variables that the fact binds, with these."""


@dataclass(frozen=True, slots=True)
class ChooseObject:
    """A step: bind the variable to any object of its types."""

    variable: Variable


BodyStep: TypeAlias = CheckCondition | FindFact | ChooseObject


@dataclass(frozen=True, slots=True)
class Body:
    """One way to derive a fact: all steps succeed for some binding of the body's own variables."""

    head: tuple[Variable, ...]
    steps: tuple[BodyStep, ...]

    @property
    def parts(self) -> tuple[Condition, ...]:
        """The conditions that must all hold."""
        return tuple(step.condition for step in self.steps if not isinstance(step, ChooseObject))


@dataclass(frozen=True)
class Rules:
    """The rules of a domain; raises `UnstratifiedError` if a derived name depends on its own negation."""

    rules: tuple[DerivationRule, ...] = ()

    def __post_init__(self) -> None:
        for name in self.derived:
            negated = (other for other, is_negated in self._mentioned[name] if is_negated)
            if any(name in self._below(other) for other in negated):
                raise UnstratifiedError(f"whether ({name} …) holds would depend on its own negation")

    def __iter__(self) -> Iterator[DerivationRule]:
        """Iterate over the rules, in their order."""
        return iter(self.rules)

    def __len__(self) -> int:
        return len(self.rules)

    @cached_property
    def derived(self) -> frozenset[str]:
        """The names that the rules derive."""
        return frozenset(rule.name for rule in self.rules)

    @cached_property
    def strata(self) -> dict[str, int]:
        """For every derived name its stratum: a rule negates only names of lower strata, and mentions none of higher ones."""
        levels = dict.fromkeys(self.derived, 0)
        for _ in self.derived:  # the longest chain of names settles in as many rounds
            for name, mentioned in self._mentioned.items():
                levels[name] = max((levels[other] + negated for other, negated in mentioned), default=0)
        return levels

    @cached_property
    def bodies(self) -> dict[str, tuple[Body, ...]]:
        """For every derived name, the ways to derive a fact of it."""
        bodies: dict[str, tuple[Body, ...]] = {}
        for rule in self.rules:
            head = frozenset(variable.name for variable in rule.variables)
            split = (_body(rule.variables, own, parts, self.derived) for own, parts in _split(rule.condition, head))
            bodies[rule.name] = (*bodies.get(rule.name, ()), *split)
        return bodies

    def base(self, mentioned: Iterable[str]) -> frozenset[str]:
        """Return the base names on which facts of these names depend, each derived name replaced by those below it."""
        return frozenset().union(*(self._base.get(name, (name,)) for name in mentioned))

    @cached_property
    def above(self) -> dict[str, frozenset[str]]:
        """For every base name below one, the derived names that depend on it."""
        names = frozenset().union(*self._base.values())
        return {name: frozenset(derived for derived, below in self._base.items() if name in below) for name in names}

    @cached_property
    def _base(self) -> dict[str, frozenset[str]]:
        own = {name: frozenset[str]().union(*(names(rule.condition) for rule in self.rules if rule.name == name)) for name in self.derived}
        return {name: frozenset().union(*(own[below] for below in self._below(name))) - self.derived for name in self.derived}

    @cached_property
    def _mentioned(self) -> dict[str, frozenset[tuple[str, bool]]]:
        """For every derived name, the derived names in its rules, and whether they are negated there."""
        mentioned = {name: frozenset[tuple[str, bool]]() for name in self.derived}
        for rule in self.rules:
            mentioned[rule.name] |= {(name, not positive) for name, positive in polarities(rule.condition) if name in self.derived}
        return mentioned

    def _below(self, name: str) -> frozenset[str]:
        """Return the derived name and all those it depends on."""
        below, waiting = {name}, [name]
        while waiting:
            for other, _ in self._mentioned[waiting.pop()]:
                if other not in below:
                    below.add(other)
                    waiting.append(other)
        return frozenset(below)


NO_RULES: Final = Rules()

Reads: TypeAlias = frozenset[Fluent | str] | None
"""Recorded fluents, and names that stand for all fluents of that name; None for anything, also variables."""


def read_by(condition: Condition, rules: Rules) -> Reads:
    """Return what decides whether a condition holds: only if it changes, or objects or rules do, the truth may change."""
    found: set[Fluent | str] = set()
    for part in every_part(condition):
        if isinstance(part, Computed):
            return None
        if isinstance(part, Holds):
            found |= reads_of(part.fluent, rules)
        elif isinstance(part, Compare):
            for fluent in (*expression_fluents(part.left), *expression_fluents(part.right)):
                found |= reads_of(fluent, rules)
    return frozenset(found)


def reads_of(fluent: Fluent, rules: Rules) -> frozenset[Fluent | str]:
    """Return what decides about the value of a fluent: itself, if it is ground and recorded."""
    if fluent[0] in rules.derived:
        return rules.base((fluent[0],))
    return frozenset((fluent[0],) if variables_in(fluent) else (fluent,))


# --- bodies --------------------------------------------------------------------------------


def _split(condition: Condition, taken: frozenset[str]) -> Iterator[tuple[tuple[Variable, ...], tuple[Condition, ...]]]:
    """Split a condition into alternatives: existential variables, and conjuncts that must hold for some binding of them.

    A conjunction with a disjunction in it is not multiplied out. Variables are renamed apart from those in `taken`.
    """
    match condition:
        case Any(operands):
            for operand in operands:
                yield from _split(operand, taken)
        case Exists(variables, body):
            new = tuple(Variable(_unused(variable.name, taken), variable.types) for variable in variables)
            renamed = ground(body, {old.name: fresh.name for old, fresh in zip(variables, new, strict=True)})
            for own, parts in _split(renamed, taken | {variable.name for variable in new}):
                yield (*new, *own), parts
        case All(operands):
            mine: tuple[Variable, ...] = ()
            conjuncts: tuple[Condition, ...] = ()
            for operand in operands:
                ways = list(_split(operand, taken | {variable.name for variable in mine}))
                own, parts = ways[0] if len(ways) == 1 else ((), (operand,))
                mine, conjuncts = (*mine, *own), (*conjuncts, *parts)
            yield mine, conjuncts
        case _:
            yield (), (condition,)


def _unused(name: str, taken: frozenset[str]) -> str:
    while name in taken:
        name += "'"
    return name


def _body(head: tuple[Variable, ...], own: tuple[Variable, ...], parts: tuple[Condition, ...], derived: frozenset[str]) -> Body:
    """Order the conjuncts: those without unbound variables first, base before derived; then the base fact with most terms bound."""
    open_ = {variable.name: variable for variable in own}
    left, steps = list(parts), list[BodyStep]()
    while left or open_:
        ready = [part for part in left if not free_variables(part) & open_.keys()]
        steps += map(CheckCondition, sorted(ready, key=lambda part: not names(part).isdisjoint(derived)))
        left = [part for part in left if part not in ready]
        if not open_:
            continue
        finds = [part for part in left if isinstance(part, Holds) and part.fluent[0] not in derived]
        if finds:
            # the most selective lookup first, as in a database join
            best = max((_find(part, open_) for part in finds), key=lambda find: len(find.known))
            steps.append(best)
            left.remove(best.condition)
            for _, variable in best.new:
                open_.pop(variable.name, None)
        else:
            steps.append(ChooseObject(open_.pop(next(iter(open_)))))
    return Body(head, tuple(steps))


def _find(condition: Holds, unknown: dict[str, Variable]) -> FindFact:
    terms = tuple(enumerate(condition.fluent))
    known = tuple(position for position, term in terms if term not in unknown)
    return FindFact(condition, known, tuple((position, unknown[term]) for position, term in terms if term in unknown))
