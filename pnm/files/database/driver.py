"""What a database of ours needs of a driver, and what its tables are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

from pnm.errors import PnmError

if TYPE_CHECKING:  # it takes 0.15 s to import: who has no database need not wait for it
    from sqlalchemy import MetaData
    from sqlalchemy.engine import Dialect

Rows: TypeAlias = list[Sequence[Any]]


class DatabaseError(PnmError):
    """A database cannot be opened, read or written now."""


@dataclass(frozen=True)
class Layout:
    """The tables that are kept together, and how a database shows that it has them.

    Args:
        kind: what they are, in one word, for people.
        application: marks SQLite files.
        version: of the format; a database with another one is refused.
    """

    kind: str
    application: int
    version: int
    tables: MetaData


class Driver(Protocol):
    """A connection of a driver. After an exception of its own, it may be closed, and is not used again unless it `survives` errors."""

    survives: bool

    @property
    def dialect(self) -> Dialect:
        """Which SQL it speaks."""

    def run(self, sql: str, values: Mapping[str, object], /) -> Rows:
        """Execute a statement with ``:name`` parameters."""

    def run_many(self, sql: str, rows: Sequence[Mapping[str, object]], /) -> None:
        """Execute a statement for each row."""

    def begin(self, *, is_durable: bool) -> None:
        """Begin a transaction that writes, and that survives the death of the computer of a server if it is durable."""

    def prepare(self, layout: Layout, ddl: Sequence[str], *, read_only: bool) -> None:
        """Make the tables unless they are there; refuse those of something else or of another version."""

    def wait(self, seconds: float, process: str) -> None:
        """Wait until something was announced, or for so long; others see meanwhile that this process does."""

    def waiting(self) -> tuple[str, ...]:
        """Return the processes that wait, as far as they can be seen."""

    def announce(self) -> None:
        """Have those that wait go on."""

    def shrink(self) -> None:
        """Give space back that is not needed any more."""

    def look(self) -> None:
        """Raise a `DatabaseError` if what is written is not where others look for it, as when its file was deleted."""

    def check(self) -> None:
        """Raise a `DatabaseError` if the tables cannot be read as they were written."""

    def gather(self) -> None:
        """Have the tables, as far as nobody reads them, in one file."""

    def close(self) -> None:
        """Close the connection."""


def check_version(layout: Layout, version: int) -> None:
    """Raise a `DatabaseError` unless the tables have the format that is read here."""
    if version != layout.version:
        raise DatabaseError(f"the {layout.kind} has format {version}; this version of pnm reads format {layout.version}")
