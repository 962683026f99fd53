"""Nets and markings: the engine agrees with the readable firing rule, and both with m' = T·D + m."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import FrozenInstanceError, fields

import numpy as np
import pytest
from hypothesis import given, strategies as st

from pnm.core.net.block_net import Engine, block_net
from pnm.core.net.net import Arc, Marking, NetBuilder, NetError, PetriNet, enabled, fire, is_enabled
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
    blocks = block_net(net)
    engine, dense = Engine(blocks, numbered(net, marking)), np.array(tokens(net, marking))
    incidence = np.array(net.incidence(), dtype=np.int64).reshape(len(net.transitions), len(net.places))
    for transition, times in firings:
        number = net.transitions.index(transition)
        if is_enabled(net, marking, transition, times):
            vector = np.zeros(len(net.transitions), dtype=np.int64)
            vector[number] = times
            marking, dense = fire(net, marking, transition, times), vector @ incidence + dense
            engine.fire(number, times)
        assert engine.marking() == marking
        assert tokens(net, marking) == dense.tolist() == engine.tokens
        assert (dense >= 0).all()
        assert engine.missing == missing_inputs(net, marking)
        assert enabled(net, marking) == tuple(one for one in net.transitions if engine.is_enabled(net.transitions.index(one)))


@given(runs())
def test_a_refused_firing_says_what_is_missing_and_changes_nothing(run: tuple[PetriNet, Marking, list[Firing]]) -> None:
    net, marking, firings = run
    blocks = block_net(net)
    engine = Engine(blocks, numbered(net, marking))
    before = dict(marking), list(engine.tokens), list(engine.missing)
    for transition, times in firings:
        if is_enabled(net, marking, transition, times):
            continue
        lacking = {place: weight * times - marking[place] for place, weight in net.inputs[transition].items()}
        lacking = {place: count for place, count in lacking.items() if count > 0}
        with pytest.raises(NotEnabled) as by_definition:
            fire(net, marking, transition, times)
        with pytest.raises(NotEnabled) as by_engine:
            engine.fire(net.transitions.index(transition), times)
        assert by_definition.value.missing == by_engine.value.missing == lacking
        assert by_definition.value.transition == by_engine.value.transition == transition
        assert (dict(marking), engine.tokens, engine.missing) == before


@given(runs())
def test_firing_n_times_at_once_is_firing_n_times(run: tuple[PetriNet, Marking, list[Firing]]) -> None:
    net, marking, firings = run
    blocks = block_net(net)
    for transition, times in firings:
        if not is_enabled(net, marking, transition, times):
            continue
        singly, engine = marking, Engine(blocks, numbered(net, marking))
        for _ in range(times):
            singly = fire(net, singly, transition)
            engine.fire(net.transitions.index(transition))
        marking = fire(net, marking, transition, times)
        assert singly == marking == engine.marking()


def test_of_two_transitions_in_conflict_only_one_fires() -> None:
    builder = NetBuilder()
    builder.place("token")
    builder.place("done")
    builder.transition("one", ["token"], ["done"])
    builder.transition("other", ["token"], ["done"])
    net, start = builder.build(), Marking(["token"])
    assert enabled(net, start) == ("one", "other")
    after = fire(net, start, "one")
    assert enabled(net, after) == ()
    with pytest.raises(NotEnabled, match=r"^other is not enabled; missing tokens: {'token': 1}$"):
        fire(net, after, "other")
    engine = Engine(block_net(net), numbered(net, start))
    engine.fire(0)
    with pytest.raises(NotEnabled, match=r"^other is not enabled; missing tokens: {'token': 1}$"):
        engine.fire(1)
    assert engine.marking() == after == Marking(["done"])


def test_only_what_is_missing_is_said_to_be() -> None:
    net, marking = loan().build(), Marking({"shelf": 3, "card": 2})
    for refused in (
        lambda: fire(net, marking, "borrow", 2),
        lambda: Engine(block_net(net), numbered(net, marking)).fire(0, 2),
    ):
        with pytest.raises(NotEnabled, match=r"^borrow is not enabled; missing tokens: {'shelf': 1}$"):
            refused()


@given(runs())
def test_engines_of_one_compiled_net_do_not_share_a_marking(run: tuple[PetriNet, Marking, list[Firing]]) -> None:
    net, marking, _ = run
    blocks = block_net(net)
    engine, other = Engine(blocks, numbered(net, marking)), Engine(blocks, numbered(net, marking))
    for transition in enabled(net, marking)[:1]:
        engine.fire(net.transitions.index(transition))
    assert other.marking() == marking
    assert other.missing == missing_inputs(net, marking)


# --- the structure ----------------------------------------------------------------------------


def loan() -> NetBuilder:
    """Two copies of a book; borrowing takes one, and a card that is only shown."""
    builder = NetBuilder()
    for place in ("shelf", "card", "home"):
        assert builder.place(place) == place
    assert builder.transition("borrow", {"shelf": 2, "card": 1}, {"home": 2, "card": 1}) == "borrow"
    builder.transition("return", ["home"], ["shelf"])
    return builder


def test_presets_and_postsets_of_places_and_transitions() -> None:
    net = loan().build()
    assert (net.preset("borrow"), net.postset("borrow")) == (("shelf", "card"), ("home", "card"))
    assert (net.preset("card"), net.postset("card")) == (("borrow",), ("borrow",))
    assert (net.preset("shelf"), net.postset("shelf")) == (("return",), ("borrow",))
    with pytest.raises(KeyError):
        net.preset("nobody")


@given(nets())
def test_postset_is_the_inverse_of_preset(net: PetriNet) -> None:
    nodes = (*net.places, *net.transitions)
    forth = {(one, other) for one in nodes for other in net.postset(one)}
    assert forth == {(other, one) for one in nodes for other in net.preset(one)}
    assert forth == {(arc.source, arc.target) for arc in net.arcs}


def test_arcs_and_incidence() -> None:
    net = loan().build()
    assert net.arcs[:3] == (Arc("shelf", "borrow", 2), Arc("card", "borrow"), Arc("borrow", "home", 2))
    assert net.incidence() == ((-2, 0, 2), (1, 0, -1))
    assert repr(net) == "<PetriNet 3 places, 2 transitions>"


@pytest.mark.parametrize("value", [Arc("p", "t"), PetriNet((), {}, {})], ids=repr)
def test_nets_and_their_parts_are_frozen(value: object) -> None:
    with pytest.raises(FrozenInstanceError):
        setattr(value, fields(value)[0].name, "other")  # type: ignore[arg-type]


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


def test_any_mapping_gives_weights() -> None:
    builder = loan()
    builder.transition("t", Marking({"home": 2}), ())
    assert builder.build().inputs["t"] == {"home": 2}


def test_a_built_net_does_not_grow_with_its_builder() -> None:
    builder = loan()
    net = builder.build()
    builder.place("late")
    builder.transition("later", ["late"], [])
    assert net == loan().build()


# --- markings ---------------------------------------------------------------------------------

COUNTS = st.dictionaries(st.sampled_from("abc"), st.integers(0, 3))


@given(COUNTS, COUNTS)
def test_equal_counts_are_equal_markings(one: dict[str, int], other: dict[str, int]) -> None:
    same = all(one.get(place, 0) == other.get(place, 0) for place in "abc")
    assert (Marking(one) == Marking(other)) is same
    assert not same or hash(Marking(one)) == hash(Marking(other))


@given(COUNTS)
def test_a_marking_is_a_multiset(counts: dict[str, int]) -> None:
    listed = [place for place, count in counts.items() for _ in range(count)]
    assert Marking(listed) == Marking(counts) == Marking(Marking(counts))


def test_places_without_tokens_are_absent_and_hold_none() -> None:
    marking = Marking({"p": 2, "q": 0})
    assert (marking["p"], marking["q"], marking["elsewhere"]) == (2, 0, 0)
    assert (dict(marking), len(marking), "q" in marking) == ({"p": 2}, 1, False)
    assert repr(Marking({"q": 1, "p": 2})) == "Marking(p: 2, q: 1)"


def test_a_marking_is_never_negative() -> None:
    with pytest.raises(ValueError, match=r"^a marking cannot be negative: {'p': -1}$"):
        Marking({"p": -1})


def test_a_marking_does_not_change() -> None:
    counts = {"p": 1}
    marking = Marking(counts)
    counts["p"] = 5
    assert marking["p"] == 1
    with pytest.raises(TypeError):
        marking["p"] = 2  # type: ignore[index]
    with pytest.raises(AttributeError):
        marking.more = 1  # type: ignore[attr-defined]


def test_a_marking_is_no_dictionary() -> None:
    assert Marking({"p": 1}) != {"p": 1}


@given(COUNTS, COUNTS, st.integers(1, 3))
def test_covering_is_having_enough_of_everything(have: dict[str, int], need: dict[str, int], times: int) -> None:
    assert Marking(have).covers(need, times) is all(have.get(place, 0) >= times * count for place, count in need.items())
    assert Marking(need).covers(need)


@pytest.mark.parametrize("twice", [["p", "q", "p"], ("p", "q", "p"), iter("pqp")])
def test_a_place_that_is_named_twice_has_two_arcs(twice: Iterable[str]) -> None:
    builder = NetBuilder()
    p, q = builder.place("p"), builder.place("q")
    builder.transition("t", twice, [p, q])
    assert builder.build().inputs["t"] == {"p": 2, "q": 1}
    assert builder.build().incidence() == ((-1, 0),)
