"""Calls of a kind that was proved in another machine: they are not looked at again, and nothing wrong gets past that."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.blocks import MachineBlocks
from pnm.core.machine.call_block import CallTerms
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.generate import generate
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.plan_graph import EMPTY, ActionCall, GroundAction, PlanGraph, Recovery, Then
from pnm.core.machine.verification import verify as verify_module
from pnm.core.machine.verification.call_content import RESOURCES
from pnm.core.machine.verification.part import Unsound
from pnm.core.machine.verification.verify import forget_proofs, verify
from tests.support.runs.mutation.machines import blocks_of
from tests.support.runs.plan_graphs import plan, plan_of_steps


def calls(*resources: tuple[str, ...]) -> tuple[ActionCall, ...]:
    return tuple(ActionCall(number, GroundAction(f"a{number}", resources=names)) for number, names in enumerate(resources))


PLAN = plan_of_steps(*calls(("arm",), ("arm",)), orders=("0e<1s",))


def changed(change: Callable[[MachineBlocks], None]) -> PetriNetMachine:
    """The machine of the plan, with its blocks changed behind its back."""
    machine = generate(PLAN)
    change(blocks_of(machine))
    return machine


FRAME, CALL = range(2)
"""The first blocks of the plan."""
RESOURCE = 4
INNER = 9
"""A place of the first call."""


def as_another_step(blocks: MachineBlocks) -> None:
    terms = CallTerms(blocks.placed[CALL].terms.context, replace(PLAN.calls[1], index=0), ())
    blocks.placed[CALL] = replace(blocks.placed[CALL], terms=terms)


def in_the_frame(blocks: MachineBlocks) -> None:
    first, *others = blocks.placed[FRAME].ports
    blocks.placed[FRAME] = replace(blocks.placed[FRAME], ports=((*first, INNER), *others))


def with_two_arms(blocks: MachineBlocks) -> None:
    ports = [*blocks.placed[CALL].ports]
    ports[RESOURCES] *= 2
    blocks.placed[CALL] = replace(blocks.placed[CALL], ports=tuple(ports))


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda blocks: blocks.marked.update({INNER: 1}), "other places are marked at first"),
        (lambda blocks: blocks.marked.update({RESOURCE: 0}), "there is nothing of the resource arm"),
        (lambda blocks: blocks.resources.update({INNER: "leg"}), "there is nothing of the resource leg"),
        (as_another_step, "is that of no step of the plan"),
        (in_the_frame, "makes a forbidden connection"),
        (with_two_arms, "rule of its resources"),
    ],
)
def test_what_is_wrong_around_calls_that_are_known_is_found(change: Callable[[MachineBlocks], None], why: str) -> None:
    machine = generate(PLAN)
    assert blocks_of(machine).segment_of(INNER) is blocks_of(machine).placed[CALL]
    assert [*machine.placed.resources] == [RESOURCE]
    verify(machine)
    with pytest.raises(Unsound, match=why):
        verify(changed(change))


def test_a_name_is_not_used_twice_by_a_call_that_is_known() -> None:
    verify(generate(PlanGraph(calls(("arm",)))))
    twice = PlanGraph((ActionCall(0, GroundAction("resource a", resources=("a()#0 done",))),))
    with pytest.raises(Unsound, match="a name is used twice"):
        verify(generate(twice))


def test_calls_of_all_machines_share_templates_and_what_was_proved_of_them(monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = generate(plan(3, "0e<1s", "1e<2s")), generate(plan(5, "0e<1s", "1e<2s", "2e<3s", "3e<4s"))
    forget_proofs()
    proof = verify(first)
    explored: list[object] = []
    monkeypatch.setattr(verify_module, "explore_part", explored.append)
    templates = [{block.template for block in blocks_of(machine).placed if block.step} for machine in (first, second)]
    assert templates[0] == templates[1]
    assert verify(second) == replace(proof, calls=5)
    assert not explored


def test_a_proof_is_the_same_whatever_was_proved_before() -> None:
    bindings = Bindings({"a0": Binding(accept=2.0), "a1": Binding(accept=3.0)})
    other, machine = (generate(PlanGraph(calls(*resources)), bindings) for resources in ([("arm", "leg")], [("arm",), ("arm",)]))
    forget_proofs()
    proof = verify(machine)
    forget_proofs()
    verify(other)
    assert verify(machine) == proof


def test_a_template_of_a_call_that_may_be_skipped_is_none_of_another() -> None:
    spared = ActionCall(0, GroundAction("a0"), recoveries=(Recovery(frozenset({Cause.ABORTED}), Then.SKIP, EMPTY),))
    machine = generate(PlanGraph((spared, ActionCall(1, GroundAction("a1")))))
    verify(machine)
    blocks = blocks_of(machine)
    blocks.placed[CALL + 1] = replace(blocks.placed[CALL + 1], template=blocks.placed[CALL].template)
    with pytest.raises(Unsound, match=r"^a1\(\)#1 does not keep the rule of its recoveries: "):
        verify(machine)
