"""Global knowledge in a database: shared by runs, by processes and in PostgreSQL by hosts, and still there after all of them.

SQLite keeps its promises when a process is killed, and lets others read while one writes (WAL). A value is stored,
on the disk, before `update` returns.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from time import time
from typing import Final, TypeVar

from pnm.core.logic.computed_values import MISSING, Question
from pnm.files.database.database import Database
from pnm.files.database.driver import DatabaseError, Layout, SqlQuery
from pnm.files.database.place import Place
from pnm.files.text import private_folder
from pnm.knowledge.source import Asker, SourceError, read_value, write_value

LAYOUT: Final = Layout(
    "knowledge",
    0x504E4D4B,  # PNMK
    1,
    ("CREATE TABLE variables (name TEXT NOT NULL PRIMARY KEY, value TEXT NOT NULL, changed DOUBLE PRECISION NOT NULL, run TEXT NOT NULL)",),
)
_STORE: Final = (
    "INSERT INTO variables VALUES (:name, :value, :changed, :run)"
    " ON CONFLICT (name) DO UPDATE SET value = excluded.value, changed = excluded.changed, run = excluded.run"
)
_READ: Final = SqlQuery("SELECT value FROM variables WHERE name = :name", (str,))
_FORGET: Final = "DELETE FROM variables WHERE name = :name"

T = TypeVar("T")


def default_path() -> Path:
    """Return the default path of the global knowledge; raise `SourceError` if the user has no home."""
    state = os.environ.get("XDG_STATE_HOME", "")
    try:
        folder = Path(state) if Path(state).is_absolute() else Path.home() / ".local" / "state"
    except RuntimeError as error:
        raise SourceError(f"there is no place for the global knowledge: {error}; name a file") from error
    return folder / "pnm" / "knowledge.sqlite"


class DatabaseKnowledge:
    """Variables in an SQLite file, by default at `default_path`, which is made with its folder when it is first needed; or in PostgreSQL.

    All work is done on one thread, which has the connection; it is the mutable state.
    """

    def __init__(self, place: Place | None = None) -> None:
        self.place = default_path() if place is None else place
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="knowledge")
        self._database: Database | None = None
        self._closed = False

    def __repr__(self) -> str:
        return f"<DatabaseKnowledge {self.place}>"

    async def query(self, question: Question, asker: Asker, /) -> object:
        """Return the value, or `MISSING`."""
        return await self._on_thread(partial(self._read, question.name))

    async def update(self, question: Question, value: object, asker: Asker, /) -> None:
        """Store the value on the disk; one that is set to None is forgotten."""
        text = write_value(value)
        if value is None:
            await self._on_thread(lambda: self._open().run(_FORGET, name=question.name))
        else:
            await self._on_thread(lambda: self._open().run(_STORE, name=question.name, value=text, changed=time(), run=str(asker.run)))

    async def close(self) -> None:
        """Close the database when everything that was asked for is done."""
        if not self._closed:
            done = asyncio.get_running_loop().run_in_executor(self._thread, self._close)
            self._closed = True
            self._thread.shutdown(wait=False)
            await done

    async def _on_thread(self, work: Callable[[], T]) -> T:
        if self._closed:
            raise SourceError(f"{self.place} is closed")
        return await asyncio.get_running_loop().run_in_executor(self._thread, self._translated, work)

    # on the thread

    def _translated(self, work: Callable[[], T]) -> T:
        try:
            return work()
        except (DatabaseError, OSError) as error:
            self._close()  # the next one opens it anew: it may have been replaced, or its disk have space again
            raise SourceError(f"the knowledge in {self.place} cannot be used: {error}") from error

    def _read(self, name: str) -> object:
        rows = self._open().read(_READ, name=name)
        return read_value(rows[0][0]) if rows else MISSING

    def _open(self) -> Database:
        if self._database is None:
            if isinstance(self.place, Path):
                private_folder(self.place.parent)
            self._database = Database(self.place, LAYOUT, is_durable=True)
        return self._database

    def _close(self) -> None:
        if self._database is not None:
            self._database.close()
            self._database = None
