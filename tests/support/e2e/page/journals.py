"""Journals to look at: one that grows as far as a test says, as another one has grown; and what they say, record by record."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

from planner_bridge.tasks.result import TASKS
from pnm.journal.kept import Row
from pnm.journal.replay import Replay, ReplayStep
from pnm.journal.resume import replay_steps
from pnm.journal.store import JournalFile, KeptJournal


class GrowingJournal:
    """A journal that grows as another one has grown, as far as a test says."""

    def __init__(self, journal: Path, place: Path) -> None:
        self.place = place
        with closing(KeptJournal(journal)) as kept:
            self._rows = list(kept.rows())
            self._firsts = set(kept.segments())
        with closing(sqlite3.connect(journal)) as connection:
            self._parts = dict(connection.execute("SELECT key, text FROM parts").fetchall())
        self._file = JournalFile(place, 0.0)
        self.length = 0

    @property
    def longest(self) -> int:
        return len(self._rows)

    def grow(self, to: int) -> None:
        """Keep the records up to this one, in one transaction."""
        rows = [Row(row.time, row.text, 0.0 if number in self._firsts else None) for number, row in self._rows[self.length : to]]
        self._file.append(rows, {} if self.length else self._parts)
        self.length = to

    def add(self, text: str) -> None:
        """Keep a record that is not among those of the other one."""
        self._file.append([Row(0.0, text)], {})

    def close(self) -> None:
        self._file.close()


def steps(journal: Path) -> list[ReplayStep]:
    """The records of a journal, replayed by the product."""
    return list(replay_steps(journal, TASKS, Replay()))
