"""What is pursued, where, and how: what all parts of a pursuit are given.

What a task shares with others: resources, and a world in which their plans must get on with each other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from uuid import UUID, uuid4

from planner_bridge.model.forbidden_actions import ForbiddenCall, calls_acquiring
from planner_bridge.model.problem import Problem
from planner_bridge.ordering.interference import ReadWriteSets
from planner_bridge.tasks.replanning import History
from planner_bridge.tasks.result import Stopwatch
from planner_bridge.tasks.settings import Settings, TaskObserver
from pnm.actions.backend import Backend
from pnm.core.execution.resources import Resources
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.machine.plan_graph import ActionCall
from pnm.knowledge.sources.source import Source
from pnm.tasks import OnConflict


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
    footprint: ReadWriteSets
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

    def conflicts(self, footprint: Callable[[], ReadWriteSets], /) -> tuple[Conflict, ...]:
        """Return the tasks that are going on and beside which a plan cannot be carried out whose footprint is worked out if need be."""
        return ()

    def newcomers(self, footprint: Callable[[], ReadWriteSets], /) -> tuple[Conflict, ...]:
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


@dataclass(frozen=True)
class Mission:
    """A goal, and everything that is there to reach it.

    Args:
        problem: whose goal is pursued.
        site: where actions are carried out.
        settings: planner, bindings, limits and policies.
        observer: is told what happens.
        seconds: measures where the time goes.
        knowledge: what is known.
        circumstances: what is shared with other tasks.
    """

    problem: Problem
    site: Backend
    settings: Settings
    observer: TaskObserver
    seconds: Stopwatch
    knowledge: Layered
    circumstances: Circumstances = field(default_factory=Circumstances)

    def kept(self, history: History) -> frozenset[ForbiddenCall]:
        """Return the calls that need what was waited for in vain, as far as that is still withheld."""
        names = self.circumstances.resources.withheld_from(history.lacking)
        return calls_acquiring(self.problem.domain, self.settings.bindings, names.keys())

    def forbidden(self, history: History) -> frozenset[ForbiddenCall]:
        """Return the calls that no plan may use as things are."""
        return history.forbidden(self.settings.limits) | self.kept(history)

    @property
    def world(self) -> KnowledgeBase:
        """What all tasks share of what is known."""
        return self.knowledge.world
