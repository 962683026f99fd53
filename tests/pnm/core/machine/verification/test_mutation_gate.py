"""The oracle of the mutation gate sees what goes wrong; the gate itself is `python -m tests.random_runs mutants`."""

from __future__ import annotations

import pytest

from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.generate import generate
from tests.support.runs.mutation.changes import with_rule
from tests.support.runs.mutation.gate import run_gate
from tests.support.runs.mutation.oracle import fault_of
from tests.support.runs.plan_graphs import plan


def test_the_oracle_sees_what_goes_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.support.runs.mutation.gate.is_proved", lambda machine: True)
    assert len(run_gate(range(6)).false_accepts) > 3


def test_a_cause_alone_does_not_interrupt_a_call() -> None:
    machine = generate(plan(1))
    assert fault_of(with_rule(machine, "a0()#0 start", cause=Cause.INVARIANT_FALSE), range(3)) == ""
