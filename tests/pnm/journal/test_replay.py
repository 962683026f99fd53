"""Replays of journals: they do what was done, for whatever tasks and whatever goes wrong."""

from __future__ import annotations

from pathlib import Path

import pytest

from planner_bridge.tasks.result import TASKS
from pnm.journal.resume import replayed
from tests.support.tasks.scenarios.random_scenarios import run_scenario


@pytest.mark.parametrize("number", range(40))
def test_a_replay_does_what_tasks_have_done(number: int, tmp_path: Path) -> None:
    codes = run_scenario(number, journal=tmp_path / "journal")
    replay = replayed(tmp_path / "journal", TASKS)
    assert all(entry.is_over or not entry.run.begun for entry in replay.runs.values())
    ended = [task.ending.code for task in replay.tasks.values() if task.ending]
    assert len(ended) == len(replay.tasks)
    assert not codes or sorted(ended) == sorted(codes.elements()) or len(ended) < codes.total()  # what was refused was never accepted
