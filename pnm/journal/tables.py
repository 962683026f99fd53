"""The tables of a journal, and all statements about them.

Each row whose content is relied on has a checksum of that: see `checksum`.
"""

from __future__ import annotations

import struct
from typing import Final
from zlib import crc32

from pnm.files.database.driver import NOW, Layout, SqlQuery

LAYOUT: Final = Layout(
    "journal",
    0x504E4D4A,  # PNMJ
    6,
    (
        "CREATE TABLE records (sequence BIGINT PRIMARY KEY, epoch INTEGER NOT NULL, time DOUBLE PRECISION NOT NULL,"
        " text TEXT NOT NULL, checksum BIGINT NOT NULL)",
        "CREATE TABLE segments (first BIGINT PRIMARY KEY, wall DOUBLE PRECISION NOT NULL, checksum BIGINT NOT NULL)",
        # `accepted` is the number of the record with which a task was
        "CREATE TABLE tasks (task TEXT NOT NULL PRIMARY KEY, accepted BIGINT NOT NULL, wall DOUBLE PRECISION NOT NULL,"
        " is_over INTEGER NOT NULL, text TEXT NOT NULL, checksum BIGINT NOT NULL)",
        "CREATE TABLE parts (key TEXT NOT NULL PRIMARY KEY, segment BIGINT NOT NULL, text TEXT NOT NULL, checksum BIGINT NOT NULL)",
        "CREATE TABLE epochs (epoch INTEGER PRIMARY KEY, wall DOUBLE PRECISION NOT NULL, holder TEXT NOT NULL)",
        # Who may write, in the only row: the holder of the latest epoch, until its lease is over and another one begins the next. It
        # has no name any more when it has closed the journal.
        "CREATE TABLE lease (id INTEGER PRIMARY KEY, epoch INTEGER NOT NULL, holder TEXT NOT NULL, until DOUBLE PRECISION NOT NULL)",
        # Where the journal belongs, in the only row: to a node, and unless it is in PostgreSQL to a computer and to a file there.
        "CREATE TABLE home (id INTEGER PRIMARY KEY, node TEXT NOT NULL, host TEXT NOT NULL, file TEXT NOT NULL)",
    ),
)


def checksum(text: str, *numbers: float) -> int:
    """Return the checksum of a row: of its text, and of numbers that count as much."""
    return crc32(text.encode(), crc32(struct.pack(f"<{len(numbers)}d", *numbers)))


# --- who may write ---
MAKE: Final = "INSERT INTO lease VALUES (1, 0, '', 0.0) ON CONFLICT DO NOTHING"
LEASE: Final = SqlQuery(f"SELECT epoch, holder, until - {NOW} FROM lease", (int, str, float))
LEASE_TO_TAKE: Final = SqlQuery(f"{LEASE.sql} FOR UPDATE SKIP LOCKED", LEASE.columns)
TAKE: Final = f"UPDATE lease SET epoch = :epoch, holder = :me, until = {NOW} + :seconds"
BEGIN_EPOCH: Final = "INSERT INTO epochs VALUES (:epoch, :wall, :me)"
RENEW: Final = f"UPDATE lease SET until = {NOW} + :seconds WHERE epoch = :epoch"
RELEASE: Final = "UPDATE lease SET until = 0.0, holder = '' WHERE epoch = :epoch"
CLOSE: Final = "UPDATE lease SET holder = ''"

# --- whose it is ---
SETTLE: Final = (
    "INSERT INTO home VALUES (1, :node, :host, :file)"
    " ON CONFLICT (id) DO UPDATE SET node = excluded.node, host = excluded.host, file = excluded.file"
)
HOME: Final = SqlQuery("SELECT node, host, file FROM home", (str, str, str))
MOVE: Final = "UPDATE home SET file = :inode"
FIRST_EPOCH: Final = SqlQuery("SELECT wall, holder FROM epochs ORDER BY epoch LIMIT 1", (float, str))
EPOCH: Final = SqlQuery("SELECT wall FROM epochs WHERE epoch = :epoch", (float,))
LAST_HOLDER: Final = SqlQuery("SELECT holder FROM epochs ORDER BY epoch DESC LIMIT 1", (str,))

# --- what is kept ---
KEEP: Final = "INSERT INTO records VALUES (:sequence, :epoch, :time, :text, :checksum)"
BEGIN_SEGMENT: Final = "INSERT INTO segments VALUES (:first, :wall, :checksum)"
KEEP_PART: Final = "INSERT INTO parts VALUES (:key, :segment, :text, :checksum) ON CONFLICT (key) DO UPDATE SET segment = excluded.segment"
NAME_PART: Final = "UPDATE parts SET segment = :segment WHERE key = :key"
KEEP_TASK: Final = (
    "INSERT INTO tasks VALUES (:task, :accepted, :wall, :is_over, :text, :checksum) ON CONFLICT (task) DO UPDATE"
    " SET wall = excluded.wall, is_over = excluded.is_over, text = excluded.text, checksum = excluded.checksum"
)
ROWS: Final = SqlQuery(
    "SELECT sequence, epoch, time, text, checksum FROM records WHERE sequence >= :first ORDER BY sequence LIMIT :most",
    (int, int, float, str, int),
)
PART: Final = SqlQuery("SELECT text, checksum FROM parts WHERE key = :key", (str, int))
PARTS: Final = SqlQuery("SELECT key FROM parts ORDER BY key", (str,))
TASKS: Final = SqlQuery("SELECT text, checksum FROM tasks ORDER BY accepted", (str, int))
LAST: Final = SqlQuery("SELECT coalesce(max(sequence), 0) FROM records", (int,))
WHOSE: Final = SqlQuery(f"SELECT epoch, ({LAST.sql}) FROM lease FOR SHARE OF lease", (int, int))
"""The latest epoch, which nobody can end before the transaction does, and the last record."""
LAST_SEGMENT: Final = SqlQuery("SELECT coalesce(max(first), 0) FROM segments", (int,))
SEGMENTS: Final = SqlQuery("SELECT first, wall, checksum FROM segments ORDER BY first", (int, float, int))
BEGUN_LAST: Final = SqlQuery(f"{SEGMENTS.sql} DESC LIMIT 1", SEGMENTS.columns)

# --- what is not kept any more ---
OLDEST: Final = SqlQuery("SELECT coalesce(min(sequence), 0) FROM records", (int,))
NEEDED: Final = SqlQuery(f"{LAST_SEGMENT.sql} WHERE wall < :before", LAST_SEGMENT.columns)
"""The first record of the segment that goes on at a time of day: those before it are older."""
_NUMBERS: Final = {"records": "sequence", "segments": "first", "parts": "segment", "tasks": "accepted"}
"""The columns with numbers of records."""
DROP_BEFORE: Final = tuple(f"DELETE FROM {table} WHERE {_NUMBERS[table]} < :number" for table in ("records", "segments", "parts"))
DROP_TASKS: Final = "DELETE FROM tasks WHERE is_over = 1 AND wall < :before"
DROP_AFTER: Final = tuple(f"DELETE FROM {table} WHERE {_NUMBERS[table]} > :number" for table in ("records", "segments", "tasks"))
