"""Whose a journal file is, and whether it is all there: what was moved, copied, deleted or put back is never gone on with unasked."""

from __future__ import annotations

import asyncio
import os
import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path
from uuid import UUID

import pytest

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.resources import Resources
from pnm.errors import InputError, PnmError
from pnm.files.database.place import Place
from pnm.files.database.sqlite import files_of, log_of
from pnm.journal.codec import RECORDS
from pnm.journal.journal import WrittenJournal
from pnm.journal.kept import Fenced, Hold, JournalChoice, JournalError, Row
from pnm.journal.lease import Watch, take
from pnm.journal.resume import replayed
from pnm.journal.store import JournalFile, KeptJournal
from pnm.tasks import Wanted
from tests.support.e2e.command_line import pnm
from tests.support.processes import LIMIT, Program

RECORDS_KEPT = 5
WRITER = """
import sys
from pathlib import Path
from pnm.journal.kept import JournalChoice, Row
from pnm.journal.lease import take
file, hold = take(JournalChoice(Path(sys.argv[1]), node="/pnm"))
for number in range(int(sys.argv[2])):
    file.append([Row(0.0, str(number))], {})
print("kept", flush=True)
sys.stdin.readline()
import time
time.sleep(1000.0)
"""


def killed(path: Path, records: int = RECORDS_KEPT) -> str:
    """Have a process write a journal, and kill it; return how others call it."""
    program = Program(["-c", WRITER, str(path), str(records)], {})
    program.until(lambda: "kept" in program.out)
    program.process.kill()
    program.process.wait(LIMIT)
    program.close()
    return f"pid {program.process.pid}"


def texts(path: Path, node: str = "/pnm", *, adopts: bool = False) -> list[str]:
    """Take a journal, and return what is in it."""
    file, hold = take(JournalChoice(path, node=node, adopts=adopts))
    hold.release()
    file.close()
    kept = KeptJournal(path)
    found = [row.text for _, row in kept.rows()]
    kept.close()
    return found


ALL = [str(number) for number in range(RECORDS_KEPT)]


def move(path: Path, to: Path) -> None:
    """Move a journal with all its files."""
    for file, target in zip(files_of(path), files_of(to), strict=True):
        if file.exists():
            file.rename(target)


def copy(path: Path, to: Path) -> None:
    """Copy a journal with all its files."""
    for file, target in zip(files_of(path), files_of(to), strict=True):
        if file.exists():
            shutil.copy(file, target)


def test_a_file_that_was_moved_without_its_log_is_refused_at_both_places_and_nothing_is_lost(tmp_path: Path) -> None:
    path, away = tmp_path / "tasks.journal", tmp_path / "old.journal"
    who = killed(path)
    path.rename(away)
    with pytest.raises(PnmError, match=r"tasks.journal is not there, and .* has kept 5 records in it: it was deleted or moved"):
        texts(path)
    for adopts in (False, True):
        with pytest.raises(PnmError, match=r"there is only tasks.journal-wal, with the last records|it was deleted or moved"):
            texts(path, adopts=adopts)
    with pytest.raises(PnmError, match=f"old.journal was not closed by .*{who}, and its log is missing"):
        texts(away)
    with pytest.raises(JournalError, match=r"there is only tasks.journal-wal"):
        KeptJournal(path)
    away.rename(path)
    assert texts(path) == ALL


@pytest.mark.parametrize(
    ("first", "said"), [(0, "is not there, and .*"), (1, "has lost its last records: .*")], ids=["all of it", "its log"]
)
def test_what_is_deleted_after_a_kill_is_missed_until_it_is_said(tmp_path: Path, first: int, said: str) -> None:
    path = tmp_path / "tasks.journal"
    who = killed(path)
    for file in files_of(path)[first:3]:
        file.unlink()
    with pytest.raises(InputError, match=f"{said}{who} has kept 5 records in it"):
        texts(path)
    assert path.exists() is bool(first)
    assert texts(path, adopts=True) == []
    assert texts(path) == [], "it was said"


def test_a_copy_is_not_gone_on_with_unless_that_is_said(tmp_path: Path) -> None:
    path, other = tmp_path / "tasks.journal", tmp_path / "copy.journal"
    killed(path)
    copy(path, other)
    with pytest.raises(InputError, match=r"copy.journal is a copy, or was moved by hand; .*expected --adopt if this is the only one"):
        texts(other)
    assert texts(path) == ALL
    assert texts(other, adopts=True) == ALL
    assert texts(other) == ALL, "it belongs here from now on"


def test_an_older_copy_that_was_put_back_is_not_gone_on_with_unless_that_is_said(tmp_path: Path) -> None:
    path, backup = tmp_path / "tasks.journal", tmp_path / "backup"
    killed(path)
    copy(path, backup)
    assert texts(path) == ALL
    shutil.copy(backup, path)  # the same file, with what it had before
    shutil.copy(log_of(backup), log_of(path))
    with pytest.raises(InputError, match=r"tasks.journal is an older copy, or has lost its last records"):
        texts(path)
    assert texts(path, adopts=True) == ALL


def test_files_that_are_moved_together_are_the_same_journal(tmp_path: Path) -> None:
    path, away = tmp_path / "tasks.journal", tmp_path / "old.journal"
    killed(path)
    move(path, away)
    assert texts(away) == ALL
    assert texts(path) == []


def test_a_journal_that_is_moved_after_a_kill_goes_on_at_its_new_place_and_another_one_begins_at_the_old(tmp_path: Path) -> None:
    path, away = tmp_path / "tasks.journal", tmp_path / "old.journal"
    killed(path)
    moved = pnm("journal", "move", str(path), str(away))
    assert moved.returncode == 0, moved.stderr
    assert texts(away) == ALL
    assert texts(path) == []
    again = pnm("journal", "move", str(path), str(away))
    assert (again.returncode, again.stderr.count("\n")) == (2, 1)
    assert "cannot be moved: there is old.journal already" in again.stderr
    assert texts(away) == ALL


def test_a_journal_that_is_written_is_copied_whole_and_not_moved(tmp_path: Path) -> None:
    path, backup, away = tmp_path / "tasks.journal", tmp_path / "backup", tmp_path / "away"
    file, hold = take(JournalChoice(path, node="/pnm"))
    for text in ALL:
        file.append([Row(0.0, text)], {})
    copied, moved = pnm("journal", "copy", str(path), str(backup)), pnm("journal", "move", str(path), str(away))
    assert copied.returncode == 0, copied.stderr
    assert backup.stat().st_mode & 0o777 == 0o600
    assert moved.returncode == 2
    assert f"pid {os.getpid()} holds the journal {path}" in moved.stderr
    file.append([Row(0.0, "more")], {})
    hold.release()
    file.close()
    assert texts(path) == [*ALL, "more"]
    assert not away.exists()
    with pytest.raises(InputError, match="backup is a copy, or was moved by hand"):
        texts(backup)
    assert texts(backup, adopts=True) == ALL


def test_a_check_says_whose_a_journal_is_and_what_is_missing_or_damaged(tmp_path: Path) -> None:
    path = tmp_path / "tasks.journal"
    who = killed(path)
    said = pnm("journal", "check", str(path))
    assert said.returncode == 0, said.stderr
    assert "whole    5 records in 0 segments; 0 tasks, 0 of them not over" in said.stdout
    assert "node     /pnm" in said.stdout
    assert f"{who}, which has not closed it" in said.stdout
    log_of(path).rename(tmp_path / "kept")
    assert "has lost its last records: " in pnm("journal", "check", str(path)).stderr
    (tmp_path / "kept").rename(log_of(path))
    with sqlite3.connect(path) as connection:
        connection.execute("UPDATE records SET text = 'x' WHERE sequence = 3")
    connection.close()
    damaged = pnm("journal", "check", str(path))
    assert (damaged.returncode, damaged.stderr) == (2, f"the journal {path} is damaged: record 3 is not as it was written\n")


def test_old_records_are_pruned_by_hand_and_the_segment_that_goes_on_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "tasks.journal"
    file, hold = take(JournalChoice(path, node="/pnm"))
    for wall in (0.0, 1.0, 2.0):
        file.append([Row(0.0, f"begin {wall}", begins=wall)], {})
    held = pnm("journal", "prune", str(path))
    assert "holds the journal" in held.stderr
    hold.release()
    file.close()
    pruned = pnm("journal", "prune", str(path), "--keep-days", "1")
    assert pruned.returncode == 0, pruned.stderr
    assert texts(path) == ["begin 2.0"]


def test_a_journal_belongs_to_its_node(place: Place) -> None:
    first, hold = take(JournalChoice(place, node="/pnm"))
    hold.release()
    first.close()
    with pytest.raises(InputError, match="is the journal of /pnm, and not of /other/pnm"):
        take(JournalChoice(place, node="/other/pnm"))
    for choice in (
        JournalChoice(place, node=None),
        JournalChoice(place, node="/other/pnm", adopts=True),
        JournalChoice(place, node="/other/pnm"),
    ):
        file, hold = take(choice)
        hold.release()
        file.close()


class Looking(Hold):
    """The hold of a file that is looked at when a test says so."""

    look: Callable[[], None]

    def keep(self, renewed: Callable[[], None], fenced: Callable[[Fenced], None]) -> None:
        self.look = renewed


async def lost_and_found(path: Path, lose: Callable[[Path], None], find: Callable[[Path], None]) -> None:
    """Lose a journal under a process that writes it, and find it again."""
    hold = Looking()
    journal = WrittenJournal(JournalFile(path, 0.0), RECORDS, hold=hold)
    journal.begin(KnowledgeBase(), Resources())
    journal.accepted(Wanted(UUID(int=1), "before"), 1)
    lose(path)
    hold.look()
    assert journal.blocked, "although nothing was to be written"
    with pytest.raises(JournalError, match=rf"{path.name}.*(it was deleted or moved|it was replaced)"):
        journal.accepted(Wanted(UUID(int=2), "meanwhile"), 2)
    find(path)
    hold.look()
    assert not journal.blocked
    journal.accepted(Wanted(UUID(int=3), "after"), 3)
    journal.close()
    assert [task.accepted.wanted.text for task in replayed(path, RECORDS).tasks.values()] == ["before", "after"]


@pytest.mark.parametrize("number", range(3))
async def test_a_file_that_is_deleted_or_moved_under_a_node_blocks_it_until_it_is_back(number: int, tmp_path: Path) -> None:
    def lose(path: Path) -> None:
        os.link(files_of(path)[number], tmp_path / "kept")
        files_of(path)[number].unlink()

    await lost_and_found(tmp_path / "tasks.journal", lose, lambda path: (tmp_path / "kept").rename(files_of(path)[number]))


async def test_a_file_that_is_replaced_under_a_node_blocks_it(tmp_path: Path) -> None:
    def lose(path: Path) -> None:
        path.rename(tmp_path / "kept")
        shutil.copy(tmp_path / "kept", path)

    await lost_and_found(tmp_path / "tasks.journal", lose, lambda path: (tmp_path / "kept").rename(path))


def test_a_file_is_looked_at_again_and_again_while_there_is_nothing_to_write(tmp_path: Path) -> None:
    async def main() -> None:
        looked, hold = asyncio.Queue[None](), Watch()
        hold.keep(lambda: looked.put_nowait(None), pytest.fail)
        for _ in range(2):
            await looked.get()
        hold.release()

    asyncio.run(main())
