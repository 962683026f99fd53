"""Journals whose rows were changed by hand, as another version would have written them: with checksums that fit."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from pnm.journal.tables import checksum


@contextmanager
def forged(path: Path) -> Iterator[sqlite3.Connection]:
    """Enter a connection to a journal file; what was changed there has checksums that fit at the end."""
    with closing(sqlite3.connect(path)) as connection, connection:
        yield connection
        for sequence, epoch, time, text in connection.execute(
            "SELECT sequence, epoch, time, text FROM records ORDER BY sequence"
        ).fetchall():
            found = checksum(text, sequence, epoch, time)
            connection.execute("UPDATE records SET checksum = ? WHERE sequence = ?", (found, sequence))
        for task, text in connection.execute("SELECT task, text FROM tasks").fetchall():
            connection.execute("UPDATE tasks SET checksum = ? WHERE task = ?", (checksum(text), task))
        for key, text in connection.execute("SELECT key, text FROM parts").fetchall():
            connection.execute("UPDATE parts SET checksum = ? WHERE key = ?", (checksum(key + text), key))
