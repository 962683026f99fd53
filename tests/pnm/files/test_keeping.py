"""Files of databases as a whole: what goes through all of one has its time, ends by Ctrl-C, and is on the disk or not there."""

from __future__ import annotations

import os
import signal
import sqlite3
import tempfile
from contextlib import closing
from itertools import count
from pathlib import Path

import pytest

from pnm.files.database import driver, sqlite
from pnm.files.database.database import Database, copy_file, move_file
from pnm.files.database.driver import DatabaseError, OperationLimit
from pnm.journal.kept import Damaged, JournalError, Row
from pnm.journal.store import JournalFile, KeptJournal
from pnm.journal.tables import LAYOUT

ROWS = 500


@pytest.fixture
def journal(tmp_path: Path) -> Path:
    """A journal of two segments, which was closed."""
    path = tmp_path / "journal"
    file = JournalFile(path, 0.0)
    for wall in (0.0, 1.0):
        file.append([Row(0.0, "x" * 3000, wall if number == 0 else None) for number in range(ROWS)], {})
    file.close()
    return path


@pytest.fixture
def slow(journal: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have a second go by whenever SQLite has done a little: opening a journal takes none, and going through it more than a limit.

    The journal was written before.
    """
    clock = count()
    monkeypatch.setattr(driver, "monotonic", lambda: float(next(clock)))
    monkeypatch.setattr(sqlite, "_STEPS", 100)


@pytest.mark.usefixtures("slow")
def test_a_file_that_is_not_read_in_time_is_not_called_damaged(journal: Path) -> None:
    with closing(KeptJournal(journal)) as kept, pytest.raises(JournalError, match="it has not answered within 10 s") as refused:
        kept.check()
    assert not isinstance(refused.value, Damaged)


@pytest.mark.usefixtures("slow")
def test_what_goes_through_a_file_has_the_time_that_its_size_needs(journal: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sqlite, "_SLOW", 10_000)
    with closing(Database(journal, LAYOUT, read_only=True)) as database:
        database.do(lambda driver: driver.check())
    copy_file(journal, journal.with_name("copy"))


def test_a_file_that_is_no_database_any_more_is_called_damaged(journal: Path) -> None:
    content = journal.read_bytes()
    journal.write_bytes(content[: len(content) // 2])
    with pytest.raises(Damaged, match="database disk image is malformed"):
        KeptJournal(journal)


@pytest.mark.usefixtures("slow")
def test_space_is_given_back_in_steps_and_the_rest_the_next_time(journal: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with closing(sqlite3.connect(journal)) as connection, connection:
        connection.execute("DELETE FROM records")
    sizes, clock = [journal.stat().st_size], count()
    monkeypatch.setattr(sqlite, "monotonic", lambda: float(next(clock)) * 0.4)
    monkeypatch.setattr(sqlite, "_PAGES", 200)
    with closing(Database(journal, LAYOUT)) as database:
        while len(sizes) < 2 or sizes[-1] < sizes[-2]:
            database.do(lambda driver: driver.shrink())
            database.do(lambda driver: driver.gather())
            sizes.append(journal.stat().st_size)
    assert len(sizes) > 4
    assert sizes[-1] < sizes[0] / 10


def test_a_copy_hears_ctrl_c_and_leaves_no_file(journal: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    to = journal.with_name("copy")

    def look(_: OperationLimit) -> bool:
        if to.exists():
            signal.raise_signal(signal.SIGINT)
        return False

    monkeypatch.setattr(sqlite, "_STEPS", 50)
    monkeypatch.setattr(OperationLimit, "is_over", property(look))
    with pytest.raises(KeyboardInterrupt):
        copy_file(journal, to)
    assert [file.name for file in journal.parent.iterdir() if file.name.startswith("copy")] == []


@pytest.mark.parametrize("name", ["x" * 300, "folder/copy"])
def test_a_copy_that_cannot_be_made_is_an_error_of_the_database(journal: Path, name: str) -> None:
    with pytest.raises(DatabaseError, match=r"File name too long|there is no folder"):
        copy_file(journal, journal.parent / name)


def test_a_file_that_moves_to_another_device_is_on_its_disk_before_it_is_gone_here(journal: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
        to, synced, sync = Path(folder) / "moved", list[int](), os.fsync
        if os.stat(folder).st_dev == os.stat(journal).st_dev:
            pytest.skip("there is one device")

        def noted(file: int) -> None:
            assert journal.exists()
            synced.append(os.fstat(file).st_ino)
            sync(file)

        monkeypatch.setattr(os, "fsync", noted)
        move_file(journal, to)
        assert synced == [to.stat().st_ino, os.stat(folder).st_ino]
        assert not journal.exists()
        with closing(KeptJournal(to)) as kept:
            assert kept.check() == 2 * ROWS
