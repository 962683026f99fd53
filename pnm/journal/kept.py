"""The settings of a journal: its parts, its durability, its writer, and its errors."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final, NamedTuple

from pnm.errors import PnmError
from pnm.files.database.driver import DamagedDatabase, DatabaseError
from pnm.files.database.lock import Locked
from pnm.files.database.place import Place

DAY: Final = 86400.0
KEPT: Final = 7 * DAY
"""Seconds for which records are kept that nothing under way needs, unless something else is chosen."""
LISTED: Final = 50
"""The factor by which tasks are listed longer than their records are kept."""
DURABILITIES: Final = {"process-crash": False, "power-loss": True}
"""Whether committed records survive the death of the computer that has the file or the database, by the word for it: every commit is on
its disk then, before anything is done. All survive that of the process, as by SIGKILL."""
_ANEW: Final = 5.0
"""Seconds for which a process that stood by may not be seen because it connects anew."""
LEASE: Final = 5.0
"""Seconds of a lease, unless something else is chosen."""

_log = logging.getLogger(__name__)


class JournalError(PnmError):
    """A journal cannot be read, or not be written now."""


class Damaged(JournalError):
    """A journal that cannot be read, whenever that is tried."""


class Rewritten(JournalError):
    """A journal of which records that were read are not there any more: what was made of them is to be made anew."""


class Fenced(JournalError):
    """A process may not write its journal any more: another one has taken it over, or its database has lost what was kept."""


def log_end(why: Fenced) -> None:
    """Log that this process may not write a journal any more."""
    _log.error("%s; nothing is done here any more", why)


class HeldByAnother(JournalError):
    """Another process holds the journal."""

    def __init__(self, message: str, holder: str, left: float = 0.0) -> None:
        super().__init__(message)
        self.holder = holder
        """Which process that is."""
        self.left = left
        """Seconds until its lease is over, unless it renews it; 0 if it has no lease but a lock."""


@contextmanager
def journal_errors(place: Place, verb: str) -> Iterator[None]:
    """Have what is wrong with the database of a journal be wrong with the journal."""
    try:
        yield
    except Locked as error:
        raise HeldByAnother(f"{error.holder} holds the journal {place}", error.holder) from error
    except DatabaseError as error:
        kind = Damaged if isinstance(error, DamagedDatabase) else JournalError
        raise kind(f"the journal {place} cannot be {verb}: {error}") from error


class TaskRow(NamedTuple):
    """A task as it is listed: its id, the time of day when it was accepted or has ended, and its text."""

    task: str
    wall: float
    is_over: bool
    text: str


class Row(NamedTuple):
    """A record as it is kept.

    Args:
        time: when it was made, on the clock of the event loop.
        text: the record.
        begins: the time of day, if a segment begins with it.
        task: the row of its task, if that changes with it.
    """

    time: float
    text: str
    begins: float | None = None
    task: TaskRow | None = None


@dataclass(frozen=True, slots=True)
class JournalChoice:
    """A journal that is to be written.

    Args:
        place: of it; made if there is none.
        is_durable: whether commits survive the death of the computer; None for what is usual in that place.
        kept: seconds for which records are kept that nothing under way needs.
        command: what the command line is given, in which folder first, so that `pnm resume` goes on; empty for a node.
        seal: of the command, see `pnm.journal.records.SharedBegan`.
        lease: seconds for which no other process may take it, where it is in PostgreSQL.
        node: whose it is: the name of a node, empty for a run; None if that does not matter, for nothing goes on from it.
        adopts: whether it is taken although it is that of another node, a copy, or lacks what was written last.
    """

    place: Place
    is_durable: bool | None = None
    kept: float = KEPT
    command: tuple[str, ...] = ()
    seal: str = ""
    lease: float = LEASE
    node: str | None = ""
    adopts: bool = False


class StandBys(NamedTuple):
    """The processes that stand by for a journal.

    Args:
        names: those that did when any was seen last.
        ago: seconds since then.
    """

    names: tuple[str, ...] = ()
    ago: float = 0.0

    @property
    def are_missed(self) -> bool:
        """Whether there was one, and it does not only connect anew."""
        return bool(self.names) and self.ago > _ANEW


class Hold:
    """The right to write a journal; this one is of a journal that nobody else knows of."""

    def stand_bys(self) -> StandBys:
        """Return the processes that stand by, as far as they can be seen."""
        return StandBys()

    def saw(self, others: tuple[str, ...]) -> None:
        """Note the processes of which one would go on, if there is any."""

    def is_mine(self) -> bool:
        """Return whether nobody else can have it now; to be asked, by any thread, right before anything is sent."""
        return True

    def keep(self, renewed: Callable[[], None], fenced: Callable[[Fenced], None]) -> None:
        """Keep it from now on; call the one whenever it was renewed, the other when it is lost for good."""

    def release(self) -> None:
        """Let it go."""


UNSHARED: Final = Hold()
