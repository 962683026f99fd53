"""Global knowledge in a SQLite file, which several processes may share."""

from __future__ import annotations

import sqlite3
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from uuid import UUID

import pytest
from pg8000.native import Connection

from pnm.core.logic.computed_values import MISSING
from pnm.files.database import sqlite as sqlite_driver
from pnm.files.database.database import Database
from pnm.files.database.place import Place, place_of
from pnm.files.database.postgres import MAKING
from pnm.knowledge.source import Asker, SourceError
from pnm.knowledge.sources import LAYOUT, DatabaseKnowledge, default_path
from tests.support.e2e.hosts.postgres import PostgresServer
from tests.support.logic.people import about, run_questions
from tests.support.processes import until

ME = Asker(UUID(int=7), "tour")


async def stored(knowledge: DatabaseKnowledge, **values: object) -> None:
    for name, value in values.items():
        await knowledge.update(about(name), value, ME)


async def values_in(path: Place, *names: str) -> list[object]:
    knowledge = DatabaseKnowledge(path)
    try:
        return [await knowledge.query(about(name), ME) for name in names]
    finally:
        await knowledge.close()


def test_what_is_stored_is_there_later(place: Place) -> None:
    file = place / "new" / "folder" / "kb.sqlite" if isinstance(place, Path) else place

    async def main() -> None:
        knowledge = DatabaseKnowledge(file)
        await stored(knowledge, a=1, b={"x": [None, "ü"]}, c=False)
        await stored(knowledge, a=2, d=1)
        await stored(knowledge, d=None, e=None)
        await knowledge.close()
        await knowledge.close()
        with pytest.raises(SourceError, match="is closed"):
            await knowledge.query(about("a"), ME)

    run_questions(main())
    assert run_questions(values_in(file, "a", "b", "c", "d", "e")) == [2, {"x": [None, "ü"]}, False, MISSING, MISSING]


def corrupt(path: Path) -> None:
    path.write_bytes(b"not a database at all" * 100)


async def fill(path: Path) -> None:
    knowledge = DatabaseKnowledge(path)
    await stored(knowledge, **{f"name{number}": "x" * 500 for number in range(20)})
    await knowledge.close()


def foreign_database(path: Path) -> None:
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE variables (name TEXT)")
    connection.close()


@pytest.mark.parametrize(
    ("spoil", "said"),
    [(corrupt, "file is not a database"), (foreign_database, "a database of something else"), (Path.mkdir, "it is no file")],
)
def test_a_file_that_is_no_knowledge_is_an_error_and_left_as_it_is(tmp_path: Path, spoil: Any, said: str) -> None:
    file = tmp_path / "kb.sqlite"
    spoil(file)
    before = file.read_bytes() if file.is_file() else b""
    with pytest.raises(SourceError, match=f"the knowledge in {file} cannot be used: .*{said}"):
        run_questions(values_in(file, "name19"))
    assert (file.read_bytes() if file.is_file() else b"") == before


def test_after_an_error_the_file_is_tried_again(tmp_path: Path) -> None:
    file = tmp_path / "kb.sqlite"
    corrupt(file)

    async def main() -> object:
        knowledge = DatabaseKnowledge(file)
        with pytest.raises(SourceError):
            await knowledge.query(about("a"), ME)
        file.unlink()
        await stored(knowledge, a=1)
        found = await knowledge.query(about("a"), ME)
        await knowledge.close()
        return found

    assert run_questions(main()) == 1


def test_a_file_that_somebody_keeps_locked_is_an_error_in_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sqlite_driver, "LIMIT", 0.2)
    file = tmp_path / "kb.sqlite"
    run_questions(fill(file))
    holder = sqlite3.connect(file, isolation_level=None)
    holder.execute("BEGIN EXCLUSIVE")

    async def main() -> None:
        knowledge = DatabaseKnowledge(file)
        assert await knowledge.query(about("name1"), ME) == "x" * 500, "reading does not wait for who writes"
        with pytest.raises(SourceError, match="database is locked"):
            await stored(knowledge, a=1)
        await knowledge.close()

    run_questions(main())
    holder.close()


def test_a_file_that_another_process_is_just_making_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "kb.sqlite"
    other = sqlite3.connect(file, isolation_level=None, check_same_thread=False)
    other.execute("BEGIN IMMEDIATE")
    waited: list[float] = []

    def pause(seconds: float) -> None:
        waited.append(seconds)
        other.execute("ROLLBACK")

    monkeypatch.setattr(sqlite_driver, "sleep", pause)
    assert run_questions(values_in(file, "a")) == [MISSING]
    assert len(waited) == 1
    other.close()


WRITER = """
import asyncio, sys
from uuid import UUID
from pnm.core.logic.computed_values import Layer, Question
from pnm.knowledge.source import Asker
from pnm.files.database.place import place_of
from pnm.knowledge.sources import DatabaseKnowledge

async def main(file, name, count):
    knowledge = DatabaseKnowledge(place_of(file))
    for number in range(int(count)):
        await knowledge.update(Question(f"{name}{number}", Layer.GLOBAL, "null"), number, Asker(UUID(int=1)))
        print(number, flush=True)
    await knowledge.close()

asyncio.run(main(*sys.argv[1:]))
"""


def writer(file: Path | str, name: str, count: int) -> subprocess.Popen[str]:
    return subprocess.Popen([sys.executable, "-c", WRITER, str(file), name, str(count)], stdout=subprocess.PIPE, text=True)


def test_what_was_acknowledged_survives_sigkill(tmp_path: Path) -> None:
    file = tmp_path / "kb.sqlite"
    process = writer(file, "a", 1_000_000)
    assert process.stdout is not None
    for _ in range(30):
        process.stdout.readline()
    process.kill()
    rest, _ = process.communicate(timeout=30.0)
    acknowledged = 30 + len([line for line in rest.splitlines(keepends=True) if line.endswith("\n")])
    assert run_questions(values_in(file, *(f"a{number}" for number in range(acknowledged)))) == list(range(acknowledged))


def test_processes_write_at_the_same_time_where_nothing_is_yet(place: Place) -> None:
    processes = [writer(place if isinstance(place, Path) else place.text, name, 20) for name in "abcd"]
    for process in processes:
        process.communicate(timeout=60.0)
    assert [process.returncode for process in processes] == [0, 0, 0, 0]
    names = [f"{name}{number}" for name in "abcd" for number in range(20)]
    assert run_questions(values_in(place, *names)) == [number for _ in "abcd" for number in range(20)]


def test_tables_that_others_have_just_made_are_not_made_again(postgres: PostgresServer) -> None:
    url = postgres.database()
    place = place_of(url)
    with (
        Connection("pnm", host=postgres.address, port=postgres.port, database=url.rpartition("/")[2]) as first,
        ThreadPoolExecutor() as others,
    ):
        first.run("SELECT pg_advisory_lock(:key)", key=MAKING)
        opened = [others.submit(Database, place, LAYOUT) for _ in range(3)]
        waiting = "SELECT count(*) FROM pg_locks WHERE locktype = 'advisory' AND NOT granted"
        until(lambda: first.run(waiting)[0][0] == len(opened) or any(one.done() for one in opened))
        first.run("SELECT pg_advisory_unlock(:key)", key=MAKING)
        for one in opened:
            one.result().close()


def test_where_knowledge_is_kept_by_default(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", "/state")
    assert default_path() == Path("/state/pnm/knowledge.sqlite")
    monkeypatch.setenv("XDG_STATE_HOME", "relative")
    monkeypatch.setenv("HOME", "/home/me")
    assert default_path() == Path("/home/me/.local/state/pnm/knowledge.sqlite")
