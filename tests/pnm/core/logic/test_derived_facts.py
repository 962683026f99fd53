"""Derived facts: what rules derive, found quickly, is what applying them again and again comes to; ways through graphs, and reasons."""

from __future__ import annotations

import random
from collections.abc import Iterable
from itertools import product

import pytest
from hypothesis import given, strategies as st

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic import derived_facts
from pnm.core.logic.conditions import All, Any, Compare, Condition, Exists, ForAll, Holds, Implies, Not, free_variables, ground
from pnm.core.logic.expressions import UNKNOWN, Constant, Fluent, ValueOf, Variable
from pnm.core.logic.rules import DerivationRule, Rules, UnstratifiedError
from tests.support.logic.rules import ARITY, BASE, FACTS, TYPES, Facts, known, least, stratified_conditions
from tests.support.runs.timing import functions_called

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


@given(rule_sets(), FACTS, st.lists(FACTS, max_size=4), st.randoms(use_true_random=False))
def test_what_is_derived_is_the_least_fixpoint_whatever_was_asked_and_changed_before(
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


# --- by example: chains, ways through graphs, and why a fact is as it is ---


X, Y, Z = (Variable(name, ("node",)) for name in ("?x", "?y", "?z"))
EDGE, REACH = Holds(("edge", "?x", "?y")), Holds(("reach", "?x", "?y"))
ON = DerivationRule("reach", (X, Y), Any((EDGE, Exists((Z,), All((Holds(("edge", "?x", "?z")), Holds(("reach", "?z", "?y"))))))))
BACK = DerivationRule("reach", (X, Y), Any((EDGE, Exists((Z,), All((Holds(("reach", "?x", "?z")), Holds(("edge", "?z", "?y"))))))))
BLOCKED = DerivationRule("blocked", (X,), Exists((Y,), All((Holds(("at", "?y", "?x")), Not(Holds(("ghost", "?y")))))))
FREE = DerivationRule("free", (X,), All((Not(Holds(("blocked", "?x"))), Compare(">", ValueOf(("width", "?x")), Constant(2.0)))))


def graph(edges: Iterable[tuple[str, str]], *rules: DerivationRule, nodes: int = 0) -> KnowledgeBase:
    pairs = list(edges)
    names = tuple(dict.fromkeys((*(name for pair in pairs for name in pair), *(f"n{index}" for index in range(nodes)))))
    return KnowledgeBase({("edge", *pair): True for pair in pairs}, objects={"node": names}, rules=Rules(rules))


def chain_edges(length: int) -> list[tuple[str, str]]:
    return [(f"n{index}", f"n{index + 1}") for index in range(length - 1)]


@pytest.mark.parametrize("kept", [derived_facts.KEPT, 0])
@pytest.mark.parametrize("rule", [ON, BACK])
def test_the_end_of_a_long_chain_is_reached_and_again_after_every_change(
    rule: DerivationRule, kept: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(derived_facts, "KEPT", kept)
    knowledge = graph(chain_edges(300), rule)
    for index in range(100, 110):
        assert knowledge.value(("reach", "n0", "n299")) is True
        knowledge.update({("edge", f"n{index}", f"n{index + 1}"): False})
        assert knowledge.value(("reach", "n0", "n299")) is False
        knowledge.update({("edge", f"n{index}", f"n{index + 1}"): True})


@pytest.mark.parametrize("rule", [ON, BACK])
@pytest.mark.parametrize("is_from_one", [True, False])
def test_ways_from_one_to_all_cost_what_there_is_on_them_and_after_a_change_what_that_concerns(
    rule: DerivationRule, is_from_one: bool
) -> None:
    first, again = dict[int, int](), dict[int, int]()
    for length in (20, 80):
        knowledge = graph(chain_edges(length), rule)
        ways = [("reach", "n0", f"n{index}") if is_from_one else ("reach", f"n{index}", f"n{length - 1}") for index in range(1, length - 1)]
        with functions_called() as called:
            assert all(map(knowledge.value, ways))
        first[length] = called()
        for is_open in (False, True):
            knowledge.update({("edge", "n0", "n1") if not is_from_one else ("edge", f"n{length - 2}", f"n{length - 1}"): is_open})
            with functions_called() as called:
                knowledge.value(ways[0])
            again[length] = max(again.get(length, 0), called())
    assert first[80] < 5 * first[20]
    assert again[80] < 2 * again[20]


NODES = tuple(f"n{index}" for index in range(6))
DOUBLED = DerivationRule("reach", (X, Y), Any((EDGE, Exists((Z,), All((Holds(("reach", "?x", "?z")), Holds(("reach", "?z", "?y"))))))))
BACK_AND_FORTH = DerivationRule("reach", (X, Y), Any((ON.condition, BACK.condition)))
ONE_WAY = DerivationRule(
    "reach",
    (X, Y),
    Any((EDGE, Exists((Z,), All((Holds(("edge", "?x", "?z")), Not(Holds(("edge", "?z", "?x"))), Holds(("reach", "?z", "?y"))))))),
)
AGAIN = DerivationRule("again", (X, Y), All((REACH, Holds(("reach", "?y", "?x")))))
APART = DerivationRule("apart", (X,), ForAll((Y,), Any((Not(Holds(("again", "?x", "?y"))), Holds(("apart", "?y"))))))
EDGES = st.dictionaries(
    st.tuples(st.just("edge"), st.sampled_from(NODES), st.sampled_from(NODES)), st.sampled_from((True, True, UNKNOWN)), max_size=10
)


CHANGES = st.lists(
    st.dictionaries(
        st.sampled_from([("edge", *pair) for pair in product(NODES, repeat=2)]), st.sampled_from((True, False, UNKNOWN)), max_size=3
    ),
    max_size=4,
)


@given(st.sampled_from((ON, BACK, DOUBLED, BACK_AND_FORTH, ONE_WAY)), EDGES, CHANGES, st.randoms(use_true_random=False))
def test_ways_through_any_graph_that_changes(rule: DerivationRule, edges: Facts, later: list[Facts], chooser: random.Random) -> None:
    rules = (rule, AGAIN, APART)
    knowledge = KnowledgeBase(edges, objects={"node": NODES}, rules=Rules(rules))
    for changes in ({}, *later):
        knowledge.update(changes)
        edges = {**edges, **changes}
        expected = least(rules, ({"reach"}, {"again"}, {"apart"}), edges, {"node": NODES})
        for fact in chooser.sample(sorted(expected), len(expected) // chooser.choice((1, 1, 4))):
            assert knowledge.value(fact) is expected[fact], fact
            assert (knowledge.because(fact) == "") is (expected[fact] is UNKNOWN and not knowledge.rests_on(frozenset({fact})))


def test_what_is_decided_otherwise_is_not_rested_on() -> None:
    either = DerivationRule("either", (), All((Any((Holds(("p",)), Holds(("q",)))), Holds(("r",)))))
    knowledge = KnowledgeBase({("p",): True, ("q",): UNKNOWN, ("r",): UNKNOWN}, rules=Rules((either,)))
    assert knowledge.rests_on(frozenset({("either",)})) == {("r",)}


def test_rules_are_about_objects_of_their_types_and_as_many_as_they_name() -> None:
    knowledge = graph([("a", "b")], ON, BLOCKED)
    knowledge.update({("edge", "a", "stranger"): True, ("edge", "stranger", "b"): True, ("edge", "a"): True})
    knowledge.update({("at", "stranger", "b"): True})
    assert knowledge.value(("blocked", "b")) is False
    assert knowledge.value(("reach", "a", "b")) is True
    for fact in (("reach", "a", "stranger"), ("reach", "stranger", "b"), ("reach", "a"), ("reach", "a", "b", "c")):
        assert knowledge.value(fact) is False


def test_why_a_derived_fact_is_as_it_is() -> None:
    knowledge = graph(chain_edges(5), ON, BLOCKED, FREE)
    assert knowledge.because(("reach", "n0", "n2")) == "because of (edge n0 n1), (edge n1 n2)"
    assert knowledge.because(("edge", "n0", "n1")) == ""
    knowledge.update({("edge", "n2", "n3"): False})
    reason = "for want of (edge n2 ?z), (edge n2 n4), (edge n1 n4), (edge n0 n4)"
    assert knowledge.because(("reach", "n0", "n4")) == reason
    knowledge.update({("edge", "n2", "n3"): UNKNOWN})
    assert knowledge.because(("reach", "n0", "n4")) == "because of (edge n2 n3)"
    knowledge.update({("at", "n1", "n0"): True})
    assert knowledge.because(("blocked", "n0")) == "because of (at n1 n0), (not (ghost n1))"
    assert knowledge.because(("free", "n0")) == "for want of (not (blocked n0))"
    assert knowledge.because(("blocked", "n1")) == "for want of (at ?y n1)"


def test_of_many_reasons_some_are_named_and_the_others_counted() -> None:
    knowledge = graph(chain_edges(12), ON)
    assert knowledge.because(("reach", "n0", "n9")).endswith("(edge n3 n4) and 5 more")
