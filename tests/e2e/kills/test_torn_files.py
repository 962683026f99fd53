"""Journals of processes that were killed, and whose files are torn or damaged: what was committed is there, or they are refused by name."""

from __future__ import annotations

import random
import shutil
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from planner_bridge.tasks.result import TASKS
from pnm.errors import PnmError
from pnm.journal.replay import Replay
from pnm.journal.resume import replay_steps
from tests.support.tasks.kills.campaign import journal_left

COMMITS = 15
TEARS = 30


@pytest.fixture(scope="module")
def left(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The journal of a process that was killed just after a commit."""
    return journal_left(7, tmp_path_factory.mktemp("left"), COMMITS)


def copied(journal: Path, folder: Path) -> Path:
    """Return a copy of a journal, with its write-ahead log."""
    for file in (journal, wal(journal)):
        if file.exists():
            shutil.copy(file, folder / file.name)
    wal(folder / journal.name).with_suffix(".shm").unlink(missing_ok=True)
    return folder / journal.name


def wal(journal: Path) -> Path:
    return journal.with_name(f"{journal.name}-wal")


def records(journal: Path) -> Iterator[object]:
    """Yield the records of a journal; raises nothing but what has a reason in words."""
    for step in replay_steps(journal, TASKS, Replay()):
        yield step.record


def before_the_last_commit(log: bytes) -> int:
    """Return how many bytes of a write-ahead log are those of all commits but the last one (https://sqlite.org/fileformat.html#walformat)."""
    frame = 24 + int.from_bytes(log[8:12])
    ends = [end for end in range(32 + frame, len(log) + 1, frame) if int.from_bytes(log[end - frame + 4 : end - frame + 8])]
    return ends[-2]


def torn(file: Path, rng: random.Random) -> None:
    """Take away the end of a file."""
    with file.open("r+b") as opened:
        opened.truncate(rng.randrange(file.stat().st_size))


def test_what_was_committed_is_there_when_the_write_ahead_log_ends_in_the_middle_of_a_step(left: Path, tmp_path: Path) -> None:
    whole = [*records(copied(left, tmp_path))]
    with wal(copied(left, tmp_path)).open("ab") as log:
        log.write(random.Random(1).randbytes(5000))
    assert [*records(tmp_path / left.name)] == whole
    with wal(copied(left, tmp_path)).open("r+b") as log:
        log.truncate(before_the_last_commit(wal(left).read_bytes()))
    before = [*records(tmp_path / left.name)]
    assert before == whole[: len(before)] != whole
    for tear in range(1, 40):
        journal = copied(left, tmp_path)
        with wal(journal).open("r+b") as log:
            log.truncate(wal(left).stat().st_size - tear)
        assert [*records(journal)] == before, "only the last commit is lost"


@pytest.mark.parametrize("number", range(TEARS))
def test_a_write_ahead_log_that_is_cut_anywhere_has_what_is_before_the_cut(left: Path, tmp_path: Path, number: int) -> None:
    whole = [*records(copied(left, tmp_path))]
    journal = copied(left, tmp_path)
    torn(wal(journal), random.Random(number))
    with suppress(PnmError):
        found = [*records(journal)]
        assert found == whole[: len(found)]
