"""A share of the mutation gate: nothing that the proof accepts goes wrong when it is executed.

The rest is run by `python -m tests.random_runs mutants`.
"""

from __future__ import annotations

from tests.support.runs.mutation.gate import run_gate
from tests.support.runs.mutation.machines import random_machine
from tests.support.runs.mutation.oracle import fault_of


def test_nothing_that_is_accepted_goes_wrong() -> None:
    report = run_gate(range(12))
    assert report.false_accepts == []
    assert report.machines == 12
    assert report.verdicts["refused"] > report.verdicts["accepted"] > 0


def test_the_oracle_sees_what_goes_wrong(monkeypatch) -> None:
    monkeypatch.setattr("tests.support.runs.mutation.gate.is_proved", lambda machine: True)
    assert len(run_gate(range(12)).false_accepts) > 12


def test_machines_are_the_same_for_the_same_number() -> None:
    assert random_machine(7).net == random_machine(7).net
    assert fault_of(random_machine(7), range(3)) == ""
