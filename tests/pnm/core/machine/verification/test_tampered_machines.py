"""A machine that was tampered with is proved, or unsound: it leads to no other exception."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from random import Random

import pytest

from pnm.core.machine.generate import generate
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.plan_graph import ActionCall, GroundAction, PlanGraph
from pnm.core.machine.verification.call_content import RESOURCES
from pnm.core.machine.verification.part import Unsound
from pnm.core.machine.verification.verify import forget_proofs, verify
from pnm.core.net.net import Marking, PetriNet
from tests.support.runs.mutation.machines import blocks_of, random_machine, written_out

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
    part = random.choice((*PARTS, "rule", "initial", "net", "regions"))
    match part:
        case "rule":
            name = random.choice(sorted(machine.rules))
            field, value = random.choice([("guard", None), ("call", 99), ("call", "a"), ("cause", 3), ("action", 3), ("outcome", "")])
            return replace(machine, rules={**machine.rules, name: machine.rules[name]._replace(**{field: value})})
        case "initial":
            return replace(machine, initial=Marking({random.choice(machine.net.places): random.choice((0, 2))}))
        case "net":
            net = machine.net
            inputs = {**net.inputs, random.choice(sorted(net.inputs)): {random.choice(net.places): random.choice((1, 2))}}
            return replace(machine, net=PetriNet(tuple(net.places), inputs, dict(net.outputs)))
        case "regions":
            left = [one for one in machine.regions if random.random() < 0.5]
            return replace(machine, regions=(*left, *([None] if random.random() < 0.3 else [])))
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


def test_a_resource_that_is_taken_twice_is_not_what_the_plan_asks() -> None:
    machine = generate(PlanGraph(tuple(ActionCall(number, GroundAction(f"a{number}", resources=("arm",))) for number in range(2))))
    blocks = blocks_of(machine)
    number = max(number for number, block in enumerate(blocks.placed) if isinstance(block.step, ActionCall))
    ports = [*blocks.placed[number].ports]
    ports[RESOURCES] *= 2
    blocks.placed[number] = replace(blocks.placed[number], ports=tuple(ports))
    forget_proofs()
    with pytest.raises(Unsound, match="rule of its resources"):
        verify(machine)
