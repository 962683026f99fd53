"""SQLite files as databases of ours."""

from __future__ import annotations

import os
import re
import sqlite3
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from math import inf
from pathlib import Path
from time import monotonic, sleep
from typing import Final, TypeVar

from pnm.files.database.driver import NOW, SIZE, DamagedDatabase, DatabaseError, Driver, Layout, OperationLimit, Rows, check_version
from pnm.files.database.lock import lock_of
from pnm.files.text import private_file

T = TypeVar("T")

LIMIT: Final = 4.0
"""Seconds to wait while another process writes."""
_AGAIN: Final = 0.02
"""Seconds until a retry of an operation for which SQLite itself does not wait."""
_SLOW: Final = 4 * 1024 * 1024
"""Bytes of a file that the slowest disk reads or writes in a second."""
_PAGES: Final = 256
"""Pages that are given back to the file system at once."""
_SHRINKING: Final = 0.5
"""Seconds for which that goes on: nothing else is done meanwhile, and what is left is used again, or given back the next time."""
_NOW: Final = "((julianday('now') - 2440587.5) * 86400.0)"
_LOCKS: Final = re.compile(r" FOR (UPDATE|SHARE)\b.*")
"""The lock of rows, where a transaction that writes has not locked all of a file."""
_DAMAGE: Final = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
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


class Sqlite(Driver):
    """An SQLite file, in WAL mode: others may read while one writes.

    A file may be hostile: nothing but tables is read, and SQLite looks in between whether it may go on.
    """

    survives = True

    def __init__(self, path: Path, limit: OperationLimit, *, read_only: bool, is_durable: bool) -> None:
        if path.exists() and not path.is_file():
            raise DatabaseError("it is no file")
        if not path.exists() and has_log(path):  # which SQLite would delete
            raise DatabaseError(f"there is only {log_of(path).name}, with the last records; expected {path.name} beside it")
        if read_only and not path.exists():
            raise DatabaseError("there is no such file")
        if not read_only:
            private_file(path)  # the files beside it get the same mode
        self._path = path
        self._identities: dict[str, tuple[int, int]] = {}
        """The files that are written; as texts, for these are looked at often."""
        uri = f"{path.absolute().as_uri()}{'?mode=ro' if read_only else ''}"
        self._connection = sqlite3.connect(uri, uri=True, timeout=0.0, isolation_level=None, check_same_thread=False)
        self._connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, SIZE)
        self._connection.set_progress_handler(lambda: limit.is_over, _STEPS)
        self._limit = limit
        self._synchronous = "FULL" if is_durable else "NORMAL"

    @staticmethod
    def said(error: Exception) -> DatabaseError:
        """Return SQLite's words; only what it calls damaged is not what was written, and never will be."""
        is_damage = getattr(error, "sqlite_errorcode", 0) & 0xFF in _DAMAGE
        return (DamagedDatabase if is_damage else DatabaseError)(str(error) or type(error).__name__)

    def run(self, sql: str, values: Mapping[str, object], /) -> Rows:
        """Execute a statement with ``:name`` parameters."""
        return self._within(lambda: self._limit.take_rows(self._connection.execute(_spelled(sql), values)))

    def run_many(self, sql: str, rows: Sequence[Mapping[str, object]], /) -> None:
        """Execute a statement for each row."""
        self._within(lambda: self._connection.executemany(_spelled(sql), rows))

    def _within(self, work: Callable[[], T]) -> T:
        """Do some work within the limit; raise `KeyboardInterrupt` for a signal, which SQLite swallows while it looks if it may go on."""
        try:
            return work()
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode == sqlite3.SQLITE_INTERRUPT and not self._limit.exceeded:
                raise KeyboardInterrupt from error
            raise

    def begin(self, *, is_durable: bool) -> None:
        """Begin a transaction that writes; all are as durable as the file was opened to be."""
        self._connection.execute("BEGIN IMMEDIATE")

    def prepare(self, layout: Layout | None, *, read_only: bool) -> None:
        """Make the tables unless they are there; refuse those of something else or of another version."""
        until, is_prepared = monotonic() + LIMIT, layout is None
        while layout is not None and not is_prepared:
            try:
                self._within(partial(self._prepare, layout, read_only=read_only))
                is_prepared = True
            except sqlite3.OperationalError as error:  # SQLite does not wait by itself while its journal mode is being changed
                if "locked" not in str(error) or monotonic() >= until:
                    raise
                sleep(_AGAIN)
        self._connection.execute(f"PRAGMA busy_timeout = {LIMIT * 1000:.0f}")
        if not read_only:
            self._identities = {os.fspath(file): _identity(os.fspath(file)) for file in files_of(self._path) if file.exists()}

    def _prepare(self, layout: Layout, *, read_only: bool) -> None:
        self._connection.execute(f"PRAGMA synchronous = {self._synchronous}")
        if self._number("application_id") != layout.application:
            if read_only or self._connection.execute("SELECT count(*) FROM sqlite_schema").fetchone()[0]:
                raise DatabaseError("it is a database of something else")
            self._connection.execute("PRAGMA auto_vacuum = INCREMENTAL")
            self._connection.execute("PRAGMA journal_mode = WAL")
            with self._connection:
                self.begin(is_durable=False)
                if self._number("application_id") != layout.application:  # unless another process was quicker
                    for table in layout.tables:
                        self._connection.execute(_spelled(table))
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

    def shrink(self) -> None:
        """Give space back that is not needed any more, in steps, each of which is kept."""
        until, free, left = monotonic() + _SHRINKING, inf, self._number("freelist_count")
        while 0 < left < free and monotonic() < until:
            self._limit.begin()
            # by `execute` alone, one page would be freed
            self._within(lambda: self._connection.executescript(f"PRAGMA incremental_vacuum({_PAGES})"))
            free, left = left, self._number("freelist_count")

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
        """Raise `DamagedDatabase` if the structure of the file is damaged."""
        found = self._throughout("PRAGMA quick_check(1)")[0][0]
        if found != "ok":
            raise DamagedDatabase(f"it is damaged: {found}")

    def gather(self) -> None:
        """Write the log back to the file, as far as nobody reads what was there before."""
        self._connection.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchone()

    def gather_all(self) -> None:
        """Write the log back to the file; raise `DatabaseError` if another process reads what was there before."""
        self._throughout("PRAGMA wal_checkpoint(TRUNCATE)")
        if has_log(self._path):
            raise DatabaseError("another process reads it; expected none")

    def copy(self, to: Path) -> None:
        """Make one file with all that has been committed, also while another process writes; it is on the disk, or not there at all."""
        to.touch(0o600, exist_ok=False)
        try:
            self._throughout("VACUUM INTO :to", to=str(to))
            for path in (to, to.parent):  # its content, and its name in the folder
                file = os.open(path, os.O_RDONLY)
                try:
                    os.fsync(file)
                finally:
                    os.close(file)
        except BaseException:
            to.unlink()
            raise

    def _throughout(self, sql: str, **values: object) -> Rows:
        """Execute what goes through the whole file, and may take as long as that does; return its rows."""
        self._limit.begin(sum(file.stat().st_size for file in files_of(self._path) if file.exists()) / _SLOW)
        return self.run(sql, values)

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()

    def _number(self, pragma: str) -> int:
        return int(self._connection.execute(f"PRAGMA {pragma}").fetchone()[0])


def _identity(file: str) -> tuple[int, int]:
    found = os.stat(file)
    return found.st_dev, found.st_ino


@cache
def _spelled(sql: str) -> str:
    """Return a statement with the words that SQLite has; statements are constants, so there are few."""
    return _LOCKS.sub("", sql.replace("BIGINT", "INTEGER").replace(NOW, _NOW))
