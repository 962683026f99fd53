"""Replays of journals: they do what was done, for whatever tasks and whatever goes wrong."""

from __future__ import annotations

from pathlib import Path

import pytest

from planner_bridge.tasks.result import TASKS
from pnm.errors import PnmError
from pnm.journal.codec import Undecodable
from pnm.journal.resume import replayed
from pnm.journal.store import JournalError
from tests.support.tasks.scenarios.forged_journal import forged
from tests.support.tasks.scenarios.random_scenarios import run_scenario


@pytest.mark.parametrize("number", range(8))
def test_a_replay_does_what_tasks_have_done(number: int, tmp_path: Path) -> None:
    codes = run_scenario(number, journal=tmp_path / "journal")
    replay = replayed(tmp_path / "journal", TASKS)
    assert all(entry.is_over or not entry.run.begun for entry in replay.runs.values())
    ended = [task.ending.code for task in replay.tasks.values() if task.ending]
    assert len(ended) == len(replay.tasks)
    assert not codes or sorted(ended) == sorted(codes.elements()) or len(ended) < codes.total()  # what was refused was never accepted


@pytest.mark.parametrize(
    ("text", "error", "reason"),
    [
        ('{"@": "Stranger"}', Undecodable, "cannot be read behind record 4: there is no Stranger in this version"),
        ("[", Undecodable, r"cannot be read behind record 4: not a value of this version: \["),
        ("null", JournalError, "is damaged behind record 4: the next records do not fit those before"),
    ],
)
def test_a_record_that_cannot_be_replayed_is_named_with_its_place(text: str, error: type[PnmError], reason: str, tmp_path: Path) -> None:
    run_scenario(3, journal=tmp_path / "journal")
    with forged(tmp_path / "journal") as file:
        file.execute("UPDATE records SET text = ? WHERE sequence = 5", (text,))
    with pytest.raises(error, match=f"the journal {tmp_path / 'journal'} {reason}"):
        replayed(tmp_path / "journal", TASKS)
