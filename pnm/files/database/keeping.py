"""Moving and copying SQLite files of ours, with all that is in their write-ahead logs."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

from pnm.files.database.database import Database
from pnm.files.database.driver import DatabaseError
from pnm.files.database.lock import FileLock
from pnm.files.database.sqlite import Sqlite, files_of


def copy_file(path: Path, to: Path) -> None:
    """Make one file with all that has been committed, also while another process writes.

    Raises:
        DatabaseError: that cannot be done; there is no such file then.
    """
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
