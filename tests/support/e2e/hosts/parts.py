"""The parts of a fleet in a database, with their journals."""

from __future__ import annotations

from planner_bridge.tasks.result import TASKS
from pnm.files.database.place import ServerUrl
from pnm.journal.fleet import Fleet, Part
from pnm.journal.kept import Row, TaskRow
from pnm.journal.records import TaskAccepted, TaskSummary
from pnm.journal.store import JournalFile
from pnm.tasks import TaskEnding, Wanted


class PartJournals(dict[int, JournalFile]):
    """The journals of the parts, by number; a part that is opened again is taken over."""

    def __init__(self, place: ServerUrl) -> None:
        super().__init__()
        self.place = place
        self.opened: list[JournalFile | Fleet] = []

    def open(self, number: int, count: int = 2, origin: str = "files") -> Fleet:
        part = Part(number, count)
        self[number] = JournalFile(part.journal(self.place), 0.0)
        self.opened.append(self[number])
        fleet = Fleet(self.place, TASKS, part, origin, 1000.0)
        self.opened.append(fleet)
        return fleet

    def keep(self, number: int, one: Wanted, ending: TaskEnding | None = None) -> None:
        """Have the journal of a part say that a task is accepted, or has ended."""
        text = TASKS.text(TaskSummary(TaskAccepted(one, 1, 0.0), 0, ending))
        self[number].append([Row(0.0, "", task=TaskRow(one.id.hex, 0.0, ending is not None, text))], {})

    def close(self) -> None:
        """Close all."""
        for one in self.opened:
            one.close()
