"""Conditions and what is known, as hypothesis draws them; and the oracle of derived facts: apply all rules until nothing changes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Set
from dataclasses import dataclass
from itertools import product

from hypothesis import strategies as st

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import All, Any, Compare, Condition, Exists, ForAll, Holds, Implies, Not, evaluate
from pnm.core.logic.expressions import UNKNOWN, Arithmetic, Constant, Environment, Fluent, State, Truth, Unknown, Value, ValueOf, Variable
from pnm.core.logic.rules import NO_RULES, DerivationRule, Rules

Facts = dict[Fluent, Value | Unknown]
OBJECTS = {"object": ("a", "b", "c"), "room": ("b", "c")}


def known(facts: Facts, rules: Rules = NO_RULES) -> KnowledgeBase:
    return KnowledgeBase(facts, objects=OBJECTS, rules=rules)


ARITY = {"p": 0, "q": 1, "e": 2, "d": 1, "f": 2, "g": 1, "h": 0}
BASE = ("p", "q", "e")
TYPES = st.sampled_from((("object",), ("room",)))


@st.composite
def stratified_conditions(
    draw: st.DrawFn, scope: tuple[str, ...], plain: tuple[str, ...], negated: tuple[str, ...], depth: int
) -> Condition:
    """A condition whose facts are of the names in `plain`, and under a negation of those in `negated`."""
    terms = st.sampled_from((*scope, "a", "b"))
    kind = draw(st.sampled_from(("holds", "holds", "compare", "not", "all", "any", "imply", "forall", "exists"))) if depth else "holds"
    if kind == "holds":
        name = draw(st.sampled_from(plain))
        return Holds((name, *(draw(terms) for _ in range(ARITY[name]))))
    if kind == "compare":
        if draw(st.booleans()):
            return Compare("=", Constant(draw(terms)), Constant(draw(terms)))
        number = ValueOf(("n", draw(terms)))
        other = draw(st.sampled_from((Constant(1.0), Arithmetic("/", (Constant(1.0), number)))))
        return Compare(draw(st.sampled_from(("<", "=", ">="))), number, other)
    if kind == "not":
        return Not(draw(stratified_conditions(scope, negated, plain, depth - 1)))
    if kind == "imply":
        return Implies(
            draw(stratified_conditions(scope, negated, plain, depth - 1)), draw(stratified_conditions(scope, plain, negated, depth - 1))
        )
    if kind in ("all", "any"):
        several = tuple(draw(stratified_conditions(scope, plain, negated, depth - 1)) for _ in range(draw(st.integers(0, 3))))
        return All(several) if kind == "all" else Any(several)
    own = tuple(
        Variable(name, draw(TYPES)) for name in draw(st.lists(st.sampled_from(("?x", "?y", "?z")), min_size=1, max_size=2, unique=True))
    )
    body = draw(stratified_conditions((*dict.fromkeys((*scope, *(one.name for one in own))),), plain, negated, depth - 1))
    return ForAll(own, body) if kind == "forall" else Exists(own, body)


ALL_FACTS = [(name, *chosen) for name in BASE for chosen in product(OBJECTS["object"], repeat=ARITY[name])]
ALL_NUMBERS = [("n", one) for one in OBJECTS["object"]]
FACTS: st.SearchStrategy[Facts] = st.builds(
    lambda facts, numbers: {**facts, **numbers},
    st.fixed_dictionaries({}, optional=dict.fromkeys(ALL_FACTS, st.sampled_from((True, True, False, UNKNOWN)))),
    st.fixed_dictionaries({}, optional=dict.fromkeys(ALL_NUMBERS, st.sampled_from((0.0, 1.0, UNKNOWN)))),
)


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
