"""Moving and copying SQLite files of ours, with all that is in their write-ahead logs."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from pnm.files.database.driver import DatabaseError
from pnm.files.database.lock import FileLock
from pnm.files.database.sqlite import LIMIT, files_of, has_log, log_of


def copy_file(path: Path, to: Path) -> None:
    """Make one file with all that has been committed, also while another process writes.

    Raises:
        DatabaseError: that cannot be done; there is no such file then.
    """
    _check_new(to)
    try:
        with _opened(path, "ro") as connection:
            to.touch(0o600)
            connection.execute("VACUUM INTO ?", (str(to),))
    except DatabaseError:
        to.unlink(missing_ok=True)
        raise


def move_file(path: Path, to: Path) -> None:
    """Move a file that no process has open, with all that has been committed; its lock forgets how far it had come.

    Raises:
        Locked: a process has its lock.
        DatabaseError: that cannot be done; the file is where it was.
    """
    _check_new(to)
    with _opened(path, "rw"):
        """There is such a file."""
    lock = FileLock(path)
    try:
        with _opened(path, "rw") as connection:
            connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
        if has_log(path):
            raise DatabaseError("another process reads it; expected none")
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


@contextmanager
def _opened(path: Path, mode: str) -> Iterator[sqlite3.Connection]:
    """Enter a connection to a file that is there; errors of SQLite are those of a database."""
    if not path.is_file():
        lacks = f", only {log_of(path).name}, with what was written last; expected both" if has_log(path) else ""
        raise DatabaseError(f"there is no such file{lacks}")
    try:
        with closing(
            sqlite3.connect(f"{path.absolute().as_uri()}?mode={mode}", uri=True, timeout=LIMIT, isolation_level=None)
        ) as connection:
            connection.execute("SELECT count(*) FROM sqlite_schema").fetchone()
            yield connection
    except sqlite3.Error as error:
        raise DatabaseError(str(error)) from error
