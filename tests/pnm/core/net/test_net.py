"""Nets and markings: the engine agrees with the readable firing rule, and both with m' = T·D + m; orders of time of nets."""

from __future__ import annotations

from collections.abc import Iterable
from graphlib import TopologicalSorter

import numpy as np
import pytest
from hypothesis import given, strategies as st

from pnm.core.net.block_net import Engine, block_net
from pnm.core.net.net import Marking, NetBuilder, NetError, PetriNet, TimeOrder, enabled, fire, is_enabled, time_order, topological_order
from pnm.errors import NotEnabled

Firing = tuple[str, int]


@st.composite
def nets(draw: st.DrawFn) -> PetriNet:
    """Up to six places and six transitions, with weights from 1 to 3; self-loops and empty presets included."""
    builder = NetBuilder()
    places = [builder.place(f"p{index}") for index in range(draw(st.integers(1, 6)))]
    weights = st.dictionaries(st.sampled_from(places), st.integers(1, 3), max_size=3)
    for index in range(draw(st.integers(1, 6))):
        builder.transition(f"t{index}", draw(weights), draw(weights))
    return builder.build()


@st.composite
def runs(draw: st.DrawFn) -> tuple[PetriNet, Marking, list[Firing]]:
    """A net, an initial marking, and firings to try, enabled or not."""
    net = draw(nets())
    marking = Marking(draw(st.dictionaries(st.sampled_from(net.places), st.integers(0, 5))))
    return net, marking, draw(st.lists(st.tuples(st.sampled_from(net.transitions), st.integers(1, 3)), max_size=20))


def tokens(net: PetriNet, marking: Marking) -> list[int]:
    return [marking[place] for place in net.places]


def numbered(net: PetriNet, marking: Marking) -> dict[int, int]:
    return {net.place_numbers[place]: count for place, count in marking.items()}


def missing_inputs(net: PetriNet, marking: Marking) -> list[int]:
    """For every transition that takes more than one token, the number of places that hold too little: what the engine keeps up to date."""
    several = [one for one in net.transitions if list(net.inputs[one].values()) != [1]]
    return [sum(marking[place] < weight for place, weight in net.inputs[one].items()) * (one in several) for one in net.transitions]


# --- firing: the engine, the definition and the matrix equation -------------------------------


@given(runs())
def test_engine_definition_and_matrix_equation_agree(run: tuple[PetriNet, Marking, list[Firing]]) -> None:
    net, marking, firings = run
    engine, dense = Engine(block_net(net), numbered(net, marking)), np.array(tokens(net, marking))
    changes = [[net.outputs[one].get(place, 0) - net.inputs[one].get(place, 0) for place in net.places] for one in net.transitions]
    incidence = np.array(changes, dtype=np.int64).reshape(len(net.transitions), len(net.places))
    for transition, times in firings:
        number = net.transitions.index(transition)
        vector = np.zeros(len(net.transitions), dtype=np.int64)
        vector[number] = times
        if is_enabled(net, marking, transition, times):
            marking, dense = fire(net, marking, transition, times), vector @ incidence + dense
            for _ in range(times):
                engine.fire(number)
        else:  # it says what is missing and changes nothing
            short = {place: weight * times - marking[place] for place, weight in net.inputs[transition].items()}
            with pytest.raises(NotEnabled) as refused:
                fire(net, marking, transition, times)
            assert refused.value.missing == {place: count for place, count in short.items() if count > 0}
            assert refused.value.transition == transition
            if times == 1:
                with pytest.raises(NotEnabled) as by_engine:
                    engine.fire(number)
                assert str(by_engine.value) == str(refused.value)
        assert engine.marking() == marking
        assert tokens(net, marking) == dense.tolist() == engine.tokens
        assert (dense >= 0).all()
        assert engine.missing == missing_inputs(net, marking)
        assert enabled(net, marking) == tuple(one for one in net.transitions if engine.is_enabled(net.transitions.index(one)))


def test_a_refusal_names_what_is_missing() -> None:
    with pytest.raises(NotEnabled, match=r"^borrow is not enabled; missing tokens: {'shelf': 1}$"):
        fire(loan().build(), Marking({"shelf": 3, "card": 2}), "borrow", 2)


# --- the structure ----------------------------------------------------------------------------


def loan() -> NetBuilder:
    """Two copies of a book; borrowing takes one, and a card that is only shown."""
    builder = NetBuilder()
    for place in ("shelf", "card", "home"):
        assert builder.place(place) == place
    assert builder.transition("borrow", {"shelf": 2, "card": 1}, {"home": 2, "card": 1}) == "borrow"
    builder.transition("return", ["home"], ["shelf"])
    return builder


@given(nets())
def test_postset_is_the_inverse_of_preset(net: PetriNet) -> None:
    nodes = (*net.places, *net.transitions)
    forth = {(one, other) for one in nodes for other in net.postset(one)}
    assert forth == {(other, one) for one in nodes for other in net.preset(one)}
    assert forth == {(arc.source, arc.target) for arc in net.arcs}


@pytest.mark.parametrize("name", ["shelf", "borrow"])
def test_a_name_is_used_once(name: str) -> None:
    builder = loan()
    with pytest.raises(NetError, match=f"^the name '{name}' is used twice$"):
        builder.place(name)
    with pytest.raises(NetError, match=f"^the name '{name}' is used twice$"):
        builder.transition(name, [], [])


BAD_ARCS = [
    ({"cellar": 1}, "'t' is connected to 'cellar', which is not a place"),
    ({"borrow": 1}, "'t' is connected to 'borrow', which is not a place"),
    ({"home": 0}, "the arc between 't' and 'home' weighs 0; a whole number of at least 1 expected"),
    ({"home": -1}, "the arc between 't' and 'home' weighs -1; a whole number of at least 1 expected"),
    ("home", "expected a list of places to connect 't' to, found 'home'"),
    ({"home": 1.5}, "the arc between 't' and 'home' weighs 1.5; a whole number of at least 1 expected"),
]


@pytest.mark.parametrize(("weights", "message"), BAD_ARCS, ids=[message for _, message in BAD_ARCS])
@pytest.mark.parametrize("side", ["inputs", "outputs"])
def test_a_refused_transition_leaves_the_builder_as_it_was(side: str, weights: dict[str, int], message: str) -> None:
    builder = loan()
    with pytest.raises(NetError) as caught:
        builder.transition("t", **{"inputs": ["shelf"], "outputs": ["shelf"], side: weights})
    assert str(caught.value) == message
    assert builder.build() == loan().build()


# --- markings ---------------------------------------------------------------------------------

COUNTS = st.dictionaries(st.sampled_from("abc"), st.integers(0, 3))


@given(COUNTS, COUNTS)
def test_equal_counts_are_equal_markings(one: dict[str, int], other: dict[str, int]) -> None:
    same = all(one.get(place, 0) == other.get(place, 0) for place in "abc")
    assert (Marking(one) == Marking(other)) is same
    assert not same or hash(Marking(one)) == hash(Marking(other))


def test_places_without_tokens_are_absent_and_hold_none() -> None:
    marking = Marking({"p": 2, "q": 0})
    assert (marking["p"], marking["q"], marking["elsewhere"]) == (2, 0, 0)
    assert (dict(marking), len(marking), "q" in marking) == ({"p": 2}, 1, False)
    assert repr(Marking({"q": 1, "p": 2})) == "Marking(p: 2, q: 1)"


def test_a_marking_is_never_negative() -> None:
    with pytest.raises(ValueError, match=r"^a marking cannot be negative: {'p': -1}$"):
        Marking({"p": -1})


@pytest.mark.parametrize("twice", [["p", "q", "p"], ("p", "q", "p"), iter("pqp")])
def test_a_place_that_is_named_twice_has_two_arcs(twice: Iterable[str]) -> None:
    builder = NetBuilder()
    p, q = builder.place("p"), builder.place("q")
    builder.transition("t", twice, [p, q])
    net = builder.build()
    assert (net.inputs["t"], net.outputs["t"]) == ({"p": 2, "q": 1}, {"p": 1, "q": 1})


# --- orders of time: tokens go forward, but for the arcs that are said to lead back ---


def net_of(*arcs: str) -> PetriNet:
    """A net of places by letters: ``"a>b c"`` is a transition from a to b and c."""
    builder = NetBuilder()
    for place in sorted({letter for arc in arcs for letter in arc if letter.isalpha()}):
        builder.place(place)
    for arc in arcs:
        inputs, _, outputs = arc.partition(">")
        builder.transition(arc, inputs.split(), outputs.split())
    return builder.build()


def order(*arcs: str, aside: str = "") -> TimeOrder:
    return time_order(net_of(*arcs), "a", aside)


def test_the_arc_that_closes_a_cycle_leads_back() -> None:
    assert order("a>b", "b>c", "c>b", "c>d").back == {("c>b", "b")}


def test_counters_order_nothing_and_come_last() -> None:
    found = order("a>c", "c b>a b", "c>d", aside="b")
    assert [*found.when] == ["a", "c", "d", "b"]
    assert found.back == {("c b>a b", "a")}


LETTERS = st.sampled_from("abcdef")
NETS = st.lists(
    st.builds(lambda before, after: f"{before}>{' '.join(sorted(after))}", LETTERS, st.frozensets(LETTERS, min_size=1)), unique=True
)


@given(NETS)
def test_every_place_has_one_position_and_what_is_reached_goes_forward(arcs: list[str]) -> None:
    net = net_of("a>b", *(arc for arc in arcs if arc != "a>b"))
    found = time_order(net, "a", ())
    assert sorted(found.when) == sorted(net.places)
    assert sorted(found.when.values()) == [*range(len(net.places))]
    reached = {"a"}
    while more := {after for place in reached for name in net.postset(place) for after in net.outputs[name]} - reached:
        reached |= more
    for name in net.transitions:
        for before in net.inputs[name]:
            for after in net.outputs[name]:
                if before in reached and (name, after) not in found.back:
                    assert found.when[before] < found.when[after]


# --- topological orders: that of graphlib, or always the least of those that may be next ---


pairs = st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9)), max_size=20)


def preceding_of(drawn: list[tuple[int, int]]) -> list[list[int]]:
    """Ten numbers in any order of their own, each preceded by some that come before it there."""
    found: list[list[int]] = [[] for _ in range(10)]
    for one, other in drawn:
        if one != other:
            found[max(one, other) * 7 % 10].append(min(one, other) * 7 % 10)
    return found


@given(pairs)
def test_without_ranks_it_is_the_order_of_graphlib(drawn: list[tuple[int, int]]) -> None:
    preceding = [[*dict.fromkeys(one)] for one in preceding_of(drawn)]
    assert topological_order(preceding) == [*TopologicalSorter(dict(enumerate(preceding))).static_order()]


@given(pairs, st.lists(st.integers(0, 3), min_size=10, max_size=10))
def test_with_ranks_the_least_of_those_that_may_be_next_comes_first(drawn: list[tuple[int, int]], ranks: list[int]) -> None:
    preceding, left = preceding_of(drawn), set(range(10))
    for found in topological_order(preceding, ranks.__getitem__):
        assert found == min((one for one in left if left.isdisjoint(preceding[one])), key=lambda one: (ranks[one], one))
        left.remove(found)
    assert not left


def test_what_precedes_itself_is_left_out_with_all_that_comes_after_it() -> None:
    assert topological_order([[], [2], [1, 0], [2], [0]]) == [0, 4]
