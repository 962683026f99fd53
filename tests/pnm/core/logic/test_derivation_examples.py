"""Derived facts by example: chains, ways through graphs, and why a fact is as it is."""

from __future__ import annotations

import random
from collections.abc import Iterable

import pytest
from hypothesis import given, strategies as st

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import All, Any, Compare, Exists, ForAll, Holds, Not
from pnm.core.logic.expressions import UNKNOWN, Constant, ValueOf, Variable
from pnm.core.logic.rules import DerivationRule, Rules
from tests.support.logic.rules import Facts, least

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


@pytest.mark.parametrize("rule", [ON, BACK])
def test_the_end_of_a_long_chain_is_reached_and_again_after_every_change(rule: DerivationRule) -> None:
    knowledge = graph(chain_edges(300), rule)
    for index in range(100, 110):
        assert knowledge.value(("reach", "n0", "n299")) is True
        knowledge.update({("edge", f"n{index}", f"n{index + 1}"): False})
        assert knowledge.value(("reach", "n0", "n299")) is False
        knowledge.update({("edge", f"n{index}", f"n{index + 1}"): True})


NODES = tuple(f"n{index}" for index in range(6))
DOUBLED = DerivationRule("reach", (X, Y), Any((EDGE, Exists((Z,), All((Holds(("reach", "?x", "?z")), Holds(("reach", "?z", "?y"))))))))
AGAIN = DerivationRule("again", (X, Y), All((REACH, Holds(("reach", "?y", "?x")))))
APART = DerivationRule("apart", (X,), ForAll((Y,), Any((Not(Holds(("again", "?x", "?y"))), Holds(("apart", "?y"))))))
EDGES = st.dictionaries(
    st.tuples(st.just("edge"), st.sampled_from(NODES), st.sampled_from(NODES)), st.sampled_from((True, True, UNKNOWN)), max_size=10
)


@given(st.sampled_from((ON, BACK, DOUBLED)), EDGES, st.randoms(use_true_random=False))
def test_ways_through_any_graph(rule: DerivationRule, edges: Facts, chooser: random.Random) -> None:
    rules = (rule, AGAIN, APART)
    knowledge = KnowledgeBase(edges, objects={"node": NODES}, rules=Rules(rules))
    expected = least(rules, ({"reach"}, {"again"}, {"apart"}), edges, {"node": NODES})
    for fact in chooser.sample(sorted(expected), len(expected)):
        assert knowledge.value(fact) is expected[fact], fact


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
