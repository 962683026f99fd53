"""Derived facts: what rules say, found quickly, is what applying them again and again comes to."""

from __future__ import annotations

import random
from collections.abc import Iterable, Mapping, Set
from dataclasses import dataclass, replace
from itertools import product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import All, Any, Compare, Condition, Exists, ForAll, Holds, Implies, Not, free_variables, ground
from pnm.core.logic.evaluation import evaluate
from pnm.core.logic.expressions import UNKNOWN, Constant, Environment, Fluent, State, Truth, Unknown, Value, ValueOf, Variable
from pnm.core.logic.rules import NO_RULES, DerivationRule, Rules, UnstratifiedError

Facts = dict[Fluent, Value | Unknown]

OBJECTS = {"object": ("a", "b", "c"), "room": ("b", "c")}
RANK: dict[Truth, int] = {False: 0, UNKNOWN: 1, True: 2}


# --- the oracle: apply all rules to all objects until nothing changes ---------------------------


@dataclass
class Picture:
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
    picture = Picture(facts, {}, things)
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


# --- random rules -------------------------------------------------------------------------------

ARITY = {"p": 0, "q": 1, "e": 2, "d": 1, "f": 2, "g": 1, "h": 0}
BASE, LOWER, UPPER = ("p", "q", "e"), ("d", "f"), ("g", "h")
STRATA = ({*LOWER}, {*UPPER})
TYPES = st.sampled_from((("object",), ("room",)))


@st.composite
def conditions(draw: st.DrawFn, scope: tuple[str, ...], plain: tuple[str, ...], negated: tuple[str, ...], depth: int) -> Condition:
    """A condition whose facts are of the names in `plain`, and under a negation of those in `negated`."""
    terms = st.sampled_from((*scope, "a", "b"))
    kind = draw(st.sampled_from(("holds", "holds", "compare", "not", "all", "any", "imply", "forall", "exists"))) if depth else "holds"
    if kind == "holds":
        name = draw(st.sampled_from(plain))
        return Holds((name, *(draw(terms) for _ in range(ARITY[name]))))
    if kind == "compare":
        if draw(st.booleans()):
            return Compare("=", Constant(draw(terms)), Constant(draw(terms)))
        return Compare(draw(st.sampled_from(("<", "="))), ValueOf(("n", draw(terms))), Constant(1.0))
    if kind == "not":
        return Not(draw(conditions(scope, negated, plain, depth - 1)))
    if kind == "imply":
        return Implies(draw(conditions(scope, negated, plain, depth - 1)), draw(conditions(scope, plain, negated, depth - 1)))
    if kind in ("all", "any"):
        several = tuple(draw(conditions(scope, plain, negated, depth - 1)) for _ in range(draw(st.integers(0, 3))))
        return All(several) if kind == "all" else Any(several)
    own = tuple(
        Variable(name, draw(TYPES)) for name in draw(st.lists(st.sampled_from(("?x", "?y", "?z")), min_size=1, max_size=2, unique=True))
    )
    body = draw(conditions((*dict.fromkeys((*scope, *(one.name for one in own))),), plain, negated, depth - 1))
    return ForAll(own, body) if kind == "forall" else Exists(own, body)


@st.composite
def rules_of(draw: st.DrawFn, name: str, plain: tuple[str, ...], negated: tuple[str, ...]) -> DerivationRule:
    variables = tuple(Variable(one, draw(TYPES)) for one in ("?x", "?y")[: ARITY[name]])
    return DerivationRule(name, variables, draw(conditions(tuple(one.name for one in variables), plain, negated, 3)))


@st.composite
def programs(draw: st.DrawFn) -> tuple[DerivationRule, ...]:
    """Rules in two strata: recursion within each, negation only of what is below."""
    lower = [draw(rules_of(name, (*BASE, *LOWER), BASE)) for name in draw(st.lists(st.sampled_from(LOWER), max_size=4))]
    upper = [draw(rules_of(name, (*BASE, *LOWER, *UPPER), (*BASE, *LOWER))) for name in draw(st.lists(st.sampled_from(UPPER), max_size=3))]
    return tuple(draw(st.permutations([*lower, *upper])))


ALL_FACTS = [(name, *chosen) for name in BASE for chosen in product(OBJECTS["object"], repeat=ARITY[name])]
ALL_NUMBERS = [("n", one) for one in OBJECTS["object"]]
FACTS: st.SearchStrategy[Facts] = st.builds(
    lambda facts, numbers: {**facts, **numbers},
    st.fixed_dictionaries({}, optional=dict.fromkeys(ALL_FACTS, st.sampled_from((True, True, False, UNKNOWN)))),
    st.fixed_dictionaries({}, optional=dict.fromkeys(ALL_NUMBERS, st.sampled_from((0.0, 1.0, UNKNOWN)))),
)


def known(rules: tuple[DerivationRule, ...], facts: Facts) -> KnowledgeBase:
    return KnowledgeBase(facts, objects=OBJECTS, rules=Rules(rules))


# --- laws ---------------------------------------------------------------------------------------


@settings(max_examples=120, deadline=None)
@given(programs(), FACTS, st.lists(FACTS, max_size=2), st.randoms(use_true_random=False))
def test_what_is_derived_is_the_least_fixpoint_whatever_was_asked_before(
    rules: tuple[DerivationRule, ...], facts: Facts, later: list[Facts], chooser: random.Random
) -> None:
    knowledge = known(rules, facts)
    now = dict(facts)
    for changes in ({}, *later):
        knowledge.update(changes)
        now.update(changes)
        expected = least(rules, STRATA, now)
        for fact in chooser.sample(sorted(expected), len(expected) // chooser.choice((1, 2))):
            assert knowledge.value(fact) is expected[fact], fact


@settings(max_examples=80, deadline=None)
@given(programs(), FACTS, st.data())
def test_a_derived_fact_rests_on_all_that_can_make_a_difference(
    rules: tuple[DerivationRule, ...], facts: Facts, data: st.DataObject
) -> None:
    knowledge = known(rules, facts)
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
    truth = known(rules, one).value(fact)
    assert known(rules, other).value(fact) is truth
    assert knowledge.value(fact) in (UNKNOWN, truth)
    later = data.draw(FACTS)
    knowledge.update(later)
    assert knowledge.rests_on(frozenset({fact})) == known(rules, {**facts, **later}).rests_on(frozenset({fact}))


@settings(max_examples=80, deadline=None)
@given(programs(), FACTS, st.data())
def test_only_the_base_names_below_matter(rules: tuple[DerivationRule, ...], facts: Facts, data: st.DataObject) -> None:
    knowledge = known(rules, facts)
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


@settings(max_examples=100, deadline=None)
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


@settings(max_examples=100, deadline=None)
@given(conditions(("?x", "?y"), BASE, BASE, 3), st.sampled_from(("?x", "?y", "?z")))
def test_a_variable_is_free_if_an_object_can_take_its_place(condition: Condition, name: str) -> None:
    assert (name in free_variables(condition)) is (ground(condition, {name: "c"}) != condition)


# --- examples -----------------------------------------------------------------------------------

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


def chain(length: int) -> list[tuple[str, str]]:
    return [(f"n{index}", f"n{index + 1}") for index in range(length - 1)]


@pytest.mark.parametrize("rule", [ON, BACK])
def test_the_end_of_a_long_chain_is_reached_and_again_after_every_change(rule: DerivationRule) -> None:
    knowledge = graph(chain(300), rule)
    for index in range(100, 110):
        assert knowledge.value(("reach", "n0", "n299")) is True
        knowledge.update({("edge", f"n{index}", f"n{index + 1}"): False})
        assert knowledge.value(("reach", "n0", "n299")) is False
        knowledge.update({("edge", f"n{index}", f"n{index + 1}"): True})


def test_a_circle_supports_nothing_by_itself() -> None:
    knowledge = graph([("a", "b"), ("b", "a"), ("c", "d")], ON)
    assert knowledge.value(("reach", "a", "a")) is True
    assert knowledge.value(("reach", "a", "d")) is False
    hen, egg = DerivationRule("hen", (), Holds(("egg",))), DerivationRule("egg", (), Holds(("hen",)))
    assert KnowledgeBase(rules=Rules((hen, egg))).value(("hen",)) is False


def test_an_unknown_door_makes_what_is_behind_it_unknown_unless_there_is_another_way() -> None:
    knowledge = graph([("a", "b"), ("b", "c"), ("a", "d")], ON)
    knowledge.update({("edge", "b", "c"): UNKNOWN})
    assert knowledge.value(("reach", "a", "c")) is UNKNOWN
    assert knowledge.rests_on(frozenset({("reach", "a", "c"), ("at", "r1")})) == {("edge", "b", "c"), ("at", "r1")}
    knowledge.update({("edge", "d", "c"): True})
    assert knowledge.value(("reach", "a", "c")) is True
    assert knowledge.rests_on(frozenset({("reach", "a", "c")})) == frozenset()


NODES = tuple(f"n{index}" for index in range(6))
DOUBLED = DerivationRule("reach", (X, Y), Any((EDGE, Exists((Z,), All((Holds(("reach", "?x", "?z")), Holds(("reach", "?z", "?y"))))))))
AGAIN = DerivationRule("again", (X, Y), All((REACH, Holds(("reach", "?y", "?x")))))
APART = DerivationRule("apart", (X,), ForAll((Y,), Any((Not(Holds(("again", "?x", "?y"))), Holds(("apart", "?y"))))))
EDGES = st.dictionaries(
    st.tuples(st.just("edge"), st.sampled_from(NODES), st.sampled_from(NODES)), st.sampled_from((True, True, UNKNOWN)), max_size=10
)


@settings(max_examples=60, deadline=None)
@given(st.sampled_from((ON, BACK, DOUBLED)), EDGES, st.randoms(use_true_random=False))
def test_ways_through_any_graph(rule: DerivationRule, edges: Facts, chooser: random.Random) -> None:
    rules = (rule, AGAIN, APART)
    knowledge = KnowledgeBase(edges, objects={"node": NODES}, rules=Rules(rules))
    expected = least(rules, ({"reach"}, {"again"}, {"apart"}), edges, {"node": NODES})
    for fact in chooser.sample(sorted(expected), len(expected)):
        assert knowledge.value(fact) is expected[fact], fact


def test_nothing_that_is_negated_is_asked_before_it_is_settled() -> None:
    settled = DerivationRule("settled", (), Exists((X,), Holds(("reach", "?x", "?x"))))
    first, second = (
        DerivationRule("first", (), Any((Not(Holds(("settled",))), Holds(("second",))))),
        DerivationRule("second", (), Holds(("first",))),
    )
    for asked in ("first", "second"):
        assert graph([("a", "b"), ("b", "a")], ON, settled, first, second).value((asked,)) is False
        assert graph([("a", "b")], ON, settled, first, second).value((asked,)) is True


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


def test_variables_of_the_same_name_are_kept_apart() -> None:
    twice = All((Exists((Y,), Holds(("edge", "?x", "?y"))), Exists((Y,), Holds(("edge", "?y", "?x")))))
    knowledge = graph([("a", "b"), ("b", "c")], DerivationRule("between", (X,), twice))
    assert [knowledge.value(("between", name)) for name in "abc"] == [False, True, False]
    loop = graph([("a", "b"), ("b", "b")], DerivationRule("loops", (), Exists((X,), Holds(("edge", "?x", "?x")))))
    assert loop.value(("loops",)) is True
    assert loop.because(("loops",)) == "because of (edge b b)"
    loop.update({("edge", "b", "b"): False})
    assert loop.value(("loops",)) is False


def test_why_a_derived_fact_is_as_it_is() -> None:
    knowledge = graph(chain(5), ON, BLOCKED, FREE)
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
    knowledge = graph(chain(12), ON)
    assert knowledge.because(("reach", "n0", "n9")).endswith("(edge n3 n4) and 5 more")


def test_rules_and_what_is_below_them() -> None:
    rules = Rules((ON, BLOCKED, FREE))
    assert rules.strata == {"reach": 0, "blocked": 0, "free": 1}
    assert rules.base(("free", "reach", "battery")) == {"at", "ghost", "width", "edge", "battery"}
    assert rules.above["at"] == {"blocked", "free"}
    assert NO_RULES.base(("p",)) == {"p"}
    assert Rules((ON,)) == Rules((replace(ON),)) != NO_RULES
