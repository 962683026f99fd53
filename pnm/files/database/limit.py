"""The limit of one operation on a database: what a file or a server holds, or does, is not ours to know."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from time import monotonic
from typing import Any, Final

SECONDS: Final = 10.0
"""Seconds of real time for an operation: to open a database, to execute a statement, to commit."""
SIZE: Final = 256 * 1024 * 1024
"""Bytes that an operation may bring; texts in a file may have as many characters."""
_CELL: Final = 64
"""Bytes that count for a value in a row whatever it is."""


class OperationExceeded(OSError):
    """An operation takes too long, or brings too much."""


class OperationLimit:
    """Time and size left to an operation; one goes on at a time.

    The mutable state is until when it may go on, the bytes that it may still bring, and why it was ended.
    """

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
        """Return the seconds left.

        Raises:
            OperationExceeded: there are none.
        """
        if self.is_over:
            raise OperationExceeded(self.exceeded)
        return self._until - monotonic()

    def take(self, size: int) -> None:
        """Take in so many bytes.

        Raises:
            OperationExceeded: these are too many.
        """
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
