"""The interface of a database driver, and the tables of a database."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from time import monotonic
from typing import Any, Final, TypeAlias

from pnm.errors import PnmError

NOW: Final = "extract(epoch FROM clock_timestamp())::float8"
"""The time of day on the clock of the database, in seconds, in SQL."""
Rows: TypeAlias = list[Sequence[Any]]


class DatabaseError(PnmError):
    """A database cannot be opened, read or written now."""


class DamagedDatabase(DatabaseError):
    """A database whose content is not what was written."""


@dataclass(frozen=True)
class SqlQuery:
    """A statement that reads, with the types of the values in a row; a file or a server may have others, whatever its tables say."""

    sql: str
    columns: tuple[type, ...]


@dataclass(frozen=True)
class Layout:
    """The tables that are kept together, and how a database shows that it has them.

    Args:
        kind: what they are, in one word, for people.
        application: marks SQLite files.
        version: of the format; a database with another one is refused.
        tables: a statement for each, which makes it.
    """

    kind: str
    application: int
    version: int
    tables: tuple[str, ...]


class Driver:
    """A connection of a driver: what only some need, and others see to by themselves.

    After an exception of its own, it may be closed, and is not used again unless it survives errors. Statements are in the SQL of
    PostgreSQL, as far as others have it or can put other words for it; parameters are ``:name``.
    """

    def waiting(self) -> tuple[str, ...]:
        """Return the processes that wait, as far as they can be seen."""
        return ()

    def announce(self) -> None:
        """Have those that wait go on."""

    def shrink(self) -> None:
        """Give space back that is not needed any more."""

    def look(self) -> None:
        """Raise a `DatabaseError` if what is written is not where others look for it, as when its file was deleted."""

    def check(self) -> None:
        """Raise `DamagedDatabase` if the tables cannot be read as they were written."""

    def gather(self) -> None:
        """Have the tables, as far as nobody reads them, in one file."""


def check_version(layout: Layout, version: int) -> None:
    """Raise a `DatabaseError` unless the tables have the format that is read here."""
    if version != layout.version:
        raise DatabaseError(f"the {layout.kind} has format {version}; this version of pnm reads format {layout.version}")


# --- the limit of one operation: what a file or a server holds, or does, is not ours to know ---


SECONDS: Final = 10.0
"""Seconds of real time for an operation: to open a database, to execute a statement, to commit."""
SIZE: Final = 256 * 1024 * 1024
"""Bytes that an operation may bring; texts in a file may have as many characters."""
_CELL: Final = 64
"""Bytes that count for a value in a row whatever it is."""


class OperationExceeded(OSError):
    """An operation takes too long, or brings too much."""


class OperationLimit:
    """Time and size left to an operation; one goes on at a time. The mutable state is both, and why it was ended."""

    def __init__(self) -> None:
        self._until = 0.0
        self._bytes = 0
        self.exceeded = ""
        """Why it was ended, in words; empty while it was not."""

    def begin(self, waiting: float = 0.0) -> None:
        """Begin an operation, which waits for so long by itself."""
        self._until, self._bytes, self.exceeded = monotonic() + SECONDS + waiting, SIZE, ""

    @property
    def is_over(self) -> bool:
        """Whether it may not go on."""
        if not self.exceeded and monotonic() >= self._until:
            self.exceeded = f"it has not answered within {SECONDS:g} s"
        return bool(self.exceeded)

    def seconds(self) -> float:
        """Return the seconds left; raise `OperationExceeded` if there are none."""
        if self.is_over:
            raise OperationExceeded(self.exceeded)
        return self._until - monotonic()

    def take(self, size: int) -> None:
        """Take in so many bytes; raise `OperationExceeded` if these are too many."""
        self._bytes -= size
        if self._bytes < 0:
            self.exceeded = f"it answers with more than {SIZE // 1024**2} MB"
            raise OperationExceeded(self.exceeded)

    def take_rows(self, rows: Iterable[Sequence[Any]]) -> list[Sequence[Any]]:
        """Return the rows, each of which is taken in as it comes."""
        taken = []
        for row in rows:
            self.take(sum(len(value) + _CELL if isinstance(value, str | bytes) else _CELL for value in row))
            taken.append(row)
        return taken
