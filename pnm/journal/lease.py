"""One process writes a journal at a time: the one that has the lock of its file, or its lease in PostgreSQL.

A lock is free as soon as the process that has it is dead, and not before: one that is stopped keeps it. A lease ends by itself. Its
holder may have been stopped or cut off from the database, so it trusts its own clock: the lease is over for it some time before it is
over for others, counted from before it was asked for. That is asked right before everything that leaves the process. So of two that
think they are the one, only one can send.

A thread renews the lease, on real time, if the event loop shows that it is alive: a process whose loop hangs does not keep others away.
"""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

from pnm.files.database.lock import FileLock
from pnm.journal.kept import Fenced, HeldByAnother, Hold, JournalChoice, JournalError, StandBys, journal_errors
from pnm.journal.store import JournalFile

_SAFE: Final = 0.9
"""The part of its lease that its holder uses: what it sends at the end of that has arrived when another one may take over."""
_LOOK: Final = 1.0
"""Seconds until it is looked again whether a file is there."""
_OFTEN: Final = 3
"""The number of renewals of a lease in its time."""
_CLOCK: Final = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)
"""The clock that goes on while the computer sleeps, where there is one."""

_log = logging.getLogger(__name__)


def elapsed() -> float:
    """Return seconds on a clock that is never set, and that goes on while the process is stopped or the computer sleeps."""
    return time.clock_gettime(_CLOCK)


class Watch(Hold):
    """The hold of a journal file, whose lock nobody else has. A thread looks once a second, on real time, whether the file is there.

    Args:
        pause: seconds from one renewal to the next.
        limit: seconds for which the event loop is waited for: while it hangs, nothing is renewed.
    """

    def __init__(self, pause: float = _LOOK, limit: float = _LOOK) -> None:
        self._pause = pause
        self._limit = limit
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None

    def keep(self, renewed: Callable[[], None], fenced: Callable[[Fenced], None]) -> None:
        """Renew it from now on, as long as the event loop is alive; these are called on the event loop."""
        loop = asyncio.get_running_loop()
        self._thread = threading.Thread(target=self._keep, args=(loop, renewed, fenced), name="hold", daemon=True)
        self._thread.start()

    def renew(self) -> None:
        """Do nothing: a lock lasts as long as its process."""

    def release(self) -> None:
        """Renew it no more. The lock is let go with the file."""
        self._closing.set()

    def _keep(self, loop: asyncio.AbstractEventLoop, renewed: Callable[[], None], fenced: Callable[[Fenced], None]) -> None:
        def tell() -> None:
            if not self._closing.is_set():
                renewed()

        is_well = True
        with suppress(RuntimeError):  # the loop was closed
            while not self._closing.wait(self._pause if is_well else min(1.0, self._pause)):
                alive = threading.Event()
                loop.call_soon_threadsafe(alive.set)
                if not alive.wait(self._limit) or self._closing.is_set():
                    continue
                try:
                    self.renew()
                except Fenced as error:
                    loop.call_soon_threadsafe(fenced, error)
                    return
                except JournalError as error:
                    if is_well:
                        _log.warning("%s; without its lease nothing is sent", error)
                    is_well = False
                else:
                    is_well = True
                    loop.call_soon_threadsafe(tell)


def is_locked(path: Path) -> bool:
    """Return whether another process has the lock of a journal file."""
    try:
        _locked(path).release()
    except HeldByAnother:
        return True
    except JournalError:  # which whoever opens it says
        return False
    return False


class Lease(Watch):
    """The lease of a journal in PostgreSQL.

    Args:
        file: the journal, whose lease has begun.
        seconds: of the lease.
        asked: when it was asked for, on the clock.
        clock: see `elapsed`.

    The mutable state is when the lease is over, which the thread that renews it moves on; which processes stood by,
    when, and whether it was said that none does any more.
    """

    def __init__(self, file: JournalFile, seconds: float, asked: float, clock: Callable[[], float] = elapsed) -> None:
        super().__init__(seconds / _OFTEN, seconds)
        self._file = file
        self._seconds = seconds
        self._clock = clock
        self._until = asked + seconds * _SAFE
        self._others: tuple[str, ...] = ()
        self._seen = 0.0
        self._has_told = False

    def is_mine(self) -> bool:
        """Return whether the lease lasts."""
        return self._clock() < self._until

    def stand_bys(self) -> StandBys:
        """Return the processes that stand by, as they were seen at the last renewal."""
        return StandBys(self._others, self._clock() - self._seen if self._others else 0.0)

    def saw(self, others: tuple[str, ...]) -> None:
        """Note the processes of which one would go on, if there is any."""
        if others:
            self._others, self._seen, self._has_told = others, self._clock(), False

    def renew(self) -> None:
        """Renew the lease; raises as `JournalFile.renew` does."""
        asked = self._clock()
        self._file.renew()
        self._until = asked + self._seconds * _SAFE
        self.saw(self._file.standing)
        if self.stand_bys().are_missed and not self._has_told:
            self._has_told = True
            _log.warning("no other node stands by any more for the journal %s; the last one was %s", self._file.place, self._others[-1])

    def release(self) -> None:
        """Renew the lease no more; it ends when its file is closed."""
        super().release()
        if self._thread is not None:
            self._thread.join(self._seconds)
        self._until = 0.0


def take(choice: JournalChoice) -> tuple[JournalFile, Hold]:
    """Open a journal for writing if nobody else writes it.

    Raises:
        Held: another process does.
        InputError: it belongs elsewhere, or is not all there.
        JournalError: it cannot be used.
    """
    place, is_durable = choice.place, choice.is_durable
    if is_durable is None:  # a server may die while the process goes on, and a file cannot
        is_durable = not isinstance(place, Path)
    if isinstance(place, Path):
        lock = _locked(place)
        try:
            return JournalFile(place, time.time(), is_durable=is_durable, lock=lock, node=choice.node, adopts=choice.adopts), Watch()
        except BaseException:
            lock.release()
            raise
    asked = elapsed()
    file = JournalFile(place, time.time(), choice.lease, is_durable=is_durable, node=choice.node, adopts=choice.adopts)
    return file, Lease(file, choice.lease, asked)


def _locked(path: Path) -> FileLock:
    """Return the lock of a journal file; raise an error if another process has it, or it can be none."""
    if path.exists() and not path.is_file():
        raise JournalError(f"{path} is no file: it cannot be a journal")
    with journal_errors(path, "locked"):
        return FileLock(path)
