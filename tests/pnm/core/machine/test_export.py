"""Machines in other formats: the same bytes as ever. `--write` with python -m tests.pnm.core.machine.test_export renews them."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from pnm.core.machine.generate import generate
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.pictures.export import to_dot, to_json
from tests.support.runs.plan_graphs import ordering, plan_of
from tests.support.runs.simulated import move

GOLDEN = Path(__file__).parent / "golden"


def with_an_item_a_line(machine: PetriNetMachine) -> str:
    """The JSON of a machine, of which only the layout is another one."""
    content = json.loads(to_json(machine))
    assert to_json(machine) == json.dumps(content, indent=1) + "\n"
    return "".join(f"{key}\n" + "".join(f" {json.dumps(item)}\n" for item in items) for key, items in content.items())


FORMATS: dict[str, Callable[[PetriNetMachine], str]] = {"dot": to_dot, "json.txt": with_an_item_a_line}


def machine() -> PetriNetMachine:
    moves = plan_of(move("r1", "hall", "door"), move("r1", "door", "kitchen"))
    return generate(replace(moves, orderings=(ordering("0e<1s", (("at", "r1", "door"),)),)))


@pytest.mark.parametrize("name", FORMATS)
def test_a_machine_is_written_as_it_ever_was(name: str) -> None:
    assert FORMATS[name](machine()) == (GOLDEN / f"machine.{name}").read_text(encoding="utf-8")


if __name__ == "__main__" and "--write" in sys.argv:
    for form, write in FORMATS.items():
        (GOLDEN / f"machine.{form}").write_text(write(machine()), encoding="utf-8")
