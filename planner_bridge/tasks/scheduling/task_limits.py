"""How many tasks a task manager takes, and what it does about conflicts."""

from __future__ import annotations

from dataclasses import dataclass

from pnm.tasks import OnConflict


@dataclass(frozen=True, slots=True)
class TaskLimits:
    """The limits of a task manager.

    Args:
        active: the number of tasks that go on at the same time.
        queue: the number of tasks that wait besides.
        on_conflict: what to do about a goal that is in conflict with those of other tasks, if the goal does not specify it.
    """

    active: int = 20
    queue: int = 100
    on_conflict: OnConflict = OnConflict.PLAN_AROUND
