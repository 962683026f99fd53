"""What a task shares with others: resources, and a world in which their plans must get on with each other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from uuid import UUID, uuid4

from planner_bridge.footprints import Footprint
from pnm.plan_graph import ActionCall
from pnm.resources import Resources
from pnm.sources.base import Source
from pnm.tasking import OnConflict


@dataclass(frozen=True, slots=True)
class Conflict:
    """A task beside which a plan cannot be carried out.

    Args:
        task: the other one.
        name: what people know it by.
        footprint: what its plan still needs and changes.
        why: what is in the way.
        yields: whether it has a lower priority, and makes way.
    """

    task: UUID
    name: str
    footprint: Footprint
    why: str
    yields: bool = False

    def __str__(self) -> str:
        return f"{self.name}: {self.why}"


@dataclass(frozen=True, slots=True)
class Begun:
    """What another task has begun and not brought to its end: until then the world is not what it will be.

    Args:
        task: the other one.
        name: what people know it by.
        calls: which are under way, being cancelled, or looking for their effects.
        yields: whether it has a lower priority, and makes way.
    """

    task: UUID
    name: str
    calls: tuple[ActionCall, ...]
    yields: bool

    def __str__(self) -> str:
        return f"it has begun {', '.join(str(call.action) for call in self.calls)}"


class Neighbours:
    """Those of a task that is alone: nobody."""

    def conflicts(self, footprint: Callable[[], Footprint], /) -> tuple[Conflict, ...]:
        """Return the tasks that are going on and beside which a plan cannot be carried out whose footprint is worked out if need be."""
        return ()

    def newcomers(self, footprint: Callable[[], Footprint], /) -> tuple[Conflict, ...]:
        """Return those of the conflicts in which it is not said already who makes way."""
        return ()

    def begun(self) -> tuple[Begun, ...]:
        """Return what others have begun and not brought to its end."""
        return ()

    async def preempt(self, conflicts: tuple[Conflict, ...], /) -> None:
        """Have those that yield pause until this task is over; return when nothing of theirs is under way."""

    async def turn(self) -> None:
        """Wait for one's turn to look for a plan; who has looked in vain, until something has changed."""

    def leave(self, *, in_vain: bool) -> None:
        """Note that the search is over; once it is, no more is noted."""


ALONE = Neighbours()


@dataclass(frozen=True)
class Circumstances:
    """What a task shares with others, and how it is known to them.

    Args:
        id: of the task.
        name: what people know it by.
        priority: higher ones come first.
        resources: what calls have for themselves.
        source: who is asked and told what runs do not know.
        neighbours: the other tasks.
        on_conflict: what to do about a goal that cannot be pursued beside theirs.
        new_identity: makes the identities of runs.
    """

    id: UUID = field(default_factory=uuid4)
    name: str = ""
    priority: int = 0
    resources: Resources = field(default_factory=Resources)
    source: Source | None = None
    neighbours: Neighbours = ALONE
    on_conflict: OnConflict = OnConflict.PLAN_AROUND
    new_identity: Callable[[], UUID] = uuid4
