"""The oracle of derived facts: apply all rules to all objects until nothing changes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Set
from dataclasses import dataclass
from itertools import product

from pnm.core.logic.conditions import evaluate
from pnm.core.logic.expressions import UNKNOWN, Environment, Fluent, State, Truth, Unknown, Value
from pnm.core.logic.rules import DerivationRule

Facts = dict[Fluent, Value | Unknown]
OBJECTS = {"object": ("a", "b", "c"), "room": ("b", "c")}
RANK: dict[Truth, int] = {False: 0, UNKNOWN: 1, True: 2}


@dataclass
class DerivedState:
    """Recorded facts and what has been derived so far."""

    facts: Facts
    derived: dict[Fluent, Truth]
    things: Mapping[str, tuple[str, ...]]

    def value(self, fluent: Fluent, /) -> Value | Unknown | None:
        return self.derived.get(fluent, self.facts.get(fluent))

    def objects(self, types: tuple[str, ...], /) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for one in types for name in self.things.get(one, ())))


def instances(rule: DerivationRule, state: State) -> Iterable[tuple[Fluent, Environment]]:
    """Every fact the rule may derive, with the objects for its variables."""
    for chosen in product(*(state.objects(variable.types) for variable in rule.variables)):
        yield (rule.name, *chosen), dict(zip((variable.name for variable in rule.variables), chosen, strict=True))


def least(
    rules: Iterable[DerivationRule], strata: Iterable[Set[str]], facts: Facts, things: Mapping[str, tuple[str, ...]] = OBJECTS
) -> dict[Fluent, Truth]:
    """The least fixpoint, stratum by stratum."""
    picture = DerivedState(facts, {}, things)
    for stratum in strata:
        ground_rules = [(fact, rule.condition, env) for rule in rules if rule.name in stratum for fact, env in instances(rule, picture)]
        picture.derived.update(dict.fromkeys((fact for fact, _, _ in ground_rules), False))
        while True:
            new: dict[Fluent, Truth] = {}
            for fact, condition, env in ground_rules:
                new[fact] = max(new.get(fact, False), evaluate(condition, picture, env), key=lambda truth: RANK[truth])
            if new.items() <= picture.derived.items():
                break
            picture.derived.update(new)
    return picture.derived
