"""SQLite files as databases of ours."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from time import monotonic, sleep
from typing import TYPE_CHECKING, Final

from pnm.files.database.driver import DatabaseError, Layout, Rows, check_version

if TYPE_CHECKING:
    from sqlalchemy.engine import Dialect

LIMIT: Final = 4.0
"""Seconds to wait while another process writes."""
_AGAIN: Final = 0.02
"""Seconds until a retry of an operation for which SQLite itself does not wait."""


class Sqlite:
    """An SQLite file, in WAL mode: others may read while one writes."""

    survives = True

    def __init__(self, path: Path, *, read_only: bool, is_durable: bool) -> None:
        if path.exists() and not path.is_file():
            raise DatabaseError("it is no file")
        if read_only and not path.exists():
            raise DatabaseError("there is no such file")
        self.dialect = _dialect()
        uri = f"{path.absolute().as_uri()}{'?mode=ro' if read_only else ''}"
        self._connection = sqlite3.connect(uri, uri=True, timeout=0.0, isolation_level=None, check_same_thread=False)
        self._synchronous = "FULL" if is_durable else "NORMAL"

    def run(self, sql: str, values: Mapping[str, object], /) -> Rows:
        """Execute a statement with ``:name`` parameters."""
        return self._connection.execute(sql, values).fetchall()

    def run_many(self, sql: str, rows: Sequence[Mapping[str, object]], /) -> None:
        """Execute a statement for each row."""
        self._connection.executemany(sql, rows)

    def begin(self) -> None:
        """Begin a transaction that writes."""
        self._connection.execute("BEGIN IMMEDIATE")

    def prepare(self, layout: Layout, ddl: Sequence[str], *, read_only: bool) -> None:
        """Make the tables unless they are there; refuse those of something else or of another version."""
        _patiently(partial(self._prepare, layout, ddl, read_only=read_only))
        self._connection.execute(f"PRAGMA busy_timeout = {LIMIT * 1000:.0f}")

    def _prepare(self, layout: Layout, ddl: Sequence[str], *, read_only: bool) -> None:
        self._connection.execute(f"PRAGMA synchronous = {self._synchronous}")
        if self._number("application_id") != layout.application:
            if read_only or self._connection.execute("SELECT count(*) FROM sqlite_schema").fetchone()[0]:
                raise DatabaseError("it is a database of something else")
            self._connection.execute("PRAGMA auto_vacuum = INCREMENTAL")
            self._connection.execute("PRAGMA journal_mode = WAL")
            with self._connection:
                self.begin()
                if self._number("application_id") != layout.application:  # unless another process was quicker
                    for table in ddl:
                        self._connection.execute(table)
                    self._connection.execute(f"PRAGMA application_id = {layout.application}")
                    self._connection.execute(f"PRAGMA user_version = {layout.version}")
        check_version(layout, self._number("user_version"))

    def wait(self, seconds: float) -> None:
        """Wait for so long: nothing is announced in a file."""
        sleep(seconds)

    def announce(self) -> None:
        """Do nothing: nobody hears it."""

    def shrink(self) -> None:
        """Give space back that is not needed any more."""
        self._connection.executescript("PRAGMA incremental_vacuum")  # which frees one page only when it is executed by itself

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()

    def _number(self, pragma: str) -> int:
        return int(self._connection.execute(f"PRAGMA {pragma}").fetchone()[0])


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


@cache  # statements are compiled once for each
def _dialect() -> Dialect:
    from sqlalchemy.dialects.sqlite import dialect  # here, because it takes 0.15 s

    return dialect(paramstyle="named")
