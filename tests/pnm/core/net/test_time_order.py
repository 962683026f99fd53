"""Order of time of nets: tokens go forward in it, but for the arcs that are said to lead back."""

from __future__ import annotations

from hypothesis import given, strategies as st

from pnm.core.net.net import NetBuilder, PetriNet
from pnm.core.net.orders import TimeOrder, time_order


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
