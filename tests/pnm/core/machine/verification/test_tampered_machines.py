"""A machine that was tampered with is proved, or unsound: it leads to no other exception."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from random import Random

import pytest

from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.verification.part import Unsound
from pnm.core.machine.verification.verify import verify
from tests.support.runs.mutation.changes import with_rule
from tests.support.runs.mutation.machines import random_machine, written_out

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
