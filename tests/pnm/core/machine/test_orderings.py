"""The net keeps every ordering of a plan, and has a place for none that follows from others."""

from __future__ import annotations

from collections.abc import Collection

from hypothesis import given

from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import Moment, Ordering, PlanEvent, PlanGraph
from tests.support.runs.plan_graphs import closure, plans


@given(plans(most=3))
def test_an_ordering_has_a_place_if_it_does_not_follow_from_others(graph: PlanGraph) -> None:
    own = {(PlanEvent(call.index, Moment.START), PlanEvent(call.index, Moment.END)) for call in graph.calls}

    def kept(orderings: Collection[Ordering]) -> set[tuple[PlanEvent, PlanEvent]]:
        return closure({*own, *((one.before, one.after) for one in orderings)})

    found = generate(graph).orderings.values()
    assert kept(found) == kept(graph.orderings)
    assert {one for one in graph.orderings if one.delay} <= {*found}
    for one in found:
        assert one.delay or kept({*found} - {one}) != kept(found)
