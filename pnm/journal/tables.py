"""The tables of a journal, and all statements about them."""

from __future__ import annotations

import struct
from typing import Any, Final
from zlib import crc32

from sqlalchemy import BigInteger, Column, Double, Integer, MetaData, Table, Text, bindparam, delete, func, select, update
from sqlalchemy.dialects.postgresql import insert  # whose ON CONFLICT SQLite has as well
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.sql.functions import FunctionElement

from pnm.files.database.driver import Layout

_TABLES: Final = MetaData()
_Number: Final = BigInteger().with_variant(Integer, "sqlite")
"""The number of a record: in SQLite, where integers have 64 bits anyway, a key of this type needs no index beside the table."""
records: Final = Table(
    "records",
    _TABLES,
    Column("sequence", _Number, primary_key=True, autoincrement=False),
    Column("epoch", Integer, nullable=False),
    Column("time", Double, nullable=False),
    Column("text", Text, nullable=False),
    Column("checksum", _Number, nullable=False),
)
"""Each row whose content is relied on has a checksum of that: see `checksum`."""
segments: Final = Table(
    "segments",
    _TABLES,
    Column("first", _Number, primary_key=True, autoincrement=False),
    Column("wall", Double, nullable=False),
    Column("checksum", _Number, nullable=False),
)
tasks: Final = Table(
    "tasks",
    _TABLES,
    Column("task", Text, primary_key=True),
    Column("accepted", BigInteger, nullable=False),
    Column("wall", Double, nullable=False),
    Column("is_over", Integer, nullable=False),
    Column("text", Text, nullable=False),
    Column("checksum", _Number, nullable=False),
)
"""`accepted` is the number of the record with which a task was."""
parts: Final = Table(
    "parts",
    _TABLES,
    Column("key", Text, primary_key=True),
    Column("segment", BigInteger, nullable=False),
    Column("text", Text, nullable=False),
    Column("checksum", _Number, nullable=False),
)
epochs: Final = Table(
    "epochs",
    _TABLES,
    Column("epoch", Integer, primary_key=True, autoincrement=False),
    Column("wall", Double, nullable=False),
    Column("holder", Text, nullable=False),
)
lease: Final = Table(
    "lease",
    _TABLES,
    Column("id", Integer, primary_key=True, autoincrement=False),
    Column("epoch", Integer, nullable=False),
    Column("holder", Text, nullable=False),
    Column("until", Double, nullable=False),
    Column("rewritten", Integer, nullable=False),
)
"""Who may write the journal, in its only row: the holder of its latest epoch, until its lease is over and another one begins the next.

The holder has no name any more when it has closed the journal. `rewritten` counts how often records were taken away, so that who has
read them knows.
"""
home: Final = Table(
    "home",
    _TABLES,
    Column("id", Integer, primary_key=True, autoincrement=False),
    Column("node", Text, nullable=False),
    Column("host", Text, nullable=False),
    Column("file", Text, nullable=False),
)
"""Where the journal belongs, in its only row: to a node, and unless it is in PostgreSQL to a computer and to a file there."""
LAYOUT: Final = Layout("journal", 0x504E4D4A, 5, _TABLES)  # PNMJ


def checksum(text: str, *numbers: float) -> int:
    """Return the checksum of a row: of its text, and of numbers that count as much."""
    return crc32(text.encode(), crc32(struct.pack(f"<{len(numbers)}d", *numbers)))


def is_whole(kept: object, text: Any, *numbers: Any) -> bool:
    """Return whether a row is as it was written; what is damaged may be of any type."""
    try:
        return checksum(text, *numbers) == kept
    except (AttributeError, UnicodeError, struct.error):
        return False


class _now(FunctionElement[float]):  # noqa: N801, it is a function of SQL
    """The time of day on the clock of the database, in seconds."""

    type = Double()
    inherit_cache = True


@compiles(_now, "sqlite")
def _sqlite_now(element: _now, compiler: Any, **options: Any) -> str:
    return "((julianday('now') - 2440587.5) * 86400.0)"


@compiles(_now, "postgresql")
def _postgres_now(element: _now, compiler: Any, **options: Any) -> str:
    return "extract(epoch FROM clock_timestamp())::float8"


_EPOCH: Final = bindparam("mine", type_=Integer)
_NUMBER: Final = bindparam("number", type_=BigInteger)
_WALL: Final = bindparam("before", type_=Double)
_SECONDS: Final = bindparam("seconds", type_=Double)

# --- who may write ---
MAKE: Final = insert(lease).on_conflict_do_nothing()
LEASE: Final = select(lease.c.epoch, lease.c.holder, (lease.c.until - _now()).label("left"), lease.c.rewritten)
LEASE_TO_TAKE: Final = LEASE.with_for_update(skip_locked=True)
TAKE: Final = update(lease).values(epoch=_EPOCH, holder=bindparam("me", type_=Text), until=_now() + _SECONDS)
BEGIN_EPOCH: Final = insert(epochs)
RENEW: Final = update(lease).where(lease.c.epoch == _EPOCH).values(until=_now() + _SECONDS)
RELEASE: Final = update(lease).where(lease.c.epoch == _EPOCH).values(until=0.0, holder="")

# --- whose it is ---
_HOME: Final = insert(home)
SETTLE: Final = _HOME.on_conflict_do_update(index_elements=["id"], set_={name: _HOME.excluded[name] for name in ("node", "host", "file")})
HOME: Final = select(home.c.node, home.c.host, home.c.file)
LAST_HOLDER: Final = select(epochs.c.holder, epochs.c.epoch).order_by(epochs.c.epoch.desc()).limit(1)
# --- what is kept ---
KEEP: Final = insert(records)
BEGIN_SEGMENT: Final = insert(segments)
_PART: Final = insert(parts)
KEEP_PART: Final = _PART.on_conflict_do_update(index_elements=["key"], set_={"segment": _PART.excluded.segment})
_TASK: Final = insert(tasks)
KEEP_TASK: Final = _TASK.on_conflict_do_update(
    index_elements=["task"],
    set_={name: _TASK.excluded[name] for name in ("wall", "is_over", "text", "checksum")},
)
ROWS: Final = (
    select(records.c.sequence, records.c.epoch, records.c.time, records.c.text, records.c.checksum)
    .where(records.c.sequence > _NUMBER)
    .order_by(records.c.sequence)
    .limit(1000)
)
PART: Final = select(parts.c.text, parts.c.checksum).where(parts.c.key == bindparam("wanted", type_=Text))
PARTS: Final = select(parts.c.key).order_by(parts.c.key)
CLOSE: Final = update(lease).values(holder="")
MOVE: Final = update(home).values(file=bindparam("inode", type_=Text))
TASKS: Final = select(tasks.c.text, tasks.c.checksum).order_by(tasks.c.accepted)
LAST: Final = select(func.coalesce(func.max(records.c.sequence), 0))
WHOSE: Final = select(lease.c.epoch, LAST.scalar_subquery()).with_for_update(read=True, of=lease)
"""The latest epoch, which nobody can end before the transaction does, and the last record."""
LAST_SEGMENT: Final = select(func.coalesce(func.max(segments.c.first), 0))
SEGMENTS: Final = select(segments.c.first, segments.c.wall, segments.c.checksum).order_by(segments.c.first)

# --- what is not kept any more ---
OLDEST: Final = select(func.coalesce(func.min(records.c.sequence), 0))
NEEDED: Final = LAST_SEGMENT.where(segments.c.wall < _WALL)
"""The first record of the segment that goes on at a time of day: those before it are older."""
DROP_BEFORE: Final = tuple(
    delete(column.table).where(column < _NUMBER) for column in (records.c.sequence, segments.c.first, parts.c.segment)
)
DROP_TASKS: Final = delete(tasks).where(tasks.c.is_over == 1, tasks.c.wall < _WALL)
DROP_AFTER: Final = tuple(
    delete(column.table).where(column > _NUMBER) for column in (records.c.sequence, segments.c.first, tasks.c.accepted)
)
REWRITTEN: Final = update(lease).values(rewritten=lease.c.rewritten + 1)
