"""Blocks share templates, and nothing is different for it: neither the machine nor its proof, which looks at every block all the same."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import inf
from random import Random

import pytest
from hypothesis import given, strategies as st

from pnm.core.machine.blocks import PlacedStep
from pnm.core.machine.call_block import CallTerms
from pnm.core.machine.generate import generate
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.step_block import Port
from pnm.core.machine.verification.part import Unsound
from pnm.core.machine.verification.verify import verify
from tests.support.runs.mutation.block_edits import BLOCK_EDITS, Edit
from tests.support.runs.mutation.forgotten import alone, forgetting
from tests.support.runs.mutation.machines import as_text, blocks_of, random_machine, written_out
from tests.support.runs.plan_graphs import plan


def test_a_machine_is_the_same_if_no_block_shares_its_template() -> None:
    with forgetting(""):  # the more machines were made before, the more templates are shared
        for number in range(30):
            assert as_text(random_machine(number, under_way=True)) == alone(number)


@given(st.integers(0, 10_000))
def test_arcs_by_number_are_those_by_name(number: int) -> None:
    machine = random_machine(number)
    by_blocks, by_name = machine.placed, written_out(machine).placed
    assert (len(by_name.placed), by_name.regions) == (1, [])
    for transition in range(len(machine.net.transitions)):
        assert by_blocks.inputs[transition] == by_name.inputs[transition]
        assert by_blocks.outputs[transition] == by_name.outputs[transition]
    for place in range(len(machine.net.places)):
        assert by_blocks.consumers[place] == by_name.consumers[place]
    assert by_blocks.unmarked == by_name.unmarked
    assert by_blocks.counted == by_name.counted


@pytest.mark.parametrize("number", range(12))
def test_the_proof_of_a_sample_is_that_of_the_whole(number: int) -> None:
    machine = random_machine(number)
    assert written_out(machine).generated is None
    assert verify(machine) == verify(written_out(machine)) == verify(machine)  # and again, with what is known of its calls by then


def exchanged(machine: PetriNetMachine, call: int, change: Callable[[PlacedStep], PlacedStep]) -> PetriNetMachine:
    """Change the block of one call, behind the back of the machine."""
    blocks = blocks_of(machine)
    (number,) = (number for number, block in enumerate(blocks.placed) if block.step and block.step.index == call)
    blocks.placed[number] = change(blocks.placed[number])
    return machine


def with_port(port: Port, *places: int) -> Callable[[PlacedStep], PlacedStep]:
    number = [*Port].index(port)
    return lambda block: replace(block, ports=(*block.ports[:number], places, *block.ports[number + 1 :]))


def test_no_block_is_trusted_because_others_are_like_it() -> None:
    def chain() -> PetriNetMachine:
        return generate(plan(5, "0e<1s", "1e<2s", "2e<3s", "3e<4s"))

    verify(chain())
    places = [block.ports for block in blocks_of(chain()).placed]
    other, own = places[2][0], places[3][0]
    for broken, why in (
        (exchanged(chain(), 2, with_port(Port.STARTS_AFTER, *other)), "makes a forbidden connection"),
        (exchanged(chain(), 2, with_port(Port.STARTS_AFTER)), "does not connect two blocks"),
        (exchanged(chain(), 2, with_port(Port.STARTS_AFTER, *own, *other)), "makes a forbidden connection"),
        (exchanged(chain(), 2, with_port(Port.STARTS_AFTER, 1)), "makes a forbidden connection"),
        (exchanged(chain(), 2, lambda block: replace(block, place=block.place - 1)), "overlaps another"),
    ):
        with pytest.raises(Unsound, match=why):
            verify(broken)


@pytest.mark.parametrize(
    ("limit", "wrong", "why"),
    [
        ("timeout", inf, r"a2\(\)#2 running has no exit that is sure to open in finite time"),
        ("release", 1.0, r"a2\(\)#2 join does not wait for the times"),
    ],
)
def test_what_a_call_itself_says_is_looked_at_for_each(limit: str, wrong: float, why: str, monkeypatch: pytest.MonkeyPatch) -> None:
    graph = plan(4)
    machine = generate(replace(graph, steps=tuple(replace(call, release=5.0 + call.index) for call in graph.calls)))
    verify(machine)
    right = getattr(CallTerms, limit).fget
    monkeypatch.setattr(CallTerms, limit, property(lambda call: wrong if call.step.index == 2 else right(call)))
    with pytest.raises(Unsound, match=why):
        verify(machine)


@pytest.mark.parametrize("edit", BLOCK_EDITS, ids=lambda edit: edit.__name__)
def test_blocks_that_were_changed_are_unsound_or_prove_as_the_machine_that_they_make(edit: Edit) -> None:
    refused = 0
    for number in range(25):
        machine, random = random_machine(number), Random(number)
        try:
            edit(blocks_of(machine), random)
        except IndexError:  # there is nothing of that to be changed
            continue
        try:
            verify(machine)
        except Unsound:
            refused += 1
        else:
            verify(written_out(machine))
    assert refused > 3
