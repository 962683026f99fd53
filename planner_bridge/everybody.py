"""All who listen to tasks, as one."""

from __future__ import annotations

from collections.abc import Callable
from uuid import UUID

from pnm.tasking import Moment, TaskEnding, TaskListener


class Everybody(TaskListener):
    """Passes on what happens to all who listen. The mutable state is who does."""

    def __init__(self) -> None:
        self._listeners: list[TaskListener] = []

    def add(self, listener: TaskListener) -> Callable[[], None]:
        """Tell the listener from now on; return what stops that."""
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener)

    def changed(self, task: UUID) -> None:
        """Note that the status of a task is another one."""
        for one in tuple(self._listeners):
            one.changed(task)

    def planned(self, task: UUID) -> None:
        """Note that a task has another plan."""
        for one in tuple(self._listeners):
            one.planned(task)

    def happened(self, moment: Moment) -> None:
        """Note an event."""
        for one in tuple(self._listeners):
            one.happened(moment)

    def moved(self, task: UUID) -> None:
        """Note that tokens have moved."""
        for one in tuple(self._listeners):
            one.moved(task)

    def ended(self, task: UUID, ending: TaskEnding) -> None:
        """Note that a task is over."""
        for one in tuple(self._listeners):
            one.ended(task, ending)
