"""A journal that cannot be reached at times, its lock or its lease, and commits at which processes die or are stopped."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from shutil import copyfile
from typing import Final

from pnm.journal.kept import UNSHARED, Fenced, HeldByAnother, Hold, JournalError, Row
from pnm.journal.lease import Lease
from pnm.journal.store import JournalFile
from tests.support.runs.simulation.processes import Process
from tests.support.runs.simulation.story import Committed, Started, Story, Suffered


class Fate(Enum):
    """What happens to a process at one of its commits."""

    DIES_BEFORE = "dies before a commit"
    DIES_DURING = "dies during a commit, which is torn"
    DIES_AFTER = "dies between a commit and what follows from it"
    SLEEPS_BEFORE = "is stopped before a commit"
    SLEEPS_AFTER = "is stopped between a commit and what follows from it"


SECONDS: Final = 5.0
"""Of a lease."""
DEATHS: Final = (Fate.DIES_BEFORE, Fate.DIES_DURING, Fate.DIES_AFTER)


@dataclass(frozen=True, slots=True)
class DiskPlan:
    """What is going to happen, by the number of the commit; later ones are not counted again.

    Args:
        at: the commit at which the process meets its fate; 0 for none.
        fate: what that is.
        seconds: for which it is stopped.
        full: the commits that find the disk full.
        torn: the share of a torn transaction that is written.
    """

    at: int = 0
    fate: Fate = Fate.DIES_BEFORE
    seconds: float = 0.0
    full: range = range(0)
    torn: float = 0.5
    opening: float = 0.0
    """Seconds that pass between the replay of the journal and its opening."""


@dataclass
class Folder:
    """Where the journal is. The mutable state is the file that is read and written next, who holds it, and until when.

    Args:
        path: of the folder.
        is_leased: whether there is a lease on it, as in PostgreSQL, and not a lock, as for a file.
    """

    path: Path
    is_leased: bool = False
    copies: int = field(default=0)
    holder: Process | None = None
    until: float = 0.0

    @property
    def journal(self) -> Path:
        """The file of the journal."""
        return self.path.with_name(f"{self.path.name}{self.copies or ''}")

    def check_free(self, process: Process) -> None:
        """Raise `HeldByAnother` if another process has the lock, or a lease that is not over."""
        holder, left = self.holder, self.until - process.loop.time()
        if holder is None or holder is process:
            return
        if left > 0.0 if self.is_leased else not holder.is_dead:
            raise HeldByAnother(f"{holder.name} holds the journal", holder.name, left)

    def tear(self, before: bytes, share: float) -> None:
        """Go on with a copy of the file whose log is as it was before, but for a share of what was written last.

        The log may have been written over from its beginning, so that what is old stands behind what is new.
        """
        whole, log = self.journal, Path(f"{self.journal}-wal")
        after = log.read_bytes()
        old = before[: len(after)].ljust(len(after), b"\0")
        differing = [index for index, (one, other) in enumerate(zip(old, after, strict=True)) if one != other]
        end = differing[int(share * len(differing))]  # the last byte that differs is never written
        self.copies += 1
        copyfile(whole, self.journal)
        Path(f"{self.journal}-wal").write_bytes(after[:end] + before[end : len(after)])


class SimulatedLease(Lease):
    """The lease of a journal, on the virtual clock."""

    def keep(self, renewed: Callable[[], None], fenced: Callable[[Fenced], None]) -> None:
        """Renew the lease from now on."""

        def renew() -> None:
            try:
                self.renew()
            except Fenced as error:
                fenced(error)
                return
            except JournalError:
                pass
            else:
                renewed()
            asyncio.get_running_loop().call_later(SECONDS / 3, renew)

        asyncio.get_running_loop().call_later(SECONDS / 3, renew)


class Disk(JournalFile):
    """A journal whose process meets its fate. The mutable state is the number of commits so far, and whether it can be reached."""

    def __init__(self, folder: Folder, process: Process, plan: DiskPlan, story: Story, stopped: Callable[[], object]) -> None:
        super().__init__(folder.journal, 0.0)
        self._folder = folder
        self._process = process
        self._plan = plan
        self._story = story
        self._stopped = stopped
        self._commits = 0
        self.is_cut_off = False
        folder.holder, folder.until = process, process.loop.time() + SECONDS
        story.moments.append(Started(process.loop.time(), process.name, self.epoch))

    def append(self, rows: Sequence[Row], parts: Mapping[str, str | None]) -> None:
        process, plan = self._process, self._plan
        self._commits += 1
        fate = plan.fate if self._commits == plan.at else None
        self._check_reachable()
        if self._commits in plan.full:
            super().append((), {})  # whether another process has taken over can be read there all the same
            self._suffer("finds the disk full")
            raise JournalError("no space left on device")
        if fate is Fate.DIES_DURING and any(not other.is_dead for other in process.loop.processes if other is not process):
            fate = Fate.DIES_BEFORE  # another process has the file open, and would go on with what is torn here
        if fate is Fate.DIES_BEFORE:
            self._suffer(fate.value)
            process.die()
        if fate is Fate.SLEEPS_BEFORE:
            self._sleep(fate)
        log = Path(f"{self.place}-wal")
        before = log.read_bytes() if fate is Fate.DIES_DURING and log.exists() else b""
        try:
            super().append(rows, parts)
        except Fenced:
            self._suffer("is fenced off")
            raise
        if fate is Fate.DIES_DURING:
            self._suffer(fate.value)
            self._folder.tear(before, plan.torn)
            process.die()
        self._story.moments.append(Committed(process.loop.time(), process.name, self.epoch, tuple(row.text for row in rows)))
        if fate is Fate.DIES_AFTER:
            self._suffer(fate.value)
            process.die()
        if fate is Fate.SLEEPS_AFTER:
            self._sleep(fate)

    def renew(self) -> None:
        self._check_reachable()
        super().renew()
        self._folder.until = self._process.loop.time() + SECONDS

    def close(self) -> None:
        super().close()
        if self._folder.holder is self._process:
            self._folder.holder = None

    def _check_reachable(self) -> None:
        if self._process.is_dead:
            self._process.die()
        if self.is_cut_off:
            raise JournalError("the journal cannot be reached")

    def _sleep(self, fate: Fate) -> None:
        self._suffer(fate.value)
        self._stopped()
        self._process.sleep(self._plan.seconds)
        self._suffer("wakes")

    @property
    def hold(self) -> Hold:
        """The right to write it, from the moment at which it was opened."""
        now = self._process.loop.time
        return SimulatedLease(self, SECONDS, now(), now) if self._folder.is_leased else UNSHARED

    def _suffer(self, what: str) -> None:
        self._story.moments.append(Suffered(self._process.loop.time(), self._process.name, what))
