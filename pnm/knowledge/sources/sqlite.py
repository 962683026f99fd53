"""Global knowledge in a file: shared by runs and by processes, and still there after all of them.

SQLite keeps its promises when a process is killed, and lets others read while one writes (WAL). A value is stored,
on the disk, before `update` returns.
"""

from __future__ import annotations

import asyncio
import os
import sqlite3
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from time import monotonic, sleep, time
from typing import Final, TypeVar

from pnm.core.logic.computed_values import MISSING, Question
from pnm.knowledge.sources.memory import read_value, write_value
from pnm.knowledge.sources.source import Asker, SourceError

LIMIT: Final = 4.0
"""Seconds to wait while another process writes."""
_APPLICATION: Final = 0x504E4D4B
"""Marks the file as ours: PNMK."""
_VERSION: Final = 1
_TABLE: Final = (
    "CREATE TABLE IF NOT EXISTS variables (name TEXT PRIMARY KEY, value TEXT NOT NULL, changed REAL NOT NULL, run TEXT NOT NULL)"
)
_STORE: Final = (
    "INSERT INTO variables VALUES (?, ?, ?, ?)"
    " ON CONFLICT (name) DO UPDATE SET value = excluded.value, changed = excluded.changed, run = excluded.run"
)
_AGAIN: Final = 0.02
"""Seconds until a retry of an operation for which SQLite itself does not wait."""

T = TypeVar("T")


def default_path() -> Path:
    """Return the default path of the global knowledge; raise `SourceError` if the user has no home."""
    state = os.environ.get("XDG_STATE_HOME", "")
    try:
        folder = Path(state) if Path(state).is_absolute() else Path.home() / ".local" / "state"
    except RuntimeError as error:
        raise SourceError(f"there is no place for the global knowledge: {error}; name a file") from error
    return folder / "pnm" / "knowledge.sqlite"


class SqliteKnowledge:
    """Variables in an SQLite file, by default at `default_path`, which is made with its folder when it is first needed.

    All work is done on one thread, which has the connection; it is the mutable state.
    """

    def __init__(self, path: Path | None = None) -> None:
        self.path = default_path() if path is None else path
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="knowledge")
        self._connection: sqlite3.Connection | None = None
        self._closed = False

    def __repr__(self) -> str:
        return f"<SqliteKnowledge {self.path}>"

    async def query(self, question: Question, asker: Asker, /) -> object:
        """Return the value, or `MISSING`."""
        return await self._on_thread(partial(self._read, question.name))

    async def update(self, question: Question, value: object, asker: Asker, /) -> None:
        """Store the value on the disk; one that is set to None is forgotten."""
        work = partial(self._write, question.name, write_value(value), str(asker.run))
        await self._on_thread(work if value is not None else partial(self._forget, question.name))

    async def close(self) -> None:
        """Close the file when everything that was asked for is done."""
        if not self._closed:
            done = asyncio.get_running_loop().run_in_executor(self._thread, self._close)
            self._closed = True
            self._thread.shutdown(wait=False)
            await done

    async def _on_thread(self, work: Callable[[], T]) -> T:
        if self._closed:
            raise SourceError(f"{self.path} is closed")
        return await asyncio.get_running_loop().run_in_executor(self._thread, self._translated, work)

    # on the thread

    def _translated(self, work: Callable[[], T]) -> T:
        try:
            return work()
        except (sqlite3.Error, OSError, ValueError) as error:
            self._close()  # the next one opens it anew: it may have been replaced, or its disk have space again
            raise SourceError(f"the knowledge in {self.path} cannot be used: {error}") from error

    def _read(self, name: str) -> object:
        row = self._open().execute("SELECT value FROM variables WHERE name = ?", (name,)).fetchone()
        return MISSING if row is None else read_value(str(row[0]))

    def _write(self, name: str, value: str, run: str) -> None:
        self._open().execute(_STORE, (name, value, time(), run))

    def _forget(self, name: str) -> None:
        self._open().execute("DELETE FROM variables WHERE name = ?", (name,))

    def _open(self) -> sqlite3.Connection:
        if self._connection is None:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._connection = sqlite3.connect(self.path, timeout=LIMIT, isolation_level=None)
            _patiently(partial(_prepare, self._connection))
        return self._connection

    def _close(self) -> None:
        if self._connection is not None:
            self._connection.close()
            self._connection = None


def _prepare(connection: sqlite3.Connection) -> None:
    """Initialise a new file, and refuse the database of another application or of a later version."""
    connection.execute("PRAGMA synchronous = FULL")
    if _number(connection, "application_id") != _APPLICATION:
        if connection.execute("SELECT count(*) FROM sqlite_schema").fetchone()[0]:
            raise ValueError("it is a database of something else")
        connection.execute("PRAGMA journal_mode = WAL")
        with connection:
            connection.execute("BEGIN IMMEDIATE")
            connection.execute(_TABLE)  # unless another process was quicker
            connection.execute(f"PRAGMA application_id = {_APPLICATION}")
            connection.execute(f"PRAGMA user_version = {_VERSION}")
    if _number(connection, "user_version") > _VERSION:
        raise ValueError("it was written by a later version of this program")


def _number(connection: sqlite3.Connection, pragma: str) -> int:
    return int(connection.execute(f"PRAGMA {pragma}").fetchone()[0])


def _patiently(work: Callable[[], None]) -> None:
    """Retry while another process has the file: SQLite does not wait by itself while its journal mode is being changed."""
    until = monotonic() + LIMIT
    while True:
        try:
            return work()
        except sqlite3.OperationalError as error:
            if "locked" not in str(error) or monotonic() >= until:
                raise
            sleep(_AGAIN)
