"""The machine is the plan: what its orderings say is looked for in the net."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pnm.core.machine.generate import generate
from pnm.core.machine.guards import Always
from pnm.core.machine.plan_graph import ActionCall, GroundAction, Moment, Ordering, PlanEvent, PlanGraph
from pnm.core.machine.verification.part import Unsound
from pnm.core.machine.verification.verify import verify
from pnm.core.net.net import PetriNet
from tests.support.runs.mutation.changes import with_output, with_rule, without_place

START, END = Moment.START, Moment.END
KINDS = [(END, START), (START, START), (END, END), (START, END)]


def plan(*orderings: Ordering, calls: int = 2) -> PlanGraph:
    return PlanGraph(tuple(ActionCall(index, GroundAction(f"a{index}")) for index in range(calls)), orderings)


def ordering(before: Moment, after: Moment, first: int = 0, second: int = 1, delay: float = 0.0) -> Ordering:
    return Ordering(PlanEvent(first, before), PlanEvent(second, after), delay=delay)


@pytest.mark.parametrize("kind", KINDS)
def test_an_ordering_whose_place_is_cut_out_is_missed(kind: tuple[Moment, Moment]) -> None:
    kept = ordering(*kind)
    machine = generate(plan(kept, ordering(END, START, 0, 2), ordering(END, START, 1, 2), calls=3))
    verify(machine)
    place = next(place for place, one in machine.orderings.items() if one == kept)
    with pytest.raises(Unsound, match="no place keeps"):
        verify(without_place(machine, place))


def test_the_machine_of_another_plan_is_refused() -> None:
    machine = generate(plan())
    with pytest.raises(Unsound, match="no place keeps end of #0 < start of #1"):
        verify(replace(machine, plan=plan(ordering(END, START))))
    with pytest.raises(Unsound, match="does not ask for"):
        verify(replace(generate(plan(ordering(END, START))), plan=plan()))
    with pytest.raises(Unsound, match="not those of a region"):
        verify(replace(machine, plan=plan(calls=1)))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("claimed", KINDS)
def test_a_place_that_is_taken_for_another_ordering_is_refused(kind: tuple[Moment, Moment], claimed: tuple[Moment, Moment]) -> None:
    machine = generate(plan(ordering(*kind)))
    (place,) = machine.orderings
    other = replace(machine, plan=plan(ordering(*claimed)), orderings={place: ordering(*claimed)})
    weaker = (kind[0], claimed[0]) == (END, START) and kind[1] is claimed[1]
    if kind == claimed:
        verify(other)
    elif not weaker:  # what waits for an end has waited for the start
        with pytest.raises(Unsound):
            verify(other)


def test_a_start_that_is_announced_before_the_request_is_refused() -> None:
    machine = generate(plan(ordering(START, START)))
    (place,) = machine.orderings
    moved = {
        name: {**arcs, place: 1}
        if name == "a0()#0 start"
        else {key: weight for key, weight in arcs.items() if key != place}
        if name == "a0()#0 accepted"
        else arcs
        for name, arcs in machine.net.outputs.items()
    }
    with pytest.raises(Unsound):
        verify(replace(machine, net=PetriNet(machine.net.places, machine.net.inputs, moved)))


@pytest.mark.parametrize("delay", [0.0, 2.0])
def test_a_time_that_is_not_waited_for_is_missed(delay: float) -> None:
    graph = plan(ordering(START, START, delay=delay))
    graph = replace(graph, steps=(graph.steps[0], replace(graph.calls[1], release=0.0 if delay else 5.0)))
    machine = generate(graph)
    verify(machine)
    with pytest.raises(Unsound, match="does not wait for the times"):
        verify(with_rule(machine, "a1()#1 join", guard=Always()))


def test_a_failure_without_a_cause_is_refused() -> None:
    with pytest.raises(Unsound, match="no rule has found its cause"):
        verify(with_output(generate(plan()), "a1()#1 join", "a1()#1 failed"))
