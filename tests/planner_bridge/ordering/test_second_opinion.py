"""A second opinion on the machines of real plans: z3 excludes, from the net alone, that they hang or end as they should not."""

from __future__ import annotations

from pathlib import Path

import pytest

from pnm.core.machine.generate import generate
from tests.support.pddl.real_plans import planned, solved
from tests.support.runs.mutation.changes import without_transition
from tests.support.runs.mutation.machines import random_machine
from tests.support.runs.mutation.state_equation import QUESTIONS, StateEquation


@pytest.mark.parametrize(("domain", "file"), solved(large=False))  # of the large ones, z3 needs half a minute for each
def test_no_marking_of_a_real_machine_hangs_or_ends_badly(domain: Path, file: Path) -> None:
    machine = generate(planned(domain, file)[1])
    assert len(machine.net.places) + len(machine.net.transitions) <= 3_000
    equation = StateEquation(machine)
    assert [question for question in QUESTIONS if not equation.excludes(question)] == []


def test_what_is_wrong_is_not_excluded() -> None:
    machine = random_machine(0)
    assert StateEquation(machine).excludes("a hang")
    name = next(name for name in machine.net.transitions if name.endswith("fork"))
    assert not StateEquation(without_transition(machine, name)).excludes("a bad end")
