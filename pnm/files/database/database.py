"""Databases of ours: an SQLite file, or tables in PostgreSQL, by the same statements.

A driver executes them, in transactions that begin and end here. A library that puts itself in between, with its pools and types, would
make each commit take several times as long.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import TypeVar

from pnm.errors import PnmError
from pnm.files.database.driver import DamagedDatabase, DatabaseError, Layout, OperationLimit, Rows, SqlQuery
from pnm.files.database.lock import FileLock
from pnm.files.database.place import Place
from pnm.files.database.postgres import Postgres
from pnm.files.database.sqlite import Sqlite, files_of

T = TypeVar("T")


class Database:
    """A connection to a database of ours, which is opened anew when it was lost. To be used by one thread at a time.

    Every operation has a limit of time and size, see `OperationLimit`.

    Args:
        place: of it; a file is made if there is none.
        layout: its tables, made if there are none; None for a file that is taken as it is.
        read_only: whether it must be there, and is not written.
        is_durable: whether commits survive that the computer of the database dies.

    The mutable state is the connection.

    Raises:
        DatabaseError: it cannot be opened, or has something else.
    """

    def __init__(self, place: Place, layout: Layout | None, *, read_only: bool = False, is_durable: bool = False) -> None:
        self.place = place
        self._layout = layout
        self._read_only = read_only
        self._is_durable = is_durable
        self._driver: Sqlite | Postgres | None = None
        self._limit = OperationLimit()
        self._kind: type[Sqlite | Postgres] = Sqlite if isinstance(place, Path) else Postgres
        self.connect()

    @property
    def is_connected(self) -> bool:
        """Whether there is a connection, as far as is known."""
        return self._driver is not None

    def connect(self) -> None:
        """Open the connection unless it is open."""

        def opened() -> Sqlite | Postgres:
            place, how = self.place, {"read_only": self._read_only, "is_durable": self._is_durable}
            driver = Sqlite(place, self._limit, **how) if isinstance(place, Path) else Postgres(place, self._limit, **how)
            try:
                driver.prepare(self._layout, read_only=self._read_only)
            except BaseException:
                driver.close()
                raise
            return driver

        if self._driver is None:
            self._driver = self._translated(opened)

    def run(self, sql: str, **values: object) -> Rows:
        """Execute a statement, in the transaction if there is one; return its rows."""
        return self._translated(lambda: self._connected().run(sql, values))

    def read(self, query: SqlQuery, **values: object) -> Rows:
        """Return the rows of a query; raise `DamagedDatabase` if they have values that nobody writes there."""
        rows = self.run(query.sql, **values)
        if any(tuple(map(type, row)) != query.columns for row in rows):
            raise DamagedDatabase("it has values of another type than were written")
        return rows

    def run_many(self, sql: str, rows: Sequence[Mapping[str, object]]) -> None:
        """Execute a statement for each row."""
        if rows:
            self._translated(lambda: self._connected().run_many(sql, rows))

    def do(self, work: Callable[[Sqlite | Postgres], T]) -> T:
        """Return the result of the driver."""
        return self._translated(lambda: work(self._connected()))

    @contextmanager
    def transaction(self, *, is_new: bool = True, is_durable: bool = False) -> Iterator[None]:
        """Commit everything inside at the end, or nothing after an error.

        Args:
            is_new: whether a connection that was lost is opened anew for it, which takes its time.
            is_durable: whether it, and all before it, survive that the computer of a server dies, also where others do not.
        """
        if is_new:
            self.connect()
        if (driver := self._driver) is None:
            raise DatabaseError("there is no connection")
        self._translated(lambda: driver.begin(is_durable=is_durable))
        try:
            yield
            if self._driver is not driver:
                raise DatabaseError("its connection was lost")
            self._translated(lambda: driver.run("COMMIT", {}))
        except BaseException:
            if self._driver is not None:
                with suppress(DatabaseError):
                    self._translated(lambda: driver.run("ROLLBACK", {}))
            raise

    def close(self) -> None:
        """Close the connection."""
        if (driver := self._driver) is not None:
            with suppress(DatabaseError):
                self._translated(driver.close)
            self._driver = None

    def _connected(self) -> Sqlite | Postgres:
        self.connect()
        assert self._driver is not None
        return self._driver

    def _translated(self, work: Callable[[], T]) -> T:
        """Do something within the limit of an operation; errors are a `DatabaseError`, and end a connection that does not survive them."""
        self._limit.begin()
        try:
            return work()
        except PnmError:
            raise
        except Exception as error:
            if self._driver is not None and not self._driver.survives:
                with suppress(Exception):
                    self._driver.close()
                self._driver = None
            reason = self._limit.exceeded or ("it answers with more than there is memory for" if isinstance(error, MemoryError) else "")
            raise (DatabaseError(reason) if reason else self._kind.said(error)) from error


# --- moving and copying SQLite files, with all that is in their write-ahead logs -----------


def copy_file(path: Path, to: Path) -> None:
    """Make one file with all that is committed, also while it is written; raise `DatabaseError`, without a file, if that cannot be done."""
    _check_new(to)
    _do(path, lambda file: file.copy(to), read_only=True)


def move_file(path: Path, to: Path) -> None:
    """Move a file that no process has open, with all that has been committed; its lock forgets how far it had come.

    Raises:
        Locked: a process has its lock.
        DatabaseError: that cannot be done; the file is where it was.
    """
    _check_new(to)
    _do(path, lambda file: None, read_only=True)  # which makes no lock where there is no file
    lock = FileLock(path)
    try:
        _do(path, Sqlite.gather_all, read_only=False)
        if os.stat(path).st_dev == os.stat(to.parent).st_dev:
            path.rename(to)
        else:
            copy_file(path, to)
            path.unlink()
        lock.forget()
    except OSError as error:
        raise DatabaseError(error.strerror or str(error)) from error
    finally:
        lock.release()


def _check_new(to: Path) -> None:
    if not to.parent.is_dir():
        raise DatabaseError(f"there is no folder {to.parent}")
    if there := [file.name for file in files_of(to) if os.path.lexists(file)]:
        raise DatabaseError(f"there is {there[0]} already in {to.parent}; expected a new name")


def _do(path: Path, work: Callable[[Sqlite], None], *, read_only: bool) -> None:
    """Do something to a file that is there, whatever tables it has."""

    def done(driver: object) -> None:
        assert isinstance(driver, Sqlite)
        driver.run("SELECT count(*) FROM sqlite_schema", {})
        work(driver)

    with closing(Database(path, None, read_only=read_only)) as database:
        database.do(done)
