"""Machines that were tampered with are proved or unsound, also where their calls are known; the oracle of the gate sees what is wrong."""

from __future__ import annotations

from collections.abc import Callable, Mapping, MutableMapping, MutableSequence, MutableSet
from dataclasses import replace
from random import Random

import pytest

from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.call_block import CallTerms
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.generate import generate
from pnm.core.machine.machine import MachineBlocks, PetriNetMachine
from pnm.core.machine.plan_graph import EMPTY, ActionCall, GroundAction, PlanGraph, Recovery, Then
from pnm.core.machine.verification import verify as verify_module
from pnm.core.machine.verification.call_content import RESOURCES
from pnm.core.machine.verification.part import Unsound
from pnm.core.machine.verification.verify import forget_proofs, verify
from tests.support.runs.mutation.changes import with_rule
from tests.support.runs.mutation.gate import run_gate
from tests.support.runs.mutation.machines import blocks_of, random_machine, written_out
from tests.support.runs.mutation.oracle import fault_of
from tests.support.runs.plan_graphs import plan, plan_of_steps

PARTS = ("rules", "failure_places", "restart_places", "resource_places", "settling_places", "orderings")
ODD = (None, -1, 99, "nowhere", (), 0.5)


def exchanged(found: Mapping[str, object], random: Random) -> dict[str, object]:
    """One entry left out, or with the value of another one, or with a value that makes no sense."""
    changed, names = dict(found), sorted(found)
    if not names:
        return {"nowhere": random.choice(ODD)}
    name, how = random.choice(names), random.random()
    if how < 0.2:
        del changed[name]
    else:
        changed[name] = changed[random.choice(names)] if how < 0.6 else random.choice(ODD)
    return changed


def tampered(machine: PetriNetMachine, random: Random) -> PetriNetMachine:
    part = random.choice((*PARTS, "rule", "regions"))
    match part:
        case "rule":
            name = random.choice(sorted(machine.rules))
            field, value = random.choice([("guard", None), ("call", 99), ("call", "a"), ("cause", 3), ("action", 3), ("outcome", "")])
            return with_rule(machine, name, **{field: value})
        case "regions":
            return replace(machine, regions=(*machine.regions[1:], *([None] if random.random() < 0.3 else [])))
        case _:
            return replace(machine, **{part: exchanged(getattr(machine, part), random)})


@pytest.mark.parametrize("seed", range(5))
def test_what_was_tampered_with_leads_to_no_other_exception(seed: int) -> None:
    random = Random(seed)
    for number in range(10):
        machine, refused = written_out(random_machine(5 * number + seed)), 0
        for _ in range(8):
            try:
                verify(tampered(machine, random))
            except Unsound:
                refused += 1
        assert refused


# --- the oracle; the gate itself is `python -m tests.random_runs mutants` ---


def test_the_oracle_sees_what_goes_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.support.runs.mutation.gate.is_proved", lambda machine: True)
    assert len(run_gate(range(6)).false_accepts) > 3


def test_a_cause_alone_does_not_interrupt_a_call() -> None:
    machine = generate(plan(1))
    assert fault_of(with_rule(machine, "a0()#0 start", cause=Cause.INVARIANT_FALSE), range(3)) == ""


# --- calls of a kind that was proved in another machine: they are not looked at again, and nothing wrong gets past that ---


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


def test_nothing_of_a_template_that_machines_share_can_be_written_to() -> None:
    (block,) = (block for block in blocks_of(generate(PlanGraph(calls(("arm",))))).placed if block.step)
    template = block.template
    for name in dir(type(template)):
        getattr(template, name)  # what is worked out when it is asked for, too
    writable: list[tuple[str, object]] = []
    seen: list[tuple[str, object]] = [*vars(template).items()]
    while seen:
        where, value = seen.pop()
        if isinstance(value, Mapping):
            seen += [(f"{where}[]", one) for one in value.items()]
        elif isinstance(value, tuple):
            seen += [(f"{where}[]", one) for one in value]
        if isinstance(value, MutableMapping | MutableSequence | MutableSet):
            writable.append((where, value))
    assert not writable
    with pytest.raises(TypeError):
        template.initial[0] = 7  # type: ignore[index]
