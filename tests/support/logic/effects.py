"""Effects, and strategies for them and for the states they change."""

from __future__ import annotations

from hypothesis import strategies as st

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import TRUE, Condition, Holds, Not, evaluate
from pnm.core.logic.effects import OPERATIONS, Alternative, Effect, Effects, ForEach, OneOf, Set, When, changes, ground_effects
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
CHANCES = st.sampled_from(((), (0.25, 0.75), (0.5, 0.5, 0.0), (1.0,)))


def one_of(chances: tuple[float, ...], parts: list[Effects], names: list[str]) -> OneOf:
    """As many alternatives as there are chances, or parts if there are none; the first ones have names."""
    several: list[float | None] = [*chances] or [None] * len(parts)
    named = [*names, *[""] * len(several)]
    return OneOf(tuple(Alternative(parts[number % len(parts)], chance, named[number]) for number, chance in enumerate(several)))


def outcomes_of(inner: st.SearchStrategy[Effect], names: st.SearchStrategy[list[str]] = st.just([])) -> st.SearchStrategy[Effect]:
    """Effects that may turn out in several ways."""
    parts = st.lists(st.lists(inner, max_size=2).map(tuple), min_size=1, max_size=3)
    return st.builds(one_of, CHANCES, parts, names)


UNCERTAIN = st.recursive(
    SETS,
    lambda inner: st.one_of(
        outcomes_of(inner),
        st.builds(When, CONDITIONS, st.lists(inner, max_size=2).map(tuple)),
        st.builds(ForEach, st.just((Variable("?x"),)), st.lists(inner, max_size=2).map(tuple)),
    ),
    max_leaves=4,
)


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


def turned_out(effects: Effects, state: KnowledgeBase, env: Environment) -> dict[Effects, float]:
    """The oracle of outcomes: every way of choosing among the alternatives of what happens in the state, and how likely it is."""
    found: dict[Effects, float] = {(): 1.0}
    for effect in effects:
        ways: dict[Effects, float] = {}
        match effect:
            case Set():
                ways = {ground_effects((effect,), env): 1.0}
            case When(condition, inner):
                ways = turned_out(inner, state, env) if evaluate(condition, state, env) is True else {(): 1.0}
            case ForEach(variables, inner):
                ways = turned_out(
                    tuple(one for chosen in choices(variables, state, env) for one in ground_effects(inner, chosen)), state, env
                )
            case OneOf(alternatives):
                for way in alternatives:
                    for sets, chance in turned_out(way.effects, state, env).items():
                        likely = chance * (1.0 / len(alternatives) if way.chance is None else way.chance)
                        ways[sets] = ways.get(sets, 0.0) + likely
        both: dict[Effects, float] = {}
        for before, likely in found.items():
            for after, chance in ways.items():
                both[*before, *after] = both.get((*before, *after), 0.0) + likely * chance
        found = both
    return found


def results(ways: dict[Effects, float], state: KnowledgeBase) -> dict[str, float]:
    """What the state can become, in words, and how likely each is."""
    found: dict[str, float] = {}
    for effects, chance in ways.items():
        after = {fluent: state.value(fluent) for fluent in (*ALL_FACTS, *ALL_NUMBERS)} | changes(effects, state)
        found[str(after)] = found.get(str(after), 0.0) + chance
    return {result: chance for result, chance in found.items() if chance}


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
