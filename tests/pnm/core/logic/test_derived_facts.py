"""Derived facts: what rules derive, found quickly, is what applying them again and again comes to."""

from __future__ import annotations

import random
from collections.abc import Iterable
from itertools import product

import pytest
from hypothesis import given, strategies as st

from pnm.core.logic.conditions import All, Any, Condition, Exists, ForAll, Holds, Implies, Not, free_variables, ground
from pnm.core.logic.expressions import UNKNOWN, Fluent, Variable
from pnm.core.logic.rules import DerivationRule, Rules, UnstratifiedError
from tests.support.logic.rules import ARITY, BASE, FACTS, TYPES, Facts, known, least, stratified_conditions

LOWER, UPPER = ("d", "f"), ("g", "h")
STRATA = ({*LOWER}, {*UPPER})


@st.composite
def rules_of(draw: st.DrawFn, name: str, plain: tuple[str, ...], negated: tuple[str, ...]) -> DerivationRule:
    variables = tuple(Variable(one, draw(TYPES)) for one in ("?x", "?y")[: ARITY[name]])
    return DerivationRule(name, variables, draw(stratified_conditions(tuple(one.name for one in variables), plain, negated, 3)))


@st.composite
def rule_sets(draw: st.DrawFn) -> tuple[DerivationRule, ...]:
    """Rules in two strata: recursion within each, negation only of what is below."""
    lower = [draw(rules_of(name, (*BASE, *LOWER), BASE)) for name in draw(st.lists(st.sampled_from(LOWER), max_size=4))]
    upper = [draw(rules_of(name, (*BASE, *LOWER, *UPPER), (*BASE, *LOWER))) for name in draw(st.lists(st.sampled_from(UPPER), max_size=3))]
    return tuple(draw(st.permutations([*lower, *upper])))


@given(rule_sets(), FACTS, st.lists(FACTS, max_size=2), st.randoms(use_true_random=False))
def test_what_is_derived_is_the_least_fixpoint_whatever_was_asked_before(
    rules: tuple[DerivationRule, ...], facts: Facts, later: list[Facts], chooser: random.Random
) -> None:
    knowledge = known(facts, Rules(rules))
    now = dict(facts)
    for changes in ({}, *later):
        knowledge.update(changes)
        now.update(changes)
        expected = least(rules, STRATA, now)
        for fact in chooser.sample(sorted(expected), len(expected) // chooser.choice((1, 2))):
            assert knowledge.value(fact) is expected[fact], fact


@given(rule_sets(), FACTS, st.data())
def test_a_derived_fact_rests_on_all_that_can_make_a_difference(
    rules: tuple[DerivationRule, ...], facts: Facts, data: st.DataObject
) -> None:
    knowledge = known(facts, Rules(rules))
    derived = sorted(least(rules, STRATA, facts))
    if not derived:
        return
    fact = data.draw(st.sampled_from(derived))
    unknown = sorted(fluent for fluent, value in facts.items() if value is UNKNOWN)
    rests = knowledge.rests_on(frozenset({fact}))
    assert rests <= set(unknown)
    assert {fluent[0] for fluent in rests} <= knowledge.rules.base({fact[0]})

    def cleared(fluents: Iterable[Fluent]) -> Facts:
        return {one: data.draw(st.sampled_from((0.0, 1.0)) if one[0] == "n" else st.booleans()) for one in fluents}

    one = {**facts, **cleared(unknown)}
    other = {**one, **cleared(fluent for fluent in unknown if fluent not in rests)}
    truth = known(one, Rules(rules)).value(fact)
    assert known(other, Rules(rules)).value(fact) is truth
    assert knowledge.value(fact) in (UNKNOWN, truth)
    later = data.draw(FACTS)
    knowledge.update(later)
    assert knowledge.rests_on(frozenset({fact})) == known({**facts, **later}, Rules(rules)).rests_on(frozenset({fact}))


@given(rule_sets(), FACTS, st.data())
def test_only_the_base_names_below_matter(rules: tuple[DerivationRule, ...], facts: Facts, data: st.DataObject) -> None:
    knowledge = known(facts, Rules(rules))
    derived = least(rules, STRATA, facts)
    names = knowledge.rules.base(data.draw(st.sets(st.sampled_from(sorted({fact[0] for fact in derived} | {"p"})))))
    knowledge.update({fluent: value for fluent, value in data.draw(FACTS).items() if fluent[0] not in names})
    for fact, truth in derived.items():
        if knowledge.rules.base({fact[0]}) <= names:
            assert knowledge.value(fact) is truth


NAMES = ("d", "g", "h")


@st.composite
def any_rules(draw: st.DrawFn) -> tuple[DerivationRule, ...]:
    """Rules that may negate anything."""
    mentions = (*BASE, *NAMES)
    return tuple(draw(st.lists(st.sampled_from(NAMES).flatmap(lambda name: rules_of(name, mentions, mentions)), max_size=4)))


def mentions(condition: Condition, sign: bool = True) -> set[tuple[str, bool]]:
    match condition:
        case Holds(fluent):
            return {(fluent[0], sign)}
        case Not(operand):
            return mentions(operand, not sign)
        case Implies(left, right):
            return mentions(left, not sign) | mentions(right, sign)
        case All(operands) | Any(operands):
            return set().union(*(mentions(one, sign) for one in operands))
        case ForAll(_, body) | Exists(_, body):
            return mentions(body, sign)
        case _:
            return set()


@given(any_rules())
def test_rules_are_refused_unless_they_fall_into_strata(rules: tuple[DerivationRule, ...]) -> None:
    demands = [(rule.name, *one) for rule in rules for one in mentions(rule.condition) if one[0] in {rule.name for rule in rules}]
    levels = [dict(zip(NAMES, chosen, strict=True)) for chosen in product(range(len(NAMES)), repeat=len(NAMES))]
    fit = [level for level in levels if all(level[name] >= level[below] + (not sign) for name, below, sign in demands)]
    if not fit:
        with pytest.raises(UnstratifiedError, match="would depend on its own negation"):
            Rules(rules)
    else:
        assert Rules(rules).strata in [{name: level[name] for name in Rules(rules).derived} for level in fit]


@given(stratified_conditions(("?x", "?y"), BASE, BASE, 3), st.sampled_from(("?x", "?y", "?z")))
def test_a_variable_is_free_if_an_object_can_take_its_place(condition: Condition, name: str) -> None:
    assert (name in free_variables(condition)) is (ground(condition, {name: "c"}) != condition)
