"""A fleet that several nodes serve at the same time, in PostgreSQL: its parts, and the goals that they share.

A part has a journal of its own, with one holder, and robots of its own. A goal comes in at the door of a part, and is kept for all parts
before its client hears that it is accepted. A part that has room takes it. Which part that is says its row here; what becomes of it
says the journal of the part alone: what a part has taken, and its journal does not have, is begun there, whoever holds it by then. So
a goal is begun once, whenever processes die.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from time import sleep
from typing import Any, Final, NamedTuple, TypeAlias
from uuid import UUID

from pnm.core.logic.expressions import Fluent
from pnm.errors import InputError
from pnm.files.database.database import Database
from pnm.files.database.driver import NOW, Layout, Rows, SqlQuery
from pnm.files.database.lock import this_process
from pnm.files.database.place import Place, ServerUrl
from pnm.journal.codec import Codec
from pnm.journal.kept import JournalError, journal_errors
from pnm.tasks import TaskEnding, Wanted

_GATHER: Final = 0.02
"""Seconds for which news are gathered: many goals may come and end at once."""
_KEPT: Final = 100
"""Goals of a door that are over, and whose clients may still ask for their results."""

_LAYOUT: Final = Layout(
    "fleet",
    0x504E4D46,  # PNMF
    1,
    (
        "CREATE TABLE fleet (parts INTEGER NOT NULL, origin TEXT NOT NULL)",
        # `target` is the only part that may take it, `part` the one that has; 0 for none.
        "CREATE TABLE goals (task TEXT PRIMARY KEY, number BIGSERIAL, wall DOUBLE PRECISION NOT NULL, text TEXT NOT NULL,"
        " priority INTEGER NOT NULL, door INTEGER NOT NULL, target INTEGER NOT NULL, part INTEGER NOT NULL DEFAULT 0,"
        " is_cancelled INTEGER NOT NULL DEFAULT 0, ending TEXT NOT NULL DEFAULT '', is_told INTEGER NOT NULL DEFAULT 0)",
        "CREATE INDEX unfinished ON goals (part, priority, number) WHERE ending = ''",
        "CREATE INDEX untold ON goals (door) WHERE is_told = 0",
        # What the plans of tasks read and write of the facts that parts share, and the last value of those that have changed.
        "CREATE TABLE claims (name TEXT NOT NULL, task TEXT NOT NULL, part INTEGER NOT NULL, writes INTEGER NOT NULL,"
        " PRIMARY KEY (name, task))",
        "CREATE TABLE facts (name TEXT PRIMARY KEY, number BIGINT NOT NULL, part INTEGER NOT NULL, value TEXT NOT NULL)",
        "CREATE INDEX latest ON facts (number)",
    ),
)
_BEGIN: Final = "INSERT INTO fleet SELECT :parts, :origin WHERE NOT EXISTS (SELECT 1 FROM fleet)"
_BEGUN: Final = SqlQuery("SELECT parts, origin FROM fleet", (int, str))
_MINE: Final = SqlQuery("SELECT epoch FROM {journal}.lease WHERE holder = :me FOR SHARE", (int,))
"""The epoch of the journal of the part, which nobody can end before the transaction does; nothing if another process has it."""
_LOCK: Final = "LOCK TABLE fleet IN EXCLUSIVE MODE"
_ADD: Final = (
    f"INSERT INTO goals (task, wall, text, priority, door, target) SELECT :task, {NOW}, :text, :priority, :door, :target"
    " WHERE (SELECT count(*) FROM goals WHERE part = 0 AND ending = '') < :most ON CONFLICT DO NOTHING RETURNING 1"
)
_FOR_IT: Final = "FROM goals WHERE part = 0 AND ending = '' AND target IN (0, :part)"
_TAKE: Final = (
    f"UPDATE goals SET part = :part WHERE task IN (SELECT task {_FOR_IT} ORDER BY priority DESC, number"
    f" LIMIT least(:room, (SELECT (count(*) + :parts - 1) / :parts {_FOR_IT})) FOR UPDATE SKIP LOCKED)"
)
"""Takes no more than its share at once: the other parts look at the same moment."""
_TAKEN: Final = SqlQuery(
    f"SELECT text, {NOW} - wall FROM goals WHERE part = :part AND ending = ''"
    " AND NOT EXISTS (SELECT 1 FROM {journal}.tasks WHERE tasks.task = goals.task) ORDER BY priority DESC, number",
    (str, float),
)
_END: Final = (
    "UPDATE goals SET ending = tasks.text FROM {journal}.tasks WHERE tasks.task = goals.task AND tasks.is_over = 1"
    " AND goals.part = :part AND goals.ending = '' RETURNING 1"
)
_REFUSE: Final = "UPDATE goals SET ending = :ending WHERE task = :task AND ending = ''"
_CANCEL: Final = "UPDATE goals SET is_cancelled = 1, ending = CASE WHEN part = 0 THEN :ending ELSE ending END WHERE task = :task"
_CANCELLED: Final = SqlQuery("SELECT task FROM goals WHERE part = :part AND ending = '' AND is_cancelled = 1", (str,))
_TELL: Final = SqlQuery(
    "UPDATE goals SET is_told = 1 WHERE door = :part AND is_told = 0 AND ending <> '' RETURNING task, ending", (str, str)
)
_OF_DOOR: Final = SqlQuery(
    "SELECT text, ending FROM goals WHERE door = :part"
    " AND (ending = '' OR number > (SELECT max(number) FROM goals) - :kept) ORDER BY number",
    (str, str),
)
_SHARE: Final = (
    "INSERT INTO facts VALUES (:name, (SELECT coalesce(max(number), 0) + 1 FROM facts), :part, :value)"
    " ON CONFLICT (name) DO UPDATE SET number = excluded.number, part = excluded.part, value = excluded.value"
)
_FACTS: Final = SqlQuery(
    "SELECT name, value, number FROM facts WHERE number > :seen AND (part <> :part OR :seen = 0) ORDER BY number", (str, str, int)
)
_CLAIM: Final = (
    "INSERT INTO claims VALUES (:name, :task, :part, :writes)"
    " ON CONFLICT (name, task) DO UPDATE SET writes = greatest(claims.writes, excluded.writes)"
)
_GIVE: Final = "DELETE FROM claims WHERE task = :task"
_GIVE_REST: Final = (
    "DELETE FROM claims WHERE part = :part"
    " AND NOT EXISTS (SELECT 1 FROM {journal}.tasks WHERE tasks.task = claims.task AND tasks.is_over = 0)"
)
_OWN: Final = SqlQuery("SELECT name FROM claims WHERE part = :part AND writes = 1", (str,))
_OTHERS: Final = SqlQuery("SELECT task, part, name, writes FROM claims WHERE part <> :part", (str, int, str, int))
_AGAINST: Final = SqlQuery(f"{_OTHERS.sql} AND ((writes = 1 AND name = ANY(:names)) OR name = ANY(:written))", _OTHERS.columns)
_DROP: Final = f"DELETE FROM goals WHERE part IN (0, :part) AND ending <> '' AND wall < {NOW} - :kept"


@dataclass(frozen=True, slots=True)
class Part:
    """A part of a fleet: its number from 1 on, and how many there are."""

    number: int
    count: int

    @classmethod
    def of(cls, text: str) -> Part:
        """Read a part such as ``2/4``; raise an `InputError` if it is none."""
        number, _, count = text.partition("/")
        if number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count):
            return cls(int(number), int(count))
        raise InputError(f"not a part of a fleet: {text!r}; expected its number and how many there are, such as 2/4")

    def journal(self, fleet: Place | None) -> ServerUrl:
        """Return the place of its journal; raise an `InputError` if the fleet is not in PostgreSQL."""
        if not isinstance(fleet, ServerUrl):
            raise InputError("the parts of a fleet meet in PostgreSQL; expected a journal postgresql://…")
        return replace(fleet, options={**fleet.options, "name": f"{fleet.name}_{self.number}"})

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"


class TaskClaim(NamedTuple):
    """The claim of a task in another part to a fact."""

    task: UUID
    part: int
    fluent: Fluent
    writes: bool


Facts: TypeAlias = dict[Fluent, Any]
"""Facts, and their values."""


class FleetNews(NamedTuple):
    """The news of a fleet for a part.

    Args:
        taken: goals to begin here.
        cancelled: tasks to be cancelled here.
        ended: goals that came in at this door, and how they have ended.
        facts: that another part has changed.
    """

    taken: Sequence[Wanted]
    cancelled: Sequence[UUID]
    ended: Sequence[tuple[UUID, TaskEnding]]
    facts: Facts


class Fleet:
    """A fleet, as its database has it for the holder of a part. To be used by the event loop, but for `wait`.

    All of it raises a `JournalError` if that cannot be done now.

    The mutable state is the connections; and which facts were read, and are to be shared, and the tasks that have given back what they had:
    both is done in the next transaction.

    Args:
        place: of what the parts share.
        codec: of tasks.
        part: this one.
        origin: a digest of the files of its world.
        kept: seconds for which goals are kept that are over.

    Raises:
        InputError: it was begun with another number of parts, or with other files.
        JournalError: it cannot be reached, or this process does not hold the journal of the part.
    """

    def __init__(self, place: ServerUrl, codec: Codec, part: Part, origin: str, kept: float) -> None:
        self.part = part
        self._place = place
        self._codec = codec
        self._journal = part.journal(place).name
        self._seen = 0
        self._changed: Facts = {}
        self._given: set[UUID] = set()
        self._epoch = 0
        with journal_errors(place, "opened"), ExitStack() as opened:
            self._database = opened.enter_context(closing(Database(place, _LAYOUT, is_durable=True)))
            self._bell = opened.enter_context(closing(Database(place, _LAYOUT, read_only=True)))
            with self._transaction() as self._epoch:
                self._database.run(_LOCK)
                self._database.run(_BEGIN, parts=part.count, origin=origin)
                ((parts, begun),) = self._read(_BEGUN)
                if (parts, begun) != (part.count, origin):
                    found = f"{parts} parts" if parts != part.count else "other files"
                    raise InputError(f"the fleet {place} was begun with {found}; expected the same, or a new one, by another ?name=")
                self._database.run(_DROP, part=part.number, kept=kept)
                self._database.run(_GIVE_REST.format(journal=self._journal), part=part.number)
                self.claimed: Final = frozenset(self._fluent(name) for (name,) in self._read(_OWN, part=part.number))
                """The facts that are for tasks to change which go on here: the process that has begun them knew their values."""
            self.close: Final = opened.pop_all().close
            """Closes the connections."""

    def add(self, wanted: Wanted, target: int, most: int) -> bool:
        """Keep a goal for a part, or for any if it is 0; return False if so many wait already, or it is there."""
        values = {"text": self._codec.text(wanted), "priority": wanted.priority, "door": self.part.number, "target": target}
        with self._transaction():
            is_kept = self._database.run(_ADD, task=wanted.id.hex, most=most, **values)
            self._announce()
        return bool(is_kept)

    def look(self, room: int) -> FleetNews:
        """Take goals, as many as there is room for, and return what is new."""
        part = self.part.number
        with self._exchange() as facts:
            if room:
                self._database.run(_TAKE, part=part, parts=self.part.count, room=room)
            taken = self._read(_TAKEN, part=part)
            if self._database.run(_END.format(journal=self._journal), part=part):
                self._announce()
            cancelled, ended = self._read(_CANCELLED, part=part), self._read(_TELL, part=part)
        return FleetNews(
            [self._wanted(text, waited) for text, waited in taken],
            [UUID(task) for (task,) in cancelled],
            [(UUID(task), self._ending(text)) for task, text in ended],
            facts,
        )

    def changed(self, facts: Facts) -> None:
        """Note facts that have changed here; they are shared before anything is claimed or given back."""
        self._changed |= facts

    def claim(self, task: UUID, reads: Collection[Fluent], writes: Collection[Fluent]) -> tuple[list[TaskClaim], Facts]:
        """Claim facts for a task, besides what it has, unless that is against claims of other parts, which are returned.

        Returns besides the facts that other parts have changed; if the claim is granted, they have changed no others of its.
        """
        self._given.discard(task)
        names = {self._codec.text(fluent): int(fluent in writes) for fluent in (*reads, *writes)}
        written = [name for name, is_written in names.items() if is_written]
        with self._exchange(is_alone=True) as facts:
            against = self._claims(_AGAINST, names=[*names], written=written)
            if not against:
                claims = [
                    {"name": name, "task": task.hex, "part": self.part.number, "writes": is_written} for name, is_written in names.items()
                ]
                self._database.run_many(_CLAIM, claims)
        return against, facts

    def give(self, task: UUID) -> None:
        """Give back what a task has, with the next look."""
        self._given.add(task)

    def others(self) -> list[TaskClaim]:
        """Return the claims of other parts."""
        with self._transaction():
            return self._claims(_OTHERS)

    @contextmanager
    def _exchange(self, *, is_alone: bool = False) -> Iterator[Facts]:
        """Enter a transaction, the only one if `is_alone`: share what has changed here, yield what has changed elsewhere.

        Facts are numbered by one transaction after the other: who has read one has seen all before it.
        """
        with self._transaction():
            if self._changed or self._given or is_alone:
                self._database.run(_LOCK)
            if self._changed or self._given:
                own = {"part": self.part.number}
                shared = [own | {"name": self._codec.text(fluent), "value": self._codec.text(now)} for fluent, now in self._changed.items()]
                self._database.run_many(_SHARE, shared)
                self._database.run_many(_GIVE, [{"task": task.hex} for task in self._given])
                self._announce()
            rows = self._read(_FACTS, seen=self._seen, part=self.part.number)
            yield {self._fluent(name): self._codec.value(value) for name, value, _ in rows}
        self._seen, self._changed, self._given = max((number for *_, number in rows), default=self._seen), {}, set()

    def _claims(self, query: SqlQuery, **values: object) -> list[TaskClaim]:
        rows = self._read(query, part=self.part.number, **values)
        return [TaskClaim(UUID(task), part, self._fluent(name), bool(writes)) for task, part, name, writes in rows]

    def _fluent(self, name: str) -> Fluent:
        fluent: Fluent = self._codec.value(name)
        return fluent

    def refuse(self, task: UUID, ending: TaskEnding) -> None:
        """Keep how a goal has ended that no journal has."""
        with self._transaction():
            self._database.run(_REFUSE, task=task.hex, ending=self._codec.text(ending))
            self._announce()

    def cancel(self, task: UUID, ending: TaskEnding) -> None:
        """Have the part cancel a goal that has taken it; if none has, it ends so."""
        with self._transaction():
            self._database.run(_CANCEL, task=task.hex, ending=self._codec.text(ending))
            self._announce()

    def of_door(self) -> list[tuple[Wanted, TaskEnding | None]]:
        """Return the goals that came in at this door before, and how those have ended that are over."""
        with self._transaction():
            rows = self._read(_OF_DOOR, part=self.part.number, kept=_KEPT)
        return [(self._codec.value(text), self._ending(ending) if ending else None) for text, ending in rows]

    def wait(self, seconds: float) -> None:
        """Wait for news, or for so long, in a thread; raise a `JournalError` if the database is not there."""
        sleep(_GATHER)
        with journal_errors(self._place, "reached"):
            self._database.connect()
            self._bell.do(lambda driver: driver.wait(seconds, this_process()))

    def _wanted(self, text: str, waited: float) -> Wanted:
        wanted: Wanted = self._codec.value(text)
        return wanted if wanted.deadline is None else replace(wanted, deadline=max(0.0, wanted.deadline - waited))

    def _ending(self, text: str) -> TaskEnding:
        value = self._codec.value(text)
        return value if isinstance(value, TaskEnding) else value.ending

    @contextmanager
    def _transaction(self) -> Iterator[int]:
        """Enter a transaction of the holder of the journal of the part; yield its epoch.

        It is over the connection that is there, which `wait` mends: in its time, and not in that of the event loop.
        """
        with journal_errors(self._place, "reached"), self._database.transaction(is_new=False):
            (epoch,) = next(iter(self._read(_MINE, me=this_process())), (0,))
            if epoch == 0 or self._epoch not in (0, epoch):
                raise JournalError(f"another process has taken over the part {self.part} of the fleet {self._place}")
            yield int(epoch)

    def _read(self, query: SqlQuery, **values: object) -> Rows:
        return self._database.read(SqlQuery(query.sql.format(journal=self._journal), query.columns), **values)

    def _announce(self) -> None:
        self._database.do(lambda driver: driver.announce())
