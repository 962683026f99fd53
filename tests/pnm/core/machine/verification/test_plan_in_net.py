"""The machine is the plan: what its orderings say is looked for in the net."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pnm.core.machine.generate import generate
from pnm.core.machine.guards import Always
from pnm.core.machine.verification.part import Unsound
from pnm.core.machine.verification.verify import verify
from tests.support.runs.mutation.changes import with_output, with_rule, without_output, without_place
from tests.support.runs.plan_graphs import ordering, plan

KINDS = ["0e<1s", "0s<1s", "0e<1e", "0s<1e"]


@pytest.mark.parametrize("kind", KINDS)
def test_an_ordering_whose_place_is_cut_out_is_missed(kind: str) -> None:
    machine = generate(plan(3, kind, "0e<2s", "1e<2s"))
    verify(machine)
    place = next(place for place, one in machine.orderings.items() if one == ordering(kind))
    with pytest.raises(Unsound, match="no place keeps"):
        verify(without_place(machine, place))


def test_the_machine_of_another_plan_is_refused() -> None:
    machine = generate(plan(2))
    with pytest.raises(Unsound, match="no place keeps end of #0 < start of #1"):
        verify(replace(machine, plan=plan(2, "0e<1s")))
    with pytest.raises(Unsound, match="does not ask for"):
        verify(replace(generate(plan(2, "0e<1s")), plan=plan(2)))
    with pytest.raises(Unsound, match="not those of a region"):
        verify(replace(machine, plan=plan(1)))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("claimed", KINDS)
def test_a_place_that_is_taken_for_another_ordering_is_refused(kind: str, claimed: str) -> None:
    machine = generate(plan(2, kind))
    (place,) = machine.orderings
    other = replace(machine, plan=plan(2, claimed), orderings={place: ordering(claimed)})
    is_weaker = (kind[1], claimed[1]) == ("e", "s") and kind[-1] == claimed[-1]  # what waits for an end has waited for the start
    if kind == claimed:
        verify(other)
    elif not is_weaker:
        with pytest.raises(Unsound):
            verify(other)


def test_a_start_that_is_announced_before_the_request_is_refused() -> None:
    machine = generate(plan(2, "0s<1s"))
    (place,) = machine.orderings
    with pytest.raises(Unsound):
        verify(with_output(without_output(machine, "a0()#0 accepted", place), "a0()#0 start", place))


@pytest.mark.parametrize("delay", [0.0, 2.0])
def test_a_time_that_is_not_waited_for_is_missed(delay: float) -> None:
    first, second = plan(2).calls
    released = replace(second, release=0.0 if delay else 5.0)
    graph = replace(plan(2), steps=(first, released), orderings=(replace(ordering("0s<1s"), delay=delay),))
    machine = generate(graph)
    verify(machine)
    with pytest.raises(Unsound, match="does not wait for the times"):
        verify(with_rule(machine, "a1()#1 join", guard=Always()))
