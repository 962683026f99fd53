"""Resuming what a journal tells: the journal goes on in the same place, with the state that its replay has brought about.

While another process writes the journal, a node stands by: it replays what is new, so that it can go on at once.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from time import sleep
from typing import Final, TypeAlias

from pnm.core.net.no_collection import no_collection
from pnm.errors import InputError, PnmError
from pnm.files.database.place import Place
from pnm.journal.codec import Codec, Undecodable
from pnm.journal.journal import WrittenJournal
from pnm.journal.kept import Damaged, Fenced, HeldByAnother, Hold, JournalChoice, JournalError, Rewritten, log_end
from pnm.journal.lease import take
from pnm.journal.records import Record, SharedBegan, TaskSummary
from pnm.journal.replay import Replay, ReplayDiffers, ReplayStep
from pnm.journal.store import JournalFile, KeptJournal

_LOOK: Final = 1.0
"""Seconds at most until a node that stands by looks again."""
_SOON: Final = 0.05
"""Seconds at least."""
_LONG: Final = 200
"""Characters of a reason, which may quote what is in a file."""

Take: TypeAlias = Callable[[JournalChoice], tuple[JournalFile, Hold]]
Apply: TypeAlias = Callable[[int, float, Record], ReplayStep]
"""Replays a record, with its number and its time."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Taken:
    """A journal that this process holds, and the replay of what goes on from it; None if nothing does."""

    choice: JournalChoice
    codec: Codec
    file: JournalFile
    hold: Hold
    replay: Replay | None

    def write(self, fenced: Callable[[Fenced], None] = log_end, wall: Callable[[], float] | None = None) -> WrittenJournal:
        """Return the journal, which is written from the running event loop.

        Args:
            fenced: called on the event loop if another process has taken it over all the same.
            wall: returns the time of day in seconds; the clock of the computer if None.
        """
        return WrittenJournal(self.file, self.codec, self.replay, self.choice.kept, self.hold, fenced, wall)


class Follower:
    """The replay of the last segment of a journal, which goes on as the journal grows. The mutable state is how far it has come.

    Raises:
        JournalError: it is no journal, or one of another version.
    """

    def __init__(self, place: Place, codec: Codec) -> None:
        self._kept = KeptJournal(place)
        self._codec = codec
        self._begin()

    def _begin(self) -> None:
        self._has_failed = False
        self._seen = max(0, self._kept.last_segment() - 1)
        self.replay = Replay(lambda key: self._codec.value(self._kept.part(key)))

    def catch_up(self) -> None:
        """Replay what is new, or everything if what has been replayed is not there any more.

        Raises:
            ReplayDiffers: its runs do something else in this version.
            Undecodable: this version does not know what its records are made of.
        """
        if self._has_failed:  # in the middle of a record: what it has replayed is of no use
            self._begin()
        try:
            with no_collection():
                self._apply()
        except Rewritten:
            self._begin()
            self._apply()
        except Exception:
            self._has_failed = True
            raise

    def _apply(self) -> None:
        for step in steps_after(self._kept, self._codec, self.replay.apply, self._seen):
            self._seen = step.number
            if isinstance(step.record, SharedBegan):
                self.replay.forget()

    def unfinished(self) -> tuple[TaskSummary, ...]:
        """Return the tasks that have not ended, as they are listed."""
        tasks: Iterator[TaskSummary] = map(self._codec.value, self._kept.tasks())
        return tuple(task for task in tasks if task.ending is None)

    def wait(self, seconds: float) -> None:
        """Wait until the holder lets the journal go, or for so long."""
        self._kept.wait(seconds)

    def close(self) -> None:
        """Read no more."""
        self._kept.close()


def replayed(place: Place, codec: Codec) -> Replay:
    """Return the replay of the last segment of a journal; raises as `replay_steps` does."""
    replay = Replay()
    with no_collection():
        for _ in replay_steps(place, codec, replay, only_last=True):
            pass
    return replay


def replay_steps(place: Place, codec: Codec, replay: Replay, *, only_last: bool = False) -> Iterator[ReplayStep]:
    """Replay a journal, or only its last segment; yield each record when it was replayed.

    Raises:
        Damaged: records of it are missing, or do not fit each other.
        JournalError: it is no journal, or one of another version, or cannot be read now.
        ReplayDiffers: its runs do something else in this version.
        Undecodable: this version does not know what its records are made of.
    """
    with closing(KeptJournal(place)) as kept:
        replay.source = lambda key: codec.value(kept.part(key))
        yield from steps_after(kept, codec, replay.apply, kept.last_segment() - 1 if only_last else 0)


def steps_after(kept: KeptJournal, codec: Codec, apply: Apply, after: int) -> Iterator[ReplayStep]:
    """Replay the records after this one by a function; yield each when it was replayed; raises as `replay_steps` does."""
    try:
        for number, row in kept.rows(after):
            yield apply(number, row.time, codec.value(row.text))
            after = number
    except Undecodable as error:
        raise Undecodable(f"the journal {kept.place} cannot be read behind record {after}: {error}") from error
    except PnmError:
        raise
    except Exception as error:  # whatever it is that a damaged file, or records that do not fit each other, lead to
        raise damage(f"the journal {kept.place}", after, error) from error


def damage(journal: str, after: int, error: Exception) -> Damaged:
    """Return the error to raise if the record after this one leads to an error that no record of a whole journal does."""
    why = str(error)[:_LONG] if isinstance(error, PnmError) else "the next records do not fit those before"
    return Damaged(f"{journal} is damaged behind record {after}: {why}")


def summaries(place: Place, codec: Codec) -> tuple[TaskSummary, ...]:
    """Return the tasks of a journal, also those whose records have been dropped; nothing is replayed.

    Raises:
        JournalError: it is no journal, or one of another version.
        Undecodable: this version does not know what its tasks are made of.
    """
    with closing(KeptJournal(place)) as kept:
        found = tuple(map(codec.value, kept.tasks()))
    if any(not isinstance(summary, TaskSummary) for summary in found):
        raise Undecodable(f"the journal {place} cannot be read: its list of tasks has something else")
    return found


def command_of(place: Place, codec: Codec) -> tuple[tuple[str, ...], str] | None:
    """Return the arguments of the command that has begun a journal, with its folder first, and their seal.

    It is empty if the journal is that of a node, None if there is nothing in it yet.

    Raises:
        JournalError: it is no journal, or one of another version.
        Undecodable: this version does not know what it begins with.
    """
    with closing(KeptJournal(place)) as kept:
        for _, row in kept.rows(kept.last_segment() - 1):
            began = codec.value(row.text)
            return (began.command, began.seal) if isinstance(began, SharedBegan) else ((), "")
    return None


def take_up(choice: JournalChoice, codec: Codec, origin: str, take: Take = take) -> Taken:
    """Take a journal; what it tells of goes on if it began in the same world.

    Args:
        choice: which, and how it is written.
        codec: of its records.
        origin: what the world is made from here.
        take: opens it for writing, unless another process holds it.

    Raises:
        InputError: it cannot be used, another process holds it, or tasks in it are unfinished that cannot go on here.
    """
    candidate = _Candidate(choice, codec, origin, take)
    try:
        return candidate.taken()
    except (JournalError, Undecodable) as error:
        raise InputError(str(error)) from error
    finally:
        candidate.close()


async def stand_by(choice: JournalChoice, codec: Codec, origin: str, waits: Callable[[str], None]) -> Taken:
    """Take a journal as `take_up` does, as soon as no other process holds it; meanwhile replay what is new in it.

    `waits` is called with the process that holds it, when that is another one than before, and when the journal is back. Once the
    journal has been reached, losing it is no end: it is tried again, after pauses that grow, for as long as that takes.

    Raises:
        InputError: as for `take_up`, or the process that holds it serves another world.
    """
    candidate, holder, told, pause = _Candidate(choice, codec, origin), "", "", _SOON
    try:
        while True:
            try:
                try:
                    taken = await asyncio.to_thread(candidate.taken)
                except HeldByAnother as held:
                    holder = held.holder
                    if holder != told:
                        waits(holder)
                    told = holder
                    await asyncio.to_thread(candidate.wait, held.left)
                    pause = _SOON
                else:
                    taken.hold.saw((holder,) if holder else ())  # which is expected to stand by now
                    return taken
            except Damaged:
                raise
            except JournalError as error:
                if not holder:  # it has never been reached
                    raise
                if told:
                    _log.warning("%s; it is tried again", error)
                told = ""  # that it stands by again is said as well
                await asyncio.to_thread(sleep, pause)  # on real time, also where that of a simulation is followed
                pause = min(2.0 * pause, _LOOK)
    except (JournalError, Undecodable) as error:
        raise InputError(str(error)) from error
    finally:
        candidate.close()


@dataclass(slots=True)
class _Candidate:
    """A process that is to hold a journal. The mutable state is the replay of what is in it so far, and whether there can be none."""

    choice: JournalChoice
    codec: Codec
    origin: str
    take: Take = take
    follower: Follower | None = None
    why_not: str = ""
    """Why this version cannot replay it."""

    def taken(self) -> Taken:
        """Take the journal; what is in it is replayed before, so that it goes on at once.

        Raises:
            Held: another process has it.
            InputError: that one serves another world, or tasks in the journal cannot go on here.
            JournalError: it cannot be used now.
        """
        choice, place = self.choice, self.choice.place
        if self.follower is None:
            with suppress(JournalError):  # there is none yet; or else the next lines say what is wrong
                self.follower = Follower(place, self.codec)
        replay = self._replay()
        try:
            file, hold = self.take(choice)
        except HeldByAnother as held:
            if replay is not None and replay.shared is not None and replay.shared.origin != self.origin:
                raise InputError(f"{held.holder} holds {place}, for another domain, problem or world") from held
            raise
        try:
            self.follower = self.follower or Follower(place, self.codec)
            replay = self._replay()
            if replay is None:
                because = f"for this version cannot replay it: {self.why_not}"
                _log.warning("%s: begins anew with the world as its files have it, %s", place, because)
            elif replay.shared is None or replay.shared.origin != self.origin:
                if unfinished := self.follower.unfinished():
                    other = "tasks of another domain, problem or world are not finished"
                    raise InputError(f"{place}: {other}: {_names(unfinished)}; expected the same files, or a new journal")
                replay = None
        except BaseException:
            hold.release()
            file.close()
            raise
        return Taken(choice, self.codec, file, hold, replay)

    def _replay(self) -> Replay | None:
        """Return the replay of the journal so far; None if this version cannot replay it, and need not: nothing in it is unfinished."""
        if self.follower is None:
            return None
        place = self.choice.place
        try:
            self.follower.catch_up()
        except (ReplayDiffers, Undecodable) as error:
            if unfinished := self.follower.unfinished():
                away = f"`pnm journal move {place} FILE` moves this one" if isinstance(place, Path) else f"rename the schema {place.name}"
                raise InputError(
                    f"{place}: tasks that are not finished cannot go on in this version: {_names(unfinished)}; {error}. Go on with the"
                    f" version that has begun them; or, when their robots have been looked after, begin a new journal: {away}"
                    f" (`pnm history {place}` lists its tasks) or name another one"
                ) from error
            self.why_not = str(error)
            return None
        return self.follower.replay

    def wait(self, left: float) -> None:
        """Wait until the journal may be free, where its holder has a lease for so long."""
        seconds = min(max(left, _SOON), _LOOK) if left else _LOOK / 4
        if self.follower is None:
            sleep(seconds)
        else:
            self.follower.wait(seconds)

    def close(self) -> None:
        """Read no more."""
        if self.follower is not None:
            self.follower.close()


def _names(tasks: Sequence[TaskSummary]) -> str:
    return ", ".join(task.accepted.wanted.words for task in tasks)
