"""The log of what happens to tasks: a line per event, at the level that it deserves."""

from __future__ import annotations

from pnm.tasks import EVENTS, TaskListener, TraceEvent


class EventLog(TaskListener):
    """Logs the events of tasks to `pnm.tasks.EVENTS`."""

    def happened(self, moment: TraceEvent) -> None:
        """Log an event, but not all feedback and every transition that fires."""
        if not moment.kind.is_frequent:
            text = ": ".join(filter(None, (moment.kind.word, moment.subject, moment.text)))
            EVENTS.log(moment.level, "%s %s", moment.task.hex[:8], text)
