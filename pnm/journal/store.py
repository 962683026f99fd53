"""A journal in a database: records in their order, each transaction whole or not there at all.

The database is an SQLite file, or PostgreSQL for several nodes. SQLite's write-ahead log keeps what was committed when a process is
killed; if it is to be durable also when the power fails, and so does PostgreSQL.

Records are in segments, each of which can be replayed without those before it: a process goes on with the last one, and old ones
are dropped. What people want to know of tasks stands beside them, in a row per task, which is kept longer and can be read by
versions that could not replay the records.

One process writes a journal at a time: the holder of its latest epoch. Every commit asks in its own transaction whether that is still
so. In PostgreSQL the holder has a lease, which another process may take when it is over; see `pnm.journal.lease`.

A server may forget what it has acknowledged: when it crashes, commits that were not to be durable, and a copy of it that takes its place
may have even less. So every commit also compares the last record that is there with the last that was acknowledged, and begins with what
is missing, which is remembered until a commit behind it is durable. There is never a record without those before it. What says who may
write is durable always: a lease that was taken back would be another's while its holder trusts it.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from hashlib import sha256
from math import inf
from pathlib import Path
from threading import Lock
from typing import Final, NamedTuple

from pnm.errors import InputError
from pnm.files.database.database import Database, copy_file, move_file
from pnm.files.database.driver import DatabaseError, Rows, SqlQuery
from pnm.files.database.lock import FileLock, Mark, mark_of, this_host, this_process
from pnm.files.database.place import Place
from pnm.files.database.sqlite import has_log
from pnm.journal import tables
from pnm.journal.kept import Damaged, Fenced, HeldByAnother, JournalError, Rewritten, Row, journal_errors

_AT_ONCE: Final = 5000
"""Records that are dropped in a transaction."""
_READ: Final = 1000
"""Records that are read at once."""
_QUICK: Final = 64 * 1024 * 1024
"""Bytes of a file up to which its structure is checked before it is gone on with: some 0.2 s, unless it has to be read first."""
_WHOLE: Final = "expected the whole journal, or --adopt to go on with this part"
_ADOPT: Final = "two nodes that go on with one journal would send everything twice; expected --adopt if this is the only one"

_log = logging.getLogger(__name__)


class Home(NamedTuple):
    """The owner of a journal.

    Args:
        node: its node; empty for a run.
        host: the computer; empty for PostgreSQL, which is for several.
        file: what a copy does not have: the number of the file there.
    """

    node: str
    host: str
    file: str

    @classmethod
    def of(cls, place: Place, node: str) -> Home:
        """Return where a journal that is there belongs, if it is taken here."""
        return cls(node, this_host(), str(place.stat().st_ino)) if isinstance(place, Path) else cls(node, "", "")

    def unlike(self, here: Home, holder: str) -> str:
        """Return in words why a journal that belongs here is not one that belongs there."""
        if self.node != here.node:
            return f"is the journal of {self.node or 'a run'}, and not of {here.node or 'a run'}"
        return f"was written on another computer, by {holder}" if self.host != here.host else "is a copy, or was moved by hand"


class _Commit(NamedTuple):
    """The records of a transaction, from the first number on, with the parts that they name, and the segment that goes on after them."""

    first: int
    rows: Sequence[Row]
    parts: Mapping[str, str | None]
    segment: int

    @property
    def last(self) -> int:
        """The number of the last record."""
        return self.first + len(self.rows) - 1


class JournalFile:
    """A journal that is written, in a file or in PostgreSQL.

    Opening it begins a new epoch: whatever wrote it before is fenced off, and cannot commit any more.

    Args:
        place: of it; made if there is none.
        wall: the time of day in seconds, for the epoch.
        lease: the seconds for which nobody else may take it; None where something else sees to that. With it the journal is taken
            only if nobody else has a lease.
        is_durable: whether commits survive the death of the computer.
        lock: of its file, which is let go when the journal is closed.
        node: whose it is; None if that does not matter.
        adopts: whether it is taken although it belongs elsewhere, or is behind what its lock says.

    The mutable state is the connection, which threads share by a lock; the number of the last record; and the latest commits, which a
    server may still forget.

    Raises:
        Held: another process has a lease.
        InputError: it belongs elsewhere, or is not all there.
        JournalError: it is something else, of another version, damaged, or cannot be written.
    """

    def __init__(
        self,
        place: Place,
        wall: float,
        lease: float | None = None,
        *,
        is_durable: bool = False,
        lock: FileLock | None = None,
        node: str | None = None,
        adopts: bool = False,
    ) -> None:
        self.place = place
        self._lock = Lock()
        self._lease = lease or 0.0
        self._file_lock = lock
        self._is_durable = is_durable
        log_is_there = _has_log(place)
        if lock and lock.left and not adopts and isinstance(place, Path) and not place.exists():
            kept = f"{lock.left.holder} has kept {lock.left.last} records in it"
            expected = "it was deleted or moved; expected it with its log, or --adopt to begin anew"
            raise InputError(f"the journal {place} is not there, and {kept}: {expected}")
        self._database = _opened(place, read_only=False, is_durable=is_durable)
        try:
            with self._lock, journal_errors(self.place, "written"):
                if lock and isinstance(place, Path) and place.stat().st_size <= _QUICK:
                    self._database.do(lambda driver: driver.check())
                home = Home.of(place, node) if node is not None else None
                self.epoch: Final = self._begin_epoch(wall, home, adopts, log_is_there or not lock, only_free=lease is not None)
                self._last, self.segment = self._number(tables.LAST), self._number(tables.LAST_SEGMENT)
                """The last record, and the first one of the segment that goes on."""
                begun = self._database.read(tables.BEGUN_LAST)
                self.segment_wall: Final = begun[0][1] if begun else wall
                """The time of day when the last segment began when the journal was opened."""
                self._recent: list[_Commit] = []
                self.standing: tuple[str, ...] = ()
                """The processes that stood by when the lease was renewed."""
                if lock:
                    # So that the file by itself is a journal, which says that it was not closed.
                    self._database.do(lambda driver: driver.gather())
            self._mark()
        except BaseException:
            self._database.close()
            raise

    def _begin_epoch(self, wall: float, home: Home | None, adopts: bool, log_is_there: bool, *, only_free: bool) -> int:
        """Begin an epoch unless another process holds the journal, it is not all there, or it belongs elsewhere; it belongs here then."""
        database, me = self._database, this_process()
        with database.transaction(is_durable=True):
            database.run(tables.MAKE)
            free = database.read(tables.LEASE_TO_TAKE)  # nothing while its holder writes
            epoch, holder, left = (free or database.read(tables.LEASE))[0]
            if not free or (only_free and left > 0.0):
                raise HeldByAnother(f"{holder} holds the journal {self.place}", holder, left)
            left = self._file_lock.left if self._file_lock else None
            lacks = _lacks(left, epoch, self._number(tables.LAST), holder, log_is_there=log_is_there)
            if lacks and not adopts:
                raise InputError(f"the journal {self.place} {lacks}; {_WHOLE}")
            if home is not None:
                known = Home(*row) if (row := next(iter(database.read(tables.HOME)), None)) else home
                if known != home and not adopts:
                    writer = database.read(tables.LAST_HOLDER)[0][0]
                    raise InputError(f"the journal {self.place} {known.unlike(home, writer)}; {_ADOPT}")
                database.run(tables.SETTLE, **home._asdict())
            database.run(tables.TAKE, epoch=epoch + 1, me=me, seconds=self._lease)
            database.run(tables.BEGIN_EPOCH, epoch=epoch + 1, wall=wall, me=me)
        return int(epoch) + 1

    def _mark(self, *, is_closed: bool = False) -> None:
        """Note beside the file how far it has come."""
        if self._file_lock is not None:
            self._file_lock.mark(self.epoch, self._last, is_on_disk=self._is_durable or (is_closed and not _has_log(self.place)))

    def append(self, rows: Sequence[Row], parts: Mapping[str, str | None]) -> None:
        """Commit the rows, and the parts that they name, in one transaction; parts that are kept already are named without their text.

        Raises:
            Fenced: a later epoch has begun, or the server has lost more than is remembered; nothing was written.
            JournalError: it cannot be written now; nothing was, or it is taken away again before anything else is written.
        """
        with self._transaction() as kept:
            first = self._last + 1
            segment = max((number for number, row in enumerate(rows, first) if row.begins is not None), default=self.segment)
            kept.append(commit := _Commit(first, tuple(rows), dict(parts), segment))
            self._keep(commit)
        self._mark()

    def look(self) -> None:
        """Raise a `JournalError` if the journal is not where others look for it, as when its file was deleted or moved."""
        with self._lock, journal_errors(self.place, "written"):
            if self._database.is_connected:
                self._database.do(lambda driver: driver.look())

    def _keep(self, commit: _Commit) -> None:
        database, numbered = self._database, list(enumerate(commit.rows, commit.first))
        sums = [tables.checksum(row.text, number, self.epoch, row.time) for number, row in numbered]
        values = [
            {"sequence": number, "epoch": self.epoch, "time": row.time, "text": row.text, "checksum": checksum}
            for (number, row), checksum in zip(numbered, sums, strict=True)
        ]
        database.run_many(tables.KEEP, values)
        begins = [(number, row.begins) for number, row in numbered if row.begins is not None]
        began = [{"first": number, "wall": wall, "checksum": tables.checksum("", number, wall)} for number, wall in begins]
        database.run_many(tables.BEGIN_SEGMENT, began)
        changed = [
            {"accepted": number, **task._asdict(), "is_over": int(task.is_over), "checksum": tables.checksum(task.text)}
            for number, task in ((number, row.task) for number, row in numbered)
            if task
        ]
        database.run_many(tables.KEEP_TASK, changed)
        named = [
            {"key": key, "segment": commit.segment, "text": text, "checksum": tables.checksum(key + text)}
            for key, text in commit.parts.items()
            if text is not None
        ]
        database.run_many(tables.KEEP_PART, named)
        database.run_many(tables.NAME_PART, [{"key": key, "segment": commit.segment} for key, text in commit.parts.items() if text is None])

    def drop(self, records: float, tasks: float) -> None:
        """Drop segments that were over before a time of day, and the rows of tasks that had ended before another one."""
        with self._lock, journal_errors(self.place, "written"):
            oldest, first = self._number(tables.OLDEST), self._number(tables.NEEDED, before=records)
        dropped = -inf
        while dropped < first:
            dropped = min(oldest + _AT_ONCE, first) if oldest else first  # so that no transaction takes long
            with self._transaction():
                for statement in tables.DROP_BEFORE:
                    self._database.run(statement, number=dropped)
                self._database.run(tables.DROP_TASKS, before=tasks)
                oldest = self._number(tables.OLDEST)
        with self._lock, journal_errors(self.place, "written"):
            self._database.do(lambda driver: driver.shrink())

    def renew(self) -> None:
        """Begin the lease anew, over a new connection if there is none; what was kept before is durable then.

        Raises:
            Fenced: another process has taken the journal, or the server has lost more of it than is remembered.
            JournalError: it cannot be reached now.
        """
        with self._transaction(is_renewal=True):
            self._database.run(tables.RENEW, epoch=self.epoch, seconds=self._lease)
            self.standing = self._database.do(lambda driver: driver.waiting())

    def close(self) -> None:
        """End the lease, and close the file, or the connection."""
        with self._lock:
            if self._database.is_connected:
                with suppress(DatabaseError):
                    self._database.run(tables.RELEASE, epoch=self.epoch)
                    self._database.do(lambda driver: driver.announce())
            self._database.close()
            if self._file_lock is not None:
                self._mark(is_closed=True)
                self._file_lock.release()
                self._file_lock = None

    @contextmanager
    def _transaction(self, *, is_renewal: bool = False) -> Iterator[list[_Commit]]:
        """Enter a transaction of this epoch, which is whole or not there, and yield a list for what is kept in it."""
        database, kept = self._database, list[_Commit]()
        if not (is_renewal or database.is_connected):  # without the lock: `renew` mends that, in its time and not in that of the event loop
            raise JournalError(f"the journal {self.place} cannot be written: there is no connection to its database")
        with self._lock, journal_errors(self.place, "reached" if is_renewal else "written"):
            with database.transaction(is_new=is_renewal, is_durable=is_renewal):
                epoch, last = next(iter(database.read(tables.WHOSE)), (0, 0))
                if epoch > self.epoch:
                    raise Fenced(f"another process has taken over the journal {self.place}; it goes on there")
                self._mend(int(last) if epoch == self.epoch else 0)
                yield kept
            for commit in kept:
                self._last, self.segment = commit.last, commit.segment
            if is_renewal:
                self._recent.clear()
            elif not isinstance(self.place, Path):  # a file is not there without its last records while this process is
                self._recent += kept

    def _mend(self, last: int) -> None:
        """Have the database hold what was acknowledged, where this is its last record: write what it has forgotten, and nothing else.

        When a server goes away in the middle of a commit, nobody knows whether it has been made: it is written again, or was refused.
        """
        if last > self._last:
            for statement in tables.DROP_AFTER:
                self._database.run(statement, number=self._last)
        elif last < self._last:
            forgotten = [commit for commit in self._recent if commit.first > last]
            if not forgotten or forgotten[0].first != last + 1:
                raise Fenced(
                    f"the database of the journal {self.place} has lost the records {last + 1} to {self._last}: it was not made durable, or"
                    " is an older copy. Nothing is sent any more; a node that is started goes on without them"
                )
            for commit in forgotten:
                self._keep(commit)
            _log.warning(
                "the database of the journal %s had lost the records %d to %d; they are written again", self.place, last + 1, self._last
            )

    def _number(self, query: SqlQuery, **values: object) -> int:
        return int(self._database.read(query, **values)[0][0])


def copy_journal(path: Path, to: Path) -> None:
    """Make one file of a journal, also while it is written; it belongs where that does. Raise `JournalError` if it cannot be made."""
    with journal_errors(path, "copied"):
        copy_file(path, to)
    _settle(to)


def move_journal(path: Path, to: Path) -> None:
    """Move a journal that nobody holds, of whatever version, as one file; it goes on there, and another one may begin here."""
    with journal_errors(path, "moved"):
        move_file(path, to)
    _settle(to, to.stat().st_ino)


def _settle(path: Path, inode: int | None = None) -> None:
    """Note in a file that it is all there, and where it belongs if it was moved; a journal of another version has no place for that."""
    with suppress(DatabaseError), closing(Database(path, tables.LAYOUT)) as database:
        database.run(tables.CLOSE)
        if inode is not None:
            database.run(tables.MOVE, inode=str(inode))


def _lacks(left: Mark | None, epoch: int, last: int, holder: str, *, log_is_there: bool) -> str:
    """Return in words what was written in a file and is not there, by its lock or its last holder; empty if nothing is missed."""
    if left and left.is_sure and (left.epoch, left.last) > (epoch, last):
        kept = f"{left.holder} has kept {left.last} records in it, up to its epoch {left.epoch}"
        return f"is an older copy, or has lost its last records: {kept}; here are {last}, up to epoch {epoch}"
    return f"was not closed by {holder}, and its log is missing" if left is None and holder and not log_is_there else ""


def _has_log(place: Place) -> bool:
    return isinstance(place, Path) and has_log(place)


class Holding(NamedTuple):
    """The process that began the latest epoch of a journal, and the seconds left until its lease is over; below 0 when it is."""

    epoch: int
    holder: str
    left: float


class Seen(NamedTuple):
    """A record that was read, as it was: another one in its place has another epoch or checksum."""

    number: int
    epoch: int
    checksum: int


_NOTHING: Final = Seen(0, 0, 0)


class KeptJournal:
    """A journal that is read, also while another process writes it.

    Raises:
        JournalError: it is not there, something else, or of another version.
    """

    def __init__(self, place: Place) -> None:
        self.place = place
        left, log_is_there = mark_of(place) if isinstance(place, Path) else None, not isinstance(place, Path) or _has_log(place)
        self._database = _opened(place, read_only=True)
        try:
            (epoch, holder, _), last = self.holding(), self.last()
            # of a journal that was just begun, the log comes after the first look for it
            self._lacks = _lacks(left, epoch, last, holder, log_is_there=log_is_there or _has_log(place))
            """The missing files, until they were reported."""
        except BaseException:
            self.close()
            raise
        self.seen = _NOTHING
        """The last record that was read."""

    def rows(self, after: int = 0) -> Iterator[tuple[int, Row]]:
        """Yield the records after this one, with their numbers.

        Who reads on behind the last record that was read gets that one once more, in the same statement: a server may have lost it
        since, and another process have written other records in its place.

        Raises:
            Rewritten: the last record that was read is not there any more; the next call does not miss it.
            Damaged: records are missing, or not as they were written.
            JournalError: it cannot be read now.
        """
        self._warn()
        while True:
            rows = self._read(tables.ROWS, first=after, most=_READ)
            if after == self.seen.number > 0:
                self._compare(self.seen, rows)
            rows = rows[1:] if rows and rows[0][0] == after else rows
            if not rows:
                return
            for sequence, epoch, time, text, checksum in rows:
                self.seen = Seen(sequence, epoch, checksum)
                if tables.checksum(text, sequence, epoch, time) != checksum:
                    raise self._damaged(f"record {sequence}")
                if sequence != after + 1 and self._read(tables.OLDEST)[0][0] < sequence:
                    missing = f"the records {after + 1} to {sequence - 1} are missing"
                    raise Damaged(f"the journal {self.place} is damaged: {missing}; its database has lost them")
                yield sequence, Row(time, text)
                after = sequence

    def _warn(self) -> None:
        """Have who reads know once what is not there: what is, is read all the same."""
        lacks, self._lacks = self._lacks, ""
        if lacks:
            _log.warning("the journal %s %s", self.place, lacks)

    def look(self, seen: Seen) -> None:
        """Raise `Rewritten` if a record that was read is not there any more."""
        self._compare(seen, self._read(tables.ROWS, first=seen.number, most=1))

    def _compare(self, seen: Seen, rows: Rows) -> None:
        """Raise `Rewritten` unless the rows begin with a record that was read; or with a later one, when it is not kept any more."""
        found = next((Seen(sequence, epoch, checksum) for sequence, epoch, _, _, checksum in rows), _NOTHING)
        if found != seen and found.number <= seen.number:
            self.seen = _NOTHING
            raise Rewritten(f"the journal {self.place} has lost its record {seen.number}, which was read before")

    def last_segment(self) -> int:
        """Return the number of the record with which the last segment begins; 0 if there is none."""
        return max(self._segments(tables.BEGUN_LAST), default=0)

    def segments(self) -> tuple[int, ...]:
        """Return the numbers of the records with which the segments begin, in order."""
        return self._segments(tables.SEGMENTS)

    def _segments(self, query: SqlQuery) -> tuple[int, ...]:
        rows = self._read(query)
        for first, wall, checksum in rows:
            if tables.checksum("", first, wall) != checksum:
                raise self._damaged(f"the segment of record {first}")
        return tuple(first for first, _, _ in rows)

    def last(self) -> int:
        """Return the number of the last record; 0 if there is none."""
        return int(self._read(tables.LAST)[0][0])

    def tasks(self) -> Iterator[str]:
        """Yield the texts of all tasks, in the order in which they were accepted."""
        self._warn()
        for text, checksum in self._read(tables.TASKS):
            if tables.checksum(text) != checksum:
                raise self._damaged("a task in its list")
            yield text

    def part(self, key: str) -> str:
        """Return the part of this key; raise `JournalError` if there is none."""
        rows = self._read(tables.PART, key=key)
        if not rows:
            raise JournalError(f"the journal {self.place} names the part {key}, which is not there")
        text, checksum = rows[0]
        if tables.checksum(key + text) != checksum:  # an index may lead to that of another key
            raise self._damaged(f"the part {key}")
        return str(text)

    def check(self) -> int:
        """Read everything, and return how many records there are; raise `JournalError` if something is damaged or missing."""
        with journal_errors(self.place, "read"):
            self._database.do(lambda driver: driver.check())
        if self._lacks:
            raise Damaged(f"the journal {self.place} {self._lacks}")
        count = sum(1 for _ in self.rows())
        for (key,) in self._read(tables.PARTS):
            self.part(key)
        for _ in self.tasks():
            """Each is checked."""
        return count

    def id(self) -> str:
        """Return its identity, which it keeps wherever it is: a digest of when and by which process it was begun."""
        return sha256(repr(self._read(tables.FIRST_EPOCH)).encode()).hexdigest()[:16]

    def home(self) -> Home | None:
        """Return where it belongs, if that is known."""
        return next((Home(*row) for row in self._read(tables.HOME)), None)

    def epoch_began(self, epoch: int) -> float:
        """Return the time of day, in seconds, at which a process has taken it; 0 if that is not known."""
        return next((float(wall) for (wall,) in self._read(tables.EPOCH, epoch=epoch)), 0.0)

    def writer(self) -> str:
        """Return the process that has written it last."""
        return next((str(holder) for (holder,) in self._read(tables.LAST_HOLDER)), "")

    def holding(self) -> Holding:
        """Return who holds it."""
        return next((Holding(*row) for row in self._read(tables.LEASE)), Holding(0, "", 0.0))

    def wait(self, seconds: float) -> None:
        """Wait until its holder lets it go, or for so long."""
        with journal_errors(self.place, "read"):
            self._database.do(lambda driver: driver.wait(seconds, this_process()))

    def close(self) -> None:
        """Close the file, or the connection."""
        self._database.close()

    def _damaged(self, what: str) -> Damaged:
        return Damaged(f"the journal {self.place} is damaged: {what} is not as it was written")

    def _read(self, query: SqlQuery, **values: object) -> Rows:
        with journal_errors(self.place, "read"):
            return self._database.read(query, **values)


def _opened(place: Place, *, read_only: bool, is_durable: bool = False) -> Database:
    with journal_errors(place, "opened"):
        return Database(place, tables.LAYOUT, read_only=read_only, is_durable=is_durable)
