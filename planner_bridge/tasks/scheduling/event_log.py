"""The log of what happens to tasks: a line per event, at the level that it deserves. And their states, for the journal."""

from __future__ import annotations

from uuid import UUID

from pnm.journal.journal import Journal
from pnm.tasks import EVENTS, TaskListener, TaskState, TraceEvent


class EventLog(TaskListener):
    """Logs the events of tasks to `pnm.tasks.EVENTS`."""

    def happened(self, moment: TraceEvent) -> None:
        """Log an event, but not all feedback and every transition that fires."""
        if not moment.kind.is_frequent:
            text = ": ".join(filter(None, (moment.kind.word, moment.subject, moment.text)))
            EVENTS.log(moment.level, "%s %s", moment.task.hex[:8], text)


class StateLog(TaskListener):
    """Keeps the states of tasks in a journal: whoever reads it tells the same of a task as its status does."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal

    def entered(self, task: UUID, state: TaskState, reason: str) -> None:
        """Keep the state of a task."""
        self._journal.entered(task, state, reason)
