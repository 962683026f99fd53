"""The oracle of the mutation gate sees what goes wrong; the gate itself is `python -m tests.random_runs mutants`."""

from __future__ import annotations

import pytest

from tests.support.runs.mutation.gate import run_gate


def test_the_oracle_sees_what_goes_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.support.runs.mutation.gate.is_proved", lambda machine: True)
    assert len(run_gate(range(6)).false_accepts) > 3
