"""Journal files: what they refuse, who may write, and what is left of a transaction that did not come to its end."""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import Any

import pytest

from pnm.files.database.place import Place, place_of
from pnm.journal.kept import Fenced, JournalChoice, JournalError, Row, TaskRow
from pnm.journal.lease import take
from pnm.journal.store import JournalFile, KeptJournal
from pnm.journal.tables import LAYOUT
from tests.support.e2e.hosts.postgres import PostgresServer
from tests.support.processes import until


def opened(place: Place, lease: float | None = None) -> JournalFile:
    return JournalFile(place, 0.0, lease)


def texts(place: Place) -> list[str]:
    kept = KeptJournal(place)
    rows = [row.text for _, row in kept.rows()]
    kept.close()
    return rows


def test_what_was_committed_is_there_also_if_it_is_long_and_parts_are_kept_once(place: Place) -> None:
    file = opened(place)
    file.append([Row(float(number), str(number)) for number in range(1200)], {"key": "part"})
    file.append([Row(0.0, "c")], {"key": "part"})
    kept = KeptJournal(place)
    assert list(kept.rows(after=1199)) == [(1200, Row(1199.0, "1199")), (1201, Row(0.0, "c"))]
    assert texts(place) == [*map(str, range(1200)), "c"]
    assert kept.part("key") == "part"
    with pytest.raises(JournalError, match="names the part other, which is not there"):
        kept.part("other")
    file.close()
    kept.close()


@pytest.mark.parametrize(
    ("is_durable", "in_sqlite", "in_postgres"),
    [(False, 1, "off"), (True, 2, "on"), (None, 1, "on")],
    ids=["process", "power", "not chosen"],
)
def test_with_power_loss_or_by_default_on_a_server_every_commit_is_on_the_disk(
    place: Place, is_durable: bool | None, in_sqlite: int, in_postgres: str
) -> None:
    file, hold = take(JournalChoice(place, is_durable))
    asked, answer = ("PRAGMA synchronous", in_sqlite) if isinstance(place, Path) else ("SHOW synchronous_commit", in_postgres)
    driver: Any = file._database._driver
    assert [list(row) for row in driver.run(asked, {})] == [[answer]]
    hold.release()
    file.close()


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


def test_segments_are_dropped_by_age_with_their_parts_and_tasks_later(place: Place) -> None:
    file = opened(place)
    for day in range(1, 5):
        task = TaskRow(f"t{day}", day, True, f"task {day}")
        file.append([Row(0.0, f"begin {day}", begins=day), Row(0.0, "x" * 50_000, task=task)], {f"own {day}": "", "shared": ""})
    kept = KeptJournal(place)
    file.drop(records=3.5, tasks=2.0)  # the third goes on until the fourth begins
    assert [row.text for _, row in kept.rows()] == ["begin 3", "x" * 50_000, "begin 4", "x" * 50_000]
    assert [row.text for _, row in kept.rows(kept.last_segment() - 1)] == ["begin 4", "x" * 50_000]
    assert [kept.part(key) for key in ("own 3", "own 4", "shared")] == ["", "", ""]
    with pytest.raises(JournalError, match="own 2"):
        kept.part("own 2")
    assert [*kept.tasks()] == ["task 2", "task 3", "task 4"]
    file.close()
    kept.close()
    assert not isinstance(place, Path) or place.stat().st_size < 170_000, "its space was given back"


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
