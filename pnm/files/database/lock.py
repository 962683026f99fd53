"""The lock of a file of ours, in a file of its own beside it: who has it, and how far what is kept in the file has come.

The mark is written behind every commit. A file that is behind its mark is an older copy, or has lost its last records, as when its
write-ahead log was left behind; nobody would see that in the file itself.
"""

from __future__ import annotations

import fcntl
import os
import socket
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Final, NamedTuple
from uuid import uuid4

from pnm.files.database.driver import DatabaseError

_FOR_GOOD: Final = "-"
"""In place of a start of the computer: on the disk."""
_LONG: Final = 500
"""Bytes of a lock file that are read."""


def this_process() -> str:
    """Return the name of this process for others: its host and its number."""
    return f"{socket.gethostname()} pid {os.getpid()}"


def this_host() -> str:
    """Return the identity of this computer: a digest of its machine id, or its name if it has none, as many containers."""
    try:
        known = Path("/etc/machine-id").read_text(encoding="ascii").strip()
    except (OSError, UnicodeError):
        known = ""
    return sha256(f"pnm {known}".encode()).hexdigest()[:16] if known else socket.gethostname()


def lock_of(path: Path) -> Path:
    """Return the file of the lock of a file."""
    return path.with_name(f"{path.name}-lock")


class Locked(DatabaseError):
    """Another process has the lock."""

    def __init__(self, holder: str) -> None:
        super().__init__(f"{holder} has it")
        self.holder = holder


class Mark(NamedTuple):
    """The progress of a file.

    Args:
        epoch: the latest.
        last: the number of the last record.
        boot: the start of the computer until whose end that is sure; `_FOR_GOOD` if it is on the disk.
        holder: the process that has written it.
    """

    epoch: int
    last: int
    boot: str
    holder: str

    @property
    def is_sure(self) -> bool:
        """Whether the file must have come so far: what was not on the disk is lost when a computer loses its power."""
        return self.boot in (_FOR_GOOD, _BOOT)


class FileLock:
    """The lock of a file, which is free as soon as the process that has it is dead, and not before.

    Raises:
        Locked: another process has it.
        DatabaseError: there can be no such file.
    """

    def __init__(self, path: Path) -> None:
        try:
            self._file = os.open(lock_of(path), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        except OSError as error:
            raise DatabaseError(str(error)) from error
        try:
            text = os.pread(self._file, _LONG, 0).decode(errors="replace")
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self.left: Final = _mark_in(text)
            """The progress of the file when its lock was let go; None if that is not known."""
            self._me = this_process()
            self._holder = f"{self._me}\n".encode()
            kept = _text(self.left) if self.left else b""
            os.pwrite(self._file, self._holder + kept, 0)
            os.ftruncate(self._file, len(self._holder + kept))
        except OSError as error:
            os.close(self._file)
            if not isinstance(error, BlockingIOError):
                raise DatabaseError(str(error)) from error
            raise Locked(text.partition("\n")[0] or "another process") from error

    def mark(self, epoch: int, last: int, *, is_on_disk: bool) -> None:
        """Note how far the file has come, in the same bytes each time."""
        with suppress(OSError):  # a mark that is too low does no harm
            mark = Mark(epoch, last, _FOR_GOOD if is_on_disk else _BOOT, self._me)
            os.pwrite(self._file, _text(mark), len(self._holder))

    def forget(self) -> None:
        """Forget how far the file had come: it is another one from now on."""
        os.ftruncate(self._file, len(self._holder))

    def release(self) -> None:
        """Unlock it. The file stays: another process may wait for it."""
        os.close(self._file)


def _text(mark: Mark) -> bytes:
    return f"{mark.epoch:10} {mark.last:20} {mark.boot:36} {mark.holder}\n".encode()


def mark_of(path: Path) -> Mark | None:
    """Return the progress of a file, by the lock beside it; None if that is not known."""
    try:
        return _mark_in(lock_of(path).read_text(encoding="utf-8", errors="replace"))
    except OSError:
        return None


def _mark_in(text: str) -> Mark | None:
    """Return the mark in a lock file, which is its second line."""
    match text.partition("\n")[2].split(maxsplit=3):
        case [epoch, last, boot, holder] if epoch.isdecimal() and last.isdecimal():
            return Mark(int(epoch), int(last), boot, holder.strip())
    return None


try:
    _BOOT = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
except OSError:
    _BOOT = str(uuid4())
"""A name of this start of the computer; another one each time where that is not known."""
