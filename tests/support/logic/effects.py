"""Effects, and strategies for them and for the states they change."""

from __future__ import annotations

from hypothesis import strategies as st

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import TRUE, Condition, Holds, Not, evaluate
from pnm.core.logic.effects import OPERATIONS, Effect, Effects, ForEach, Set, When, ground_effects
from pnm.core.logic.expressions import (
    UNKNOWN,
    Arithmetic,
    Constant,
    Environment,
    Expression,
    Fluent,
    Unknown,
    Value,
    ValueOf,
    Variable,
    bind,
    choices,
    ground_expression,
)

ROOMS = ("hall", "kitchen")


def add(*fluent: str) -> Set:
    return Set(fluent, Constant(True))


def delete(*fluent: str) -> Set:
    return Set(fluent, Constant(False))


def change_number(operation: str, name: str, by: Expression | float) -> Set:
    return Set((name,), Constant(by) if isinstance(by, float) else by, operation)


def rooms_state(facts: dict[Fluent, Value | Unknown] | None = None) -> KnowledgeBase:
    return KnowledgeBase(facts, objects={"room": ROOMS, "object": ROOMS})


TERMS = st.sampled_from((*ROOMS, "?x"))
FACTS = st.one_of(st.just(("p",)), st.tuples(st.just("at"), TERMS))
NUMBERS = st.sampled_from((("n",), ("m",)))
AMOUNTS: st.SearchStrategy[Expression] = st.one_of(
    st.builds(Constant, st.sampled_from((0.0, 1.0, 2.0))),
    st.builds(ValueOf, NUMBERS),
    st.builds(lambda fluent: Arithmetic("+", (ValueOf(fluent), Constant(1.0))), NUMBERS),
)
PLAIN = st.one_of(st.builds(add, st.just("p")), st.builds(Set, FACTS, st.builds(Constant, st.booleans())))
SETS = st.one_of(PLAIN, st.builds(Set, NUMBERS, AMOUNTS, st.sampled_from(OPERATIONS)))
CONDITIONS: st.SearchStrategy[Condition] = st.one_of(st.just(TRUE), st.builds(Holds, FACTS), st.builds(Not, st.builds(Holds, FACTS)))


def effects_of(sets: st.SearchStrategy[Set], early: st.SearchStrategy[bool] = st.just(False)) -> st.SearchStrategy[Effect]:
    """Effects that are made of these, under conditions, which may be decided early, and for all rooms."""
    return st.recursive(
        sets,
        lambda inner: st.one_of(
            st.builds(When, CONDITIONS, st.lists(inner, max_size=3).map(tuple), early),
            st.builds(ForEach, st.just((Variable("?x"),)), st.lists(inner, max_size=3).map(tuple)),
        ),
        max_leaves=4,
    )


EFFECTS = effects_of(SETS)


def at_hall(effects: st.SearchStrategy[Effect]) -> st.SearchStrategy[Effects]:
    return st.lists(effects, max_size=4).map(lambda chosen: ground_effects(tuple(chosen), {"?x": "hall"}))


ANY_EFFECTS = at_hall(EFFECTS)
MIXED_EFFECTS = at_hall(effects_of(SETS, st.booleans()))
ALL_FACTS: list[Fluent] = [("p",), ("at", "hall"), ("at", "kitchen")]
ALL_NUMBERS: list[Fluent] = [("n",), ("m",)]
TRUTHS: st.SearchStrategy[Value | Unknown] = st.sampled_from((True, False, UNKNOWN))
FIGURES: st.SearchStrategy[Value | Unknown] = st.sampled_from((0.0, 1.0, 2.5, UNKNOWN))
STATES = st.builds(
    lambda facts, numbers: rooms_state({**facts, **numbers}),
    st.fixed_dictionaries({}, optional=dict.fromkeys(ALL_FACTS, TRUTHS)),
    st.fixed_dictionaries({}, optional=dict.fromkeys(ALL_NUMBERS, FIGURES)),
)


def happening(effects: Effects, start: KnowledgeBase, end: KnowledgeBase, env: Environment) -> list[tuple[Fluent, Expression, str]]:
    """The oracle: every `Set` that happens, each condition asked in the state it is about."""
    found: list[tuple[Fluent, Expression, str]] = []
    for effect in effects:
        match effect:
            case Set(fluent, value, operation):
                found.append((bind(fluent, env), ground_expression(value, env), operation))
            case When(condition, inner, is_early):
                if evaluate(condition, start if is_early else end, env) is True:
                    found += happening(inner, start, end, env)
            case ForEach(variables, inner):
                for chosen in choices(variables, end, env):
                    found += happening(inner, start, end, chosen)
    return found
