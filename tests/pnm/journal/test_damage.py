"""Damaged journals: whatever bit is another one, what is read is what was written, or the journal is refused by name."""

from __future__ import annotations

import random
import shutil
import sqlite3
from contextlib import closing, suppress
from itertools import product
from pathlib import Path
from unittest.mock import patch

import pytest

from planner_bridge.tasks.result import TASKS
from pnm.core.logic.expressions import Fluent, Unknown, Value
from pnm.errors import InputError, PnmError
from pnm.files.database.lock import lock_of
from pnm.files.database.place import Place
from pnm.journal import journal
from pnm.journal.kept import JournalChoice, JournalError, Row
from pnm.journal.lease import take
from pnm.journal.records import Record, TaskSummary
from pnm.journal.replay import Replay
from pnm.journal.resume import Taken, replay_steps, summaries, take_up
from pnm.journal.store import JournalFile, KeptJournal
from tests.support.tasks.scenarios.forged_journal import forged
from tests.support.tasks.scenarios.random_scenarios import run_scenario

FLIPS = 120


def records(path: Path) -> list[Record]:
    return [step.record for step in replay_steps(path, TASKS, Replay())]


def gone_on_with(path: Path) -> Taken:
    gone_on = take_up(JournalChoice(path), TASKS, "")
    gone_on.hold.release()
    gone_on.file.close()
    return gone_on


def taken(path: Path) -> tuple[dict[Fluent, Value | Unknown], tuple[TaskSummary, ...]]:
    """Return what goes on from a journal: what is known, and the tasks as they are listed."""
    gone_on = gone_on_with(path)
    assert gone_on.replay is not None
    return dict(gone_on.replay.world.facts()), summaries(path, TASKS)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("written") / "journal"
    run_scenario(3, journal=path)
    return path


@pytest.mark.parametrize(
    ("known", "wrong"),
    [('"tokens"', '"taken"'), ('"undecided":{', '"undecided":{"@":"map","items":[[-7,"x"]],'), ('"_rounds":', '"_rounds":7,"_":')],
)
def test_a_run_that_stands_in_no_way_is_refused(known: str, wrong: str, tmp_path: Path) -> None:
    path = tmp_path / "journal"
    with patch.multiple(journal, _LONGER=20, _SHARE=0):  # segments begin while tasks go on
        run_scenario(3, journal=path)
    with forged(path) as file:
        changed = file.execute("UPDATE records SET text = replace(text, ?, ?) WHERE text LIKE '%\"RunStands\"%'", (known, wrong))
        assert changed.rowcount > 0
    with pytest.raises(PnmError, match=r"is damaged behind|cannot be read behind"):
        records(path)


OTHER_VALUES = ("'text'", "x'ff00'", "NULL", "9e999", "9223372036854775807")
COLUMNS = {
    "records": ("sequence", "epoch", "time", "text", "checksum"),
    "segments": ("first", "wall", "checksum"),
    "tasks": ("task", "accepted", "text", "checksum"),
    "parts": ("key", "segment", "text", "checksum"),
    "epochs": ("epoch", "holder"),
    "lease": ("epoch", "holder", "until"),
    "home": ("node", "host", "file"),
}


@pytest.mark.parametrize("table", COLUMNS)
def test_values_of_any_type_are_read_or_refused(table: str, written: Path, tmp_path: Path) -> None:
    for column, value in product(COLUMNS[table], OTHER_VALUES):
        path = tmp_path / f"{column} {OTHER_VALUES.index(value)}"
        path.write_bytes(written.read_bytes())
        lock_of(path).write_text("a pid 1\n1 1 - a pid 1\n")  # which is compared with what is read
        with closing(sqlite3.connect(path)) as connection:
            connection.executescript(
                f"CREATE TABLE loose AS SELECT * FROM {table}; DROP TABLE {table}; ALTER TABLE loose RENAME TO {table};"
                f"UPDATE {table} SET {column} = {value}"
            )
        for read in (check, records, lambda path: summaries(path, TASKS), prune, gone_on_with):
            with suppress(PnmError):
                read(path)


@pytest.mark.parametrize("text", ["[" * 100_000, "[" * 100_000 + "]" * 100_000, '{"@":' * 50_000, "9" * 5000, "1e999"])
def test_texts_that_nobody_writes_are_refused(text: str, written: Path, tmp_path: Path) -> None:
    shutil.copy(written, tmp_path / "journal")
    with forged(tmp_path / "journal") as connection:
        for table in ("records", "tasks", "parts"):
            connection.execute(f"UPDATE {table} SET text = ?", (text,))
    for read in (records, lambda path: summaries(path, TASKS)):
        with pytest.raises(PnmError):
            read(tmp_path / "journal")


def check(path: Path) -> None:
    with closing(KeptJournal(path)) as kept:
        kept.check()
        kept.home(), kept.writer(), kept.holding(), kept.last_segment()


def prune(path: Path) -> None:
    with closing(JournalFile(path, 0.0)) as file:
        file.drop(1e12, 1e12)


@pytest.mark.parametrize("seed", range(4))
def test_one_bit_that_is_another_one_changes_nothing_that_is_read_or_is_refused(seed: int, written: Path, tmp_path: Path) -> None:
    (tmp_path / "whole").write_bytes(written.read_bytes())
    whole, goes_on, rng, refused = records(written), taken(tmp_path / "whole"), random.Random(seed), list[str]()
    for number in range(FLIPS // 4):
        path, content = tmp_path / str(number), bytearray(written.read_bytes())
        content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
        path.write_bytes(content)
        try:
            assert taken(path) == goes_on
            assert records(path) == whole
        except PnmError as error:
            refused.append(str(error))
    assert all(str(tmp_path) in error for error in refused)
    assert 0 < len(refused) < FLIPS // 4


def test_a_fact_that_no_run_has_used_yet_is_checked_as_well(written: Path, tmp_path: Path) -> None:
    fact = next(iter(taken(written)[0]))
    content = bytearray(written.read_bytes())
    text = f'"{fact[0]}","{fact[1]}'.encode()
    content[content.index(text) + len(text) - 1] ^= 1
    (tmp_path / "j").write_bytes(content)
    with pytest.raises(InputError, match=r"the journal .*/j is damaged: record \d+ is not as it was written"):
        taken(tmp_path / "j")


@pytest.mark.parametrize("has_lock", [True, False])
def test_whoever_reads_a_journal_without_its_log_is_told_once(has_lock: bool, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path, away = tmp_path / "tasks.journal", tmp_path / "away.journal"
    file, hold = take(JournalChoice(path))
    file.append([Row(0.0, "a")], {})
    shutil.copy(path, away)
    if has_lock:
        shutil.copy(lock_of(path), lock_of(away))
    with closing(KeptJournal(path)) as kept:
        assert [*kept.tasks(), *kept.rows()] == [(1, Row(0.0, "a"))]
    assert not caplog.records, "this one has its log"
    with closing(KeptJournal(away)) as kept:
        assert [*kept.tasks(), *kept.rows()] == []
    said = "has lost its last records" if has_lock else "and its log is missing"
    assert [said in record.getMessage() for record in caplog.records] == [True]
    hold.release()
    file.close()


def test_a_part_that_stands_where_another_one_should_is_refused(place: Place) -> None:
    file = JournalFile(place, 0.0)
    file.append([Row(0.0, "a")], {"one": "first", "other": "second"})
    file._database.run("DELETE FROM parts WHERE key = 'one'")
    file._database.run("UPDATE parts SET key = 'one' WHERE key = 'other'")  # as an index does that leads elsewhere
    file.close()
    with closing(KeptJournal(place)) as kept, pytest.raises(JournalError, match="the part one is not as it was written"):
        kept.part("one")
