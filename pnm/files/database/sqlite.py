"""SQLite files as databases of ours."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from time import monotonic, sleep
from typing import TYPE_CHECKING, Final, TypeVar

from pnm.files.database.driver import DatabaseError, Layout, Rows, check_version
from pnm.files.database.limit import SIZE, OperationLimit
from pnm.files.database.lock import lock_of
from pnm.files.private import private_file

if TYPE_CHECKING:
    from sqlalchemy.engine import Dialect

T = TypeVar("T")

LIMIT: Final = 4.0
"""Seconds to wait while another process writes."""
_AGAIN: Final = 0.02
"""Seconds until a retry of an operation for which SQLite itself does not wait."""
_STEPS: Final = 100_000
"""Steps of SQLite's machine, some milliseconds, until it is looked whether it may go on; signals are heard then as well."""


def log_of(path: Path) -> Path:
    """Return the write-ahead log of a file: what was committed last is there alone while the file is in use, or its process was killed."""
    return path.with_name(f"{path.name}-wal")


def files_of(path: Path) -> tuple[Path, ...]:
    """Return the files of a database, which belong together as long as it is in use."""
    return path, log_of(path), path.with_name(f"{path.name}-shm"), lock_of(path)


def has_log(path: Path) -> bool:
    """Return whether there is something in the write-ahead log of a file."""
    log = log_of(path)
    return log.exists() and log.stat().st_size > 0


class Sqlite:
    """An SQLite file, in WAL mode: others may read while one writes.

    A file may be hostile: nothing but tables is read, and SQLite looks in between whether it may go on.
    """

    survives = True

    def __init__(self, path: Path, limit: OperationLimit, *, read_only: bool, is_durable: bool) -> None:
        if path.exists() and not path.is_file():
            raise DatabaseError("it is no file")
        if not path.exists() and has_log(path):  # which SQLite would delete
            raise DatabaseError(f"there is only {log_of(path).name}, with what was written last; expected {path.name} beside it")
        if read_only and not path.exists():
            raise DatabaseError("there is no such file")
        if not read_only:
            private_file(path)  # the files beside it get the same mode
        self._path = path
        self._identities: dict[str, tuple[int, int]] = {}
        """The files that are written; as texts, for these are looked at often."""
        self.dialect = _dialect()
        uri = f"{path.absolute().as_uri()}{'?mode=ro' if read_only else ''}"
        self._connection = sqlite3.connect(uri, uri=True, timeout=0.0, isolation_level=None, check_same_thread=False)
        self._connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, SIZE)
        self._connection.set_progress_handler(lambda: limit.is_over, _STEPS)
        self._limit = limit
        self._synchronous = "FULL" if is_durable else "NORMAL"

    def run(self, sql: str, values: Mapping[str, object], /) -> Rows:
        """Execute a statement with ``:name`` parameters."""
        return self._within(lambda: self._limit.take_rows(self._connection.execute(sql, values)))

    def run_many(self, sql: str, rows: Sequence[Mapping[str, object]], /) -> None:
        """Execute a statement for each row."""
        self._within(lambda: self._connection.executemany(sql, rows))

    def _within(self, work: Callable[[], T]) -> T:
        """Do some work within the limit.

        Raises:
            KeyboardInterrupt: a signal came meanwhile; SQLite swallows what is raised while it looks whether it may go on.
        """
        try:
            return work()
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode == sqlite3.SQLITE_INTERRUPT and not self._limit.exceeded:
                raise KeyboardInterrupt from error
            raise

    def begin(self, *, is_durable: bool) -> None:
        """Begin a transaction that writes; all are as durable as the file was opened to be."""
        self._connection.execute("BEGIN IMMEDIATE")

    def prepare(self, layout: Layout, ddl: Sequence[str], *, read_only: bool) -> None:
        """Make the tables unless they are there; refuse those of something else or of another version."""
        self._within(partial(_patiently, partial(self._prepare, layout, ddl, read_only=read_only)))
        self._connection.execute(f"PRAGMA busy_timeout = {LIMIT * 1000:.0f}")
        if not read_only:
            self._identities = {os.fspath(file): _identity(os.fspath(file)) for file in files_of(self._path) if file.exists()}

    def _prepare(self, layout: Layout, ddl: Sequence[str], *, read_only: bool) -> None:
        self._connection.execute(f"PRAGMA synchronous = {self._synchronous}")
        if self._number("application_id") != layout.application:
            if read_only or self._connection.execute("SELECT count(*) FROM sqlite_schema").fetchone()[0]:
                raise DatabaseError("it is a database of something else")
            self._connection.execute("PRAGMA auto_vacuum = INCREMENTAL")
            self._connection.execute("PRAGMA journal_mode = WAL")
            with self._connection:
                self.begin(is_durable=False)
                if self._number("application_id") != layout.application:  # unless another process was quicker
                    for table in ddl:
                        self._connection.execute(table)
                    self._connection.execute(f"PRAGMA application_id = {layout.application}")
                    self._connection.execute(f"PRAGMA user_version = {layout.version}")
        check_version(layout, self._number("user_version"))
        # Views and triggers have no pages, and compute, which may never end; nor have tables of other programs' modules.
        if self._connection.execute("SELECT count(*) FROM sqlite_schema WHERE rootpage = 0").fetchone()[0]:
            raise DatabaseError(f"it has more than the tables of a {layout.kind}")
        if not read_only:
            self._connection.execute("PRAGMA journal_mode = WAL")  # a copy has another one

    def wait(self, seconds: float, process: str) -> None:
        """Wait for so long: nothing is announced in a file."""
        sleep(seconds)

    def waiting(self) -> tuple[str, ...]:
        """Return nothing: a file does not show it."""
        return ()

    def announce(self) -> None:
        """Do nothing: nobody hears it."""

    def shrink(self) -> None:
        """Give space back that is not needed any more."""
        self._within(
            lambda: self._connection.executescript("PRAGMA incremental_vacuum")
        )  # which frees one page only when it is executed by itself

    def look(self) -> None:
        """Raise a `DatabaseError` if a file that is written is not there any more, or is another one."""
        for file, identity in self._identities.items():
            try:
                if _identity(file) == identity:
                    continue
            except OSError:
                raise DatabaseError(f"{Path(file).name} is not there any more: it was deleted or moved") from None
            raise DatabaseError(f"{Path(file).name} is not the file any more that is written: it was replaced")

    def check(self) -> None:
        """Raise a `DatabaseError` if the structure of the file is damaged."""
        found = self._within(lambda: self._connection.execute("PRAGMA quick_check(1)").fetchone()[0])
        if found != "ok":
            raise DatabaseError(f"it is damaged: {found}")

    def gather(self) -> None:
        """Write the log back to the file, as far as nobody reads what was there before."""
        self._connection.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchone()

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()

    def _number(self, pragma: str) -> int:
        return int(self._connection.execute(f"PRAGMA {pragma}").fetchone()[0])


def _identity(file: str) -> tuple[int, int]:
    found = os.stat(file)
    return found.st_dev, found.st_ino


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
