"""Following a journal: what is shown after its last record, as it grows, and after any record before.

A reader replays records as they come. Browsers are not told what has happened: each is told how what it has seen last differs from
what is so now. So a slow one misses what was in between, and nothing waits for it.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from dataclasses import replace
from math import inf
from threading import Lock
from typing import Final, Generic, TypeVar

from planner_bridge.pipeline.odds import NOTHING_KNOWN, KnownRobots
from planner_bridge.tasks.result import TASKS
from planner_bridge.view.story import Story, View, view_of
from pnm.errors import PnmError
from pnm.files.database.place import Place
from pnm.journal.kept import Rewritten
from pnm.journal.resume import steps_after
from pnm.journal.store import KeptJournal, Seen

PERIOD: Final = 0.1
"""Seconds between two looks into a journal that has grown: no browser gets more frames."""
_CROWD: Final = 100
"""Browsers that are sent so many; of more, each gets fewer."""
_IDLE: Final = 0.25
"""Seconds between two looks into one that has not."""

T = TypeVar("T")
S = TypeVar("S", bound=Story)
_log = logging.getLogger(__name__)


class Reader(Generic[S]):
    """Reads a journal, which need not be there yet, as a kind of story. Any thread may call; one at a time is served.

    What is known of robots gives odds. The mutable state is the story so far, and what is shown of it.
    """

    def __init__(self, place: Place, known: KnownRobots = NOTHING_KNOWN, tells: type[S] = Story) -> None:  # type: ignore[assignment]
        self._place = place
        self._known = known
        self._tells = tells
        self._lock = Lock()
        self._kept: KeptJournal | None = None
        self._story: S | None = None
        self._stuck: tuple[Seen, PnmError] | None = None
        """The record that cannot be replayed, whenever it is tried, and why."""
        self._view = View()

    def newest(self) -> View:
        """Return the view after the last record; the same object if nothing has changed."""
        with self._lock:
            problem = ""
            try:
                self._go_to(inf)
            except PnmError as error:
                problem = f"after record {self._story.number}: {error}" if self._story else str(error)
            if self._story and (self._story.number, self._story.first) != (self._view.number, self._view.first):
                self._view = view_of(self._story)
            if problem != self._view.problem:
                self._view = replace(self._view, problem=problem)
            return self._view

    def now(self, tell: Callable[[S], T]) -> T:
        """Return a function of the story after the last record; raise a `PnmError` if the journal is not read or replayed."""
        with self._lock:
            self._go_to(inf)
            assert self._story is not None, "it has begun by now"
            return tell(self._story)

    def at(self, number: int, tell: Callable[[S], T]) -> T | None:
        """Return a function of the story after a record, None if it is not there; raise a `PnmError` if it is not read or replayed."""
        with self._lock:
            kept = self._opened()
            if not kept.segments() or not kept.segments()[0] <= number <= kept.last():
                return None
            self._go_to(number)
            return tell(self._story) if self._story and self._story.number else None

    def close(self) -> None:
        """Read no more."""
        with self._lock:
            if self._kept is not None:
                self._kept.close()
                self._kept = None

    def _opened(self) -> KeptJournal:
        if self._kept is None:
            self._kept = KeptJournal(self._place)
        return self._kept

    def _go_to(self, number: float) -> None:
        """Have the story end after a record, or after the last one."""
        kept = self._opened()
        if self._story is None or number < self._story.number:
            self._begin(kept, number)
        try:
            self._replay(kept, number)
        except Rewritten:
            self._view = View()
            self._begin(kept, number)
            self._replay(kept, number)

    def _begin(self, kept: KeptJournal, number: float) -> None:
        """Begin a story that reaches back as far as is needed to tell all after a record."""
        self._stuck = None
        self._story = self._tells.of(kept, number, self._known)

    def _replay(self, kept: KeptJournal, number: float) -> None:
        assert self._story is not None
        done = self._story.number
        if done >= number:
            return
        if self._stuck:
            seen, error = self._stuck
            kept.look(seen)
            raise error
        try:
            for step in steps_after(kept, TASKS, self._story.apply, done):
                done = step.number
                if done >= number:
                    return
        except Rewritten:
            raise
        except PnmError as error:
            if self._story.number != done:  # in the middle of a record: the story of those before it is told anew
                seen = kept.seen
                self._begin(kept, done)
                self._replay(kept, done)
                self._stuck = seen, error
            raise


class Feed:
    """The messages to browsers: the view after the last record, whenever it changes, while somebody watches.

    To be used on one event loop. The mutable state is the view, how many watch, and what reads for them.
    """

    def __init__(self, reader: Reader[Story]) -> None:
        self._reader = reader
        self.view = View()
        self.watching = 0
        self._reading: asyncio.Task[None] | None = None
        self._changed = asyncio.Event()
        """Set, and replaced, when the view has changed."""
        self._is_closed = False
        self._is_broken = False

    async def views(self) -> AsyncIterator[View]:
        """Yield the view after the last record, and again when it has changed: whoever takes long misses those in between."""
        self.watching += 1
        try:
            self._set(await self.newest())
            if self._reading is None or self._reading.done():
                self._reading = asyncio.create_task(self._read())
            seen = None
            while not self._is_closed:
                changed = self._changed
                if self.view is not seen:
                    seen = self.view
                    yield seen
                else:
                    await changed.wait()
        finally:
            self.watching -= 1
            if not self.watching and self._reading is not None:
                self._reading.cancel()
                self._reading = None

    async def asked(self, number: int, tell: Callable[[Story], T], past: Reader[Story]) -> T | None:
        """Return a function of the story after a record, by the reader that stands there or another; raise a `PnmError` as `at` does."""
        return await asyncio.to_thread((self._reader if number == self.view.number else past).at, number, tell)

    async def _read(self) -> None:
        while not self._is_broken:
            is_news = self._set(await self.newest())
            await asyncio.sleep(PERIOD * max(1.0, self.watching / _CROWD) if is_news else _IDLE)

    async def newest(self) -> View:
        """Return the view after the last record; after a fault of ours its reason, and end."""
        try:
            view = await asyncio.to_thread(self._reader.newest)
        except Exception as error:
            _log.exception("the journal cannot be followed any more")
            self._is_broken = True
            return replace(self.view, problem=f"the journal cannot be followed any more: {type(error).__name__}: {error}")
        self._is_broken = False
        return view

    def _set(self, view: View) -> bool:
        """Have everybody see a view; return whether it is another one."""
        is_news = view is not self.view
        if is_news:
            self.view = view
            self._tell()
        return is_news

    def _tell(self) -> None:
        changed, self._changed = self._changed, asyncio.Event()
        changed.set()

    async def close(self) -> None:
        """Tell nothing more."""
        self._is_closed = True
        self._tell()
        if self._reading is not None:
            self._reading.cancel()
            with suppress(asyncio.CancelledError):
                await self._reading
