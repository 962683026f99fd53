"""What goes on in a journal: the records that are said again where a segment begins, so that those before it are not needed.

Of a run that is what it was made from, and how it stands now: its events are not said again.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from itertools import count
from typing import Any
from uuid import UUID

from pnm.core.execution.call_results import Became
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase
from pnm.journal import records
from pnm.tasks import REMEMBERED


class Ongoing:
    """The records of tasks that are not over, and of runs that go on. Everything is mutable state."""

    def __init__(self, segment: int = 0) -> None:
        self.segment = segment
        """The first record of the segment that goes on."""
        self._is_held = False
        """Whether an operator has paused all tasks."""
        self._recent: deque[tuple[records.Record, records.TaskOver]] = deque(maxlen=REMEMBERED)
        """The tasks that have ended last."""
        self._notes = count()
        self._said: dict[UUID, dict[object, tuple[float, Any]]] = {}
        """By task, what is to be said again, with the times at which it was said: the last of its kind, where that is enough."""
        self._since: dict[UUID, int] = {}
        """The first records of the segments in which tasks began."""
        self._task_of: dict[UUID, UUID] = {}
        """The tasks of runs."""
        self._left: dict[UUID, tuple[Became, ...]] = {}
        """The results of runs that are not carried on any more."""

    def in_another_world(self) -> Ongoing:
        """Return the same without anything that goes on."""
        other = Ongoing()
        other._is_held, other._recent = self._is_held, self._recent
        return other

    def __bool__(self) -> bool:
        return bool(self._said)

    @property
    def since(self) -> int:
        """The first record of the segment in which the oldest task began that goes on; of this one if none does."""
        return min(self._since.values(), default=self.segment)

    @property
    def runs(self) -> Mapping[UUID, UUID]:
        """The tasks of the runs that are said again, by run."""
        return self._task_of

    def note(self, time: float, record: records.Record, since: int | None = None) -> None:
        """Note a record of what goes on; `since` is the beginning of its task if that is not in this segment."""
        match record:
            case records.Happened():  # most are
                pass
            case records.TaskAccepted(wanted):
                self._keep(wanted.id, "accepted", time, record, since)
                self._keep(wanted.id, records.TaskHeld, time, records.TaskHeld(wanted.id, self._is_held), since)
            case records.RunMade(run, task) | records.RunStands(records.RunMade(run, task)):
                self._task_of[run] = task
                self._keep(task, run, time, record if isinstance(record, records.RunMade) else record.made, since)
                if isinstance(record, records.RunStands) and record.results is not None:
                    self._left[run] = record.results
            case records.RunSucceeded(run, _, results) | records.RunRetired(run, results) if run in self._task_of:
                self._left[run], said = results, self._said[task := self._task_of[run]]
                if said[run][1].caller is not None:  # the run that has called it knows what it has returned
                    del said[run], self._left[run], self._task_of[run]
                    said.pop((run, "time"), None)
                elif "accepted" not in said and all(one in self._left for one in said if isinstance(one, UUID)):
                    self.forget(task)
            case records.TaskNoted(task, note):
                self._keep(task, type(note) if getattr(note, "is_whole", False) else next(self._notes), time, record, since)
            case records.TaskHeld(None, is_held):
                self._is_held = is_held
            case records.TaskHeld(task) | records.TaskEntered(task) if task is not None:
                self._keep(task, type(record), time, record, since)
            case records.TimeCounted(of):
                self._keep(self._task_of.get(of, of), (of, "time"), time, record, since)
            case records.TaskOver(task) if task in self._said:
                self._recent.append((self._said[task]["accepted"][1], record))
                self.forget(task)
            case _:
                pass

    def again(
        self, now: float, bases: Mapping[int, KnowledgeBase], claims: records.ClaimsBegan, runs: Mapping[UUID, Run]
    ) -> Iterator[tuple[float, records.Record]]:
        """Yield the records that say what is so now, with their times: of what runs share, of tasks, and of runs as they stand."""
        for number, base in bases.items():  # the world first
            using = (run for run in runs.values() if base in (run.knowledge.world, run.knowledge.local))
            asked = min((run.asked_since[number != records.WORLD] for run in using), default=None)
            yield now, records.knowledge_now(number, base, asked)
            if number == records.WORLD and self._is_held:
                yield now, records.TaskHeld(None, is_held=True)
            if number == records.WORLD:
                yield from ((now, record) for ended in self._recent for record in ended)
        if claims.requests or claims.state["_held"] or claims.state["_line"]:
            yield now, claims
        for said in self._said.values():
            for time, record in said.values():
                if isinstance(record, records.RunMade):
                    record = records.RunStands(record, runs[record.run].values(), self._left.get(record.run))
                yield time, record

    def _keep(self, task: UUID, kind: object, time: float, record: records.Record, since: int | None) -> None:
        if task in self._said or isinstance(record, records.TaskAccepted | records.RunMade):
            self._since.setdefault(task, self.segment if since is None else since)
            self._said.setdefault(task, {})[kind] = time, record

    def forget(self, task: UUID) -> None:
        """Forget what was said of a task and its runs."""
        self._since.pop(task, None)
        for run in self._said.pop(task, {}):
            if isinstance(run, UUID):
                del self._task_of[run]
                self._left.pop(run, None)
