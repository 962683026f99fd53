"""Journal files: what they refuse, who may write, and what is left of a transaction that did not come to its end."""

from __future__ import annotations

import os
import sqlite3
from pathlib import Path
from typing import Any

import pytest

from pnm.files.database.place import Place, place_of
from pnm.journal.codec import RECORDS
from pnm.journal.kept import Durability, Fenced, HeldByAnother, JournalChoice, JournalError, Row, TaskRow
from pnm.journal.resume import take_up
from pnm.journal.store import JournalFile, KeptJournal
from pnm.journal.tables import LAYOUT
from tests.support.e2e.hosts.postgres import PostgresServer
from tests.support.processes import until


def opened(place: Place, lease: float | None = None) -> JournalFile:
    return JournalFile(place, Durability.PROCESS_CRASH, 0.0, lease)


def texts(place: Place) -> list[str]:
    kept = KeptJournal(place)
    rows = [row.text for _, row in kept.rows()]
    kept.close()
    return rows


def test_what_was_committed_is_there_and_parts_are_kept_once(place: Place) -> None:
    file = opened(place)
    file.append([Row(0.0, "a"), Row(1.0, "b")], {"key": "part"})
    file.append([Row(2.0, "c")], {"key": "part"})
    kept = KeptJournal(place)
    assert list(kept.rows(after=1)) == [(2, Row(1.0, "b")), (3, Row(2.0, "c"))]
    assert texts(place) == ["a", "b", "c"]
    assert kept.part("key") == "part"
    with pytest.raises(JournalError, match="names the part other, which is not there"):
        kept.part("other")
    file.close()
    kept.close()


def test_a_long_journal_is_read_whole(place: Place) -> None:
    file = opened(place)
    file.append([Row(0.0, str(number)) for number in range(2500)], {})
    assert texts(place) == [str(number) for number in range(2500)]
    file.close()


@pytest.mark.parametrize(
    ("durability", "in_sqlite", "in_postgres"), [(Durability.PROCESS_CRASH, 1, "off"), (Durability.POWER_LOSS, 2, "on")]
)
def test_with_power_loss_every_commit_is_on_the_disk(place: Place, durability: Durability, in_sqlite: int, in_postgres: str) -> None:
    file = JournalFile(place, durability, 0.0)
    asked, answer = ("PRAGMA synchronous", in_sqlite) if isinstance(place, Path) else ("SHOW synchronous_commit", in_postgres)
    driver: Any = file._database._driver
    assert [list(row) for row in driver.run(asked, {})] == [[answer]]
    assert Durability.of(durability.word) is durability
    file.close()


def test_what_is_not_chosen_is_durable_where_a_server_may_crash(place: Place) -> None:
    taken = take_up(JournalChoice(place), RECORDS, "")
    asked, answer = ("PRAGMA synchronous", 1) if isinstance(place, Path) else ("SHOW synchronous_commit", "on")
    driver: Any = taken.file._database._driver
    assert [list(row) for row in driver.run(asked, {})] == [[answer]]
    taken.hold.release()
    taken.file.close()


def test_whoever_opens_it_last_may_write(place: Place) -> None:
    first = opened(place)
    first.append([Row(0.0, "a")], {})
    second = opened(place)
    with pytest.raises(Fenced, match="another process has taken over"):
        first.append([Row(1.0, "late")], {})
    second.append([Row(1.0, "b")], {})
    assert texts(place) == ["a", "b"]
    first.close()
    second.close()


def test_a_journal_with_a_lease_is_taken_by_nobody_until_it_is_let_go(place: Place) -> None:
    first = opened(place, 60.0)
    with pytest.raises(HeldByAnother, match=f"pid {os.getpid()} holds the journal") as refused:
        opened(place, 60.0)
    assert 50.0 < refused.value.left <= 60.0
    first.append([Row(0.0, "a")], {})
    first.close()
    second = opened(place, 60.0)
    assert second.epoch == 2
    second.close()


def test_a_lease_that_is_over_is_taken_and_cannot_be_renewed_then(place: Place) -> None:
    first = opened(place, 0.001)
    first.renew()
    kept = KeptJournal(place)
    until(lambda: kept.holding().left < 0.0)
    second = opened(place, 60.0)
    with pytest.raises(Fenced, match="another process has taken over"):
        first.renew()
    with pytest.raises(Fenced, match="another process has taken over"):
        first.append([Row(0.0, "late")], {})
    assert texts(place) == []
    for one in (first, second, kept):
        one.close()


def test_a_torn_file_loses_its_last_transaction_at_most(tmp_path: Path) -> None:
    file = opened(tmp_path / "j")
    for text in "abc":
        file.append([Row(0.0, text)], {})
    log = tmp_path / "j-wal"
    torn = log.read_bytes()[:-100]
    copy = tmp_path / "copy"
    copy.write_bytes((tmp_path / "j").read_bytes())
    (tmp_path / "copy-wal").write_bytes(torn)
    assert texts(copy) in (["a", "b"], ["a", "b", "c"])


def test_a_transaction_is_whole_or_not_there(place: Place) -> None:
    file = opened(place)
    with pytest.raises(JournalError, match="cannot be written"):
        file.append([Row(0.0, "a"), Row(1.0, "b", task=TaskRow(None, 0.0, False, ""))], {"key": "part"})  # type: ignore[arg-type]
    assert texts(place) == []
    if not isinstance(place, Path):  # a connection that something went wrong with is not used again
        with pytest.raises(JournalError, match="there is no connection to its database"):
            file.append([Row(0.0, "a")], {})
        file.renew()
    file.append([Row(0.0, "a")], {})
    assert texts(place) == ["a"]
    file.close()


def test_what_is_no_journal_is_refused_and_left_alone(tmp_path: Path) -> None:
    text, other = tmp_path / "text", tmp_path / "other"
    text.write_text("goals: {}\n" * 100, encoding="utf-8")
    with sqlite3.connect(other) as connection:
        connection.execute("CREATE TABLE t (x)")
    before = other.read_bytes()
    for path in (text, other):
        for attempt in (opened, KeptJournal):
            with pytest.raises(JournalError):
                attempt(path)
    assert other.read_bytes() == before
    with pytest.raises(JournalError, match="there is no such file"):
        KeptJournal(tmp_path / "nothing")


@pytest.mark.parametrize("version", [1, 7])
def test_a_journal_of_another_version_is_refused_by_name(tmp_path: Path, version: int) -> None:
    opened(tmp_path / "j").close()
    with sqlite3.connect(tmp_path / "j") as connection:
        connection.execute(f"PRAGMA user_version = {version}")
    with pytest.raises(JournalError, match=f"has format {version}; this version of pnm reads format {LAYOUT.version}"):
        KeptJournal(tmp_path / "j")


def test_a_journal_that_is_damaged_inside_is_an_error_that_names_it(tmp_path: Path) -> None:
    file = opened(tmp_path / "j")
    file.append([Row(0.0, "a" * 200) for _ in range(200)], {})
    file.close()
    damaged = bytearray((tmp_path / "j").read_bytes())
    for page in range(4096 * 6, len(damaged), 4096):  # beyond the schema
        damaged[page : page + 100] = b"\xff" * 100
    (tmp_path / "j").write_bytes(damaged)
    with pytest.raises(JournalError, match="j cannot be read: "):
        texts(tmp_path / "j")


def test_segments_are_dropped_by_age_with_their_parts_and_tasks_later(place: Place) -> None:
    file = opened(place)
    for day in range(1, 5):
        task = TaskRow(f"t{day}", day, True, f"task {day}")
        file.append([Row(0.0, f"begin {day}", begins=day), Row(0.0, "x" * 5000, task=task)], {f"own {day}": "", "shared": ""})
    kept = KeptJournal(place)
    file.drop(records=3.5, tasks=2.0)  # the third goes on until the fourth begins
    assert [row.text for _, row in kept.rows()] == ["begin 3", "x" * 5000, "begin 4", "x" * 5000]
    assert [row.text for _, row in kept.rows(kept.last_segment() - 1)] == ["begin 4", "x" * 5000]
    assert [kept.part(key) for key in ("own 3", "own 4", "shared")] == ["", "", ""]
    with pytest.raises(JournalError, match="own 2"):
        kept.part("own 2")
    assert [*kept.tasks()] == ["task 2", "task 3", "task 4"]
    file.close()
    kept.close()


def test_a_file_of_which_much_is_dropped_shrinks(tmp_path: Path) -> None:
    file = opened(tmp_path / "j")
    file.append([Row(0.0, "begin 1", begins=1.0), *(Row(0.0, "x" * 5000) for _ in range(100))], {})
    file.append([Row(0.0, "begin 2", begins=2.0)], {})
    file.drop(records=3.0, tasks=0.0)
    file.close()
    assert (tmp_path / "j").stat().st_size < 100_000


def test_a_database_has_several_journals_by_their_names(postgres: PostgresServer) -> None:
    url = postgres.database()
    one, other = place_of(url), place_of(f"{url}?name=cell1")
    with pytest.raises(JournalError, match="there is no journal"):
        KeptJournal(one)
    first, second = opened(one, 60.0), opened(other, 60.0)
    first.append([Row(0.0, "a")], {"key": "part"})
    second.append([Row(0.0, "b")], {"key": "other part"})
    assert (texts(one), texts(other)) == (["a"], ["b"])
    first.close()
    second.close()


def test_a_server_that_is_not_there_is_an_error_in_time_that_shows_no_password() -> None:
    with pytest.raises(JournalError, match=r"the journal postgresql://127.0.0.1:1/fleet\?name=pnm cannot be opened: .*refused"):
        opened(place_of("postgresql://pnm:secret@127.0.0.1:1/fleet"))
