"""The mutation gate of policies (`python -m tests.random_runs policies`): its oracles see what is wrong with them and their nets."""

from __future__ import annotations

import pytest

from planner_bridge.planning.policies.net import PolicyNet
from tests.support.runs.mutation.policies import run_policy_gate


def test_the_oracles_see_what_goes_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.support.runs.mutation.policies.proved_in", lambda _, entries, __: [*range(len(entries))])
    monkeypatch.setattr(PolicyNet, "is_sure", True)
    wrong = run_policy_gate(range(4)).false_accepts
    assert {about.partition(" ")[0] for about in wrong} == {"policy", "net"}
