"""The journal of runs, as they use it; this one keeps nothing. `pnm.journal.written_journal` writes a file or a database."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Final, NotRequired, TypeAlias, TypedDict, Unpack
from uuid import UUID

from pnm.clock import TimeUsed
from pnm.core.execution.call_data import GoalFields
from pnm.core.execution.events import Command, Event, Observer
from pnm.core.execution.handover import UnderWay
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.resources import Resources
from pnm.journal.kept import StandBys
from pnm.journal.replay import ReplayedRun
from pnm.tasks import TaskEnding, TaskState, Wanted

Perform: TypeAlias = Callable[[Sequence[Command]], None]
"""Carries out commands."""


class RunOptions(TypedDict):
    """The options of a `Run` that is made by a journal, as its constructor has them."""

    id: UUID
    bindings: Bindings
    goal_fields: GoalFields
    asks: NotRequired[bool]
    observer: NotRequired[Observer | None]
    origin: NotRequired[float | None]
    resources: NotRequired[Resources | None]
    task: NotRequired[UUID | None]
    priority: NotRequired[int]
    adopted: NotRequired[Mapping[int, UnderWay]]


class WorldOptions(TypedDict, total=False):
    """What a journal begins with besides, as in `pnm.journal.records.SharedBegan`."""

    prefix: bytes
    origin: str
    command: tuple[str, ...]
    seal: str
    loaded: tuple[str, ...]


class Journal:
    """The journal of runs that are not recorded."""

    blocked: str = ""
    """Why nothing can be kept at present; empty if it can."""

    def begin(
        self, knowledge: KnowledgeBase, resources: Resources, anew: Callable[[], None] = lambda: None, **world: Unpack[WorldOptions]
    ) -> None:
        """Record what runs share: the knowledge as `anew` leaves it, what changes in it from then on, and the capacities of resources."""
        anew()

    def may_act(self) -> bool:
        """Return whether something may leave this process; asked by any thread, right before that."""
        return True

    def stand_bys(self) -> StandBys:
        """Return the processes that stand by to go on with it, as far as they can be seen."""
        return StandBys()

    def make_run(
        self,
        machine: PetriNetMachine,
        knowledge: Layered,
        *,
        name: str = "",
        caller: UUID | None = None,
        **options: Unpack[RunOptions],
    ) -> Run:
        """Return a run that is recorded; `name` is that of its task, for people, `caller` the request of the plan that has called it."""
        return Run(machine, knowledge, **options)

    def handle(self, run: Run, event: Event, now: float, perform: Perform) -> None:
        """Have the run handle an event; perform the commands once the event and they are kept."""
        perform(run.handle(event, now))

    def go_on(self, replayed: ReplayedRun, observer: Observer | None, goal_fields: GoalFields) -> Run:
        """Return a run that was replayed, connected to what it is to go on with."""
        replayed.run.observer = observer or Observer()
        replayed.goal_fields = goal_fields
        return replayed.run

    def succeeded(self, run: Run, successor: Run) -> None:
        """Record that a run has taken the place of another."""

    def retired(self, run: Run) -> None:
        """Record that a run is not carried on."""

    def confirmed(self, request: UUID, resources: Resources) -> None:
        """Record that the server of a request that was given up has confirmed its end, and free what it has kept."""
        resources.confirm(request)

    # --- tasks ----------------------------------------------------------------------------------

    def accepted(self, wanted: Wanted, order: int) -> None:
        """Keep a task that is about to be accepted.

        Raises:
            JournalError: it cannot be kept.
        """

    def held(self, task: UUID | None, *, is_held: bool) -> None:
        """Record that an operator has paused a task, or those that are still to come, or has let them go on."""

    def entered(self, task: UUID, state: TaskState, reason: str) -> None:
        """Record that a task is in another state."""

    def noted(self, task: UUID, note: object) -> None:
        """Record what a task needs to know when it goes on in another process."""

    def counted(self, of: UUID, used: TimeUsed) -> None:
        """Record how much of its limit a task has used, or a run of a plan."""

    def over(self, task: UUID, ending: TaskEnding, then: Callable[[], None] = lambda: None) -> None:
        """Keep how a task has ended, and do something then."""
        then()


NO_JOURNAL: Final = Journal()
