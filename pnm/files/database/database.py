"""Databases of ours: an SQLite file, or tables in PostgreSQL. Tables and statements are SQLAlchemy's, written for both.

SQLAlchemy compiles statements; the driver executes them, in transactions that begin and end here. What an engine would add to that,
pools and types, is not needed, and costs more than a commit does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from pnm.errors import PnmError
from pnm.files.database.driver import DatabaseError, Driver, Layout, Rows
from pnm.files.database.limit import OperationLimit
from pnm.files.database.place import Place
from pnm.files.database.postgres import Postgres
from pnm.files.database.sqlite import Sqlite

if TYPE_CHECKING:  # it takes 0.15 s to import: who has no database need not wait for it
    from sqlalchemy import Executable
    from sqlalchemy.engine import Dialect


class Database:
    """A connection to a database of ours, which is opened anew when it was lost. To be used by one thread at a time.

    Every operation has a limit of time and size, see `OperationLimit`.

    Args:
        place: of it; a file is made if there is none.
        layout: its tables; made if there are none.
        read_only: whether it must be there, and is not written.
        is_durable: whether commits survive that the computer of the database dies.

    The mutable state is the connection.

    Raises:
        DatabaseError: it cannot be opened, or has something else.
    """

    def __init__(self, place: Place, layout: Layout, *, read_only: bool = False, is_durable: bool = False) -> None:
        self.place = place
        self._layout = layout
        self._read_only = read_only
        self._is_durable = is_durable
        self._driver: Driver | None = None
        self._limit = OperationLimit()
        self._translated = _Translated(self._limit, self._drop)
        self.connect()

    @property
    def is_connected(self) -> bool:
        """Whether there is a connection, as far as is known."""
        return self._driver is not None

    def connect(self) -> None:
        """Open the connection unless it is open."""
        if self._driver is not None:
            return
        from sqlalchemy.schema import CreateTable  # here, because it takes 0.15 s

        with self._translated:
            if isinstance(self.place, Path):
                driver: Driver = Sqlite(self.place, self._limit, read_only=self._read_only, is_durable=self._is_durable)
            else:
                driver = Postgres(self.place, self._limit, read_only=self._read_only, is_durable=self._is_durable)
            try:
                ddl = [str(CreateTable(table).compile(dialect=driver.dialect)) for table in self._layout.tables.sorted_tables]
                driver.prepare(self._layout, ddl, read_only=self._read_only)
            except BaseException:
                driver.close()
                raise
            self._driver = driver

    def run(self, statement: Executable, **values: object) -> Rows:
        """Execute a statement, in the transaction if there is one; return its rows."""
        with self._translated:
            driver, sql, constants = self._prepared(statement)
            return driver.run(sql, {**constants, **values})

    def run_many(self, statement: Executable, rows: Sequence[Mapping[str, object]]) -> None:
        """Execute a statement without constants for each row."""
        if rows:
            with self._translated:
                driver, sql, _ = self._prepared(statement)
                driver.run_many(sql, rows)

    @contextmanager
    def transaction(self, *, is_new: bool = True, is_durable: bool = False) -> Iterator[None]:
        """Commit everything inside at the end, or nothing after an error.

        Args:
            is_new: whether a connection that was lost is opened anew for it, which takes its time.
            is_durable: whether it, and all before it, survive that the computer of a server dies, also where others do not.
        """
        if is_new:
            self.connect()
        with self._translated:
            if self._driver is None:
                raise DatabaseError("there is no connection")
            self._driver.begin(is_durable=is_durable)
        try:
            yield
            with self._translated:
                self._control("COMMIT")
        except BaseException:
            if self._driver is not None:
                with suppress(DatabaseError), self._translated:
                    self._control("ROLLBACK")
            raise

    def wait(self, seconds: float, process: str) -> None:
        """Wait until something was announced in the database, or for so long; others see meanwhile that this process does."""
        self.connect()
        with self._translated:
            assert self._driver is not None
            self._limit.begin(seconds)
            self._driver.wait(seconds, process)

    def waiting(self) -> tuple[str, ...]:
        """Return the processes that wait, as far as they can be seen."""
        self.connect()
        with self._translated:
            assert self._driver is not None
            return self._driver.waiting()

    def announce(self) -> None:
        """Have those go on that wait for something to be announced."""
        self._do(lambda driver: driver.announce())

    def shrink(self) -> None:
        """Give space back that is not needed any more."""
        self._do(lambda driver: driver.shrink())

    def look(self) -> None:
        """Raise a `DatabaseError` if what is written is not where others look for it, as when its file was deleted."""
        self._do(lambda driver: driver.look())

    def check(self) -> None:
        """Raise a `DatabaseError` if the tables cannot be read as they were written."""
        self._do(lambda driver: driver.check())

    def gather(self) -> None:
        """Have the tables, as far as nobody reads them, in one file."""
        self._do(lambda driver: driver.gather())

    def close(self) -> None:
        """Close the connection."""
        if self._driver is not None:
            with suppress(DatabaseError), self._translated:
                self._driver.close()
            self._driver = None

    def _do(self, work: Callable[[Driver], None]) -> None:
        self.connect()
        with self._translated:
            assert self._driver is not None
            work(self._driver)

    def _control(self, sql: str) -> None:
        assert self._driver is not None
        self._driver.run(sql, {})

    def _prepared(self, statement: Executable) -> tuple[Driver, str, Mapping[str, object]]:
        """Return a statement as the driver has it, and the constants in it."""
        self.connect()
        assert self._driver is not None
        return self._driver, *_compiled(statement, self._driver.dialect)

    def _drop(self) -> None:
        """Forget a connection that an error has ended."""
        if self._driver is not None and not self._driver.survives:
            with suppress(Exception):
                self._driver.close()
            self._driver = None


class _Translated:
    """An operation of a driver, within its limit. Its errors are a `DatabaseError`; the connection is dropped after one that it does not
    survive.
    """

    def __init__(self, limit: OperationLimit, drop: Callable[[], None]) -> None:
        self._limit = limit
        self._drop = drop

    def __enter__(self) -> None:
        """Begin what a driver does."""
        self._limit.begin()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        # Anything else: pg8000 raises what it comes across when a server goes away.
        if isinstance(error, Exception) and not isinstance(error, PnmError):
            self._drop()
            raise DatabaseError(self._limit.exceeded or _reason(error)) from error


def _reason(error: Exception) -> str:
    """Return what is wrong in words; pg8000 has those of the server in a table."""
    said = error.args[0] if error.args else None
    if isinstance(said, Mapping):
        return str(said.get("M", said))
    return str(error) or type(error).__name__


@cache
def _compiled(statement: Executable, dialect: Dialect) -> tuple[str, Mapping[str, object]]:
    """Return a statement as text, and the constants in it; statements are module constants, so there are few."""
    compiled = statement.compile(dialect=dialect)  # type: ignore[attr-defined]
    return str(compiled), {name: value for name, value in compiled.params.items() if value is not None}
