"""The context of a task: its problem, where its actions are carried out, and what it shares with other tasks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import inf
from typing import Protocol
from uuid import UUID

from planner_bridge.model.forbidden_actions import ForbiddenCall, calls_acquiring, calls_served_by
from planner_bridge.model.problem import Problem
from planner_bridge.model.projected_state import present_state
from planner_bridge.ordering.forecast import Forecast
from planner_bridge.ordering.interference import ReadWriteSets, read_write_sets
from planner_bridge.tasks.control import TaskControl
from planner_bridge.tasks.replanning import History
from planner_bridge.tasks.settings import Settings, TaskObserver
from planner_bridge.tasks.task import Task
from pnm.actions.backend import Backend
from pnm.core.execution.questions import EvaluationContext
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.conditions import TRUE
from pnm.core.machine.bindings import goal_data
from pnm.core.machine.plan_graph import ActionCall, GroundAction
from pnm.core.resources import Resources
from pnm.journal.journal import Journal
from pnm.knowledge.source import Source
from pnm.tasks import OnConflict


@dataclass(frozen=True, slots=True)
class Conflict:
    """A task beside which a plan cannot be carried out.

    Args:
        task: the other task.
        name: its name for people.
        footprint: what its plan still needs and changes.
        why: the fact or function in the way.
        yields: whether it has a lower priority, so that it can be preempted.
        until: the seconds from now after which it is expected to be out of the way.
    """

    task: UUID
    name: str
    footprint: ReadWriteSets
    why: str
    yields: bool = False
    until: float = inf

    def __str__(self) -> str:
        return f"{self.name}: {self.why}"


@dataclass(frozen=True, slots=True)
class RunningCalls:
    """Calls of another task that have begun and not ended: until then the world is not what it will be.

    Args:
        task: the other task.
        name: its name for people.
        calls: which are under way, being cancelled, or waiting for their effects.
        yields: whether it has a lower priority, so that it can be preempted.
    """

    task: UUID
    name: str
    calls: tuple[ActionCall, ...]
    yields: bool

    def __str__(self) -> str:
        return f"it has begun {', '.join(str(call.action) for call in self.calls)}"


class Scheduler(Protocol):
    """The other tasks, as the one that is to be planned sees them."""

    def conflicts(self, task: Task, footprint: Callable[[], ReadWriteSets]) -> tuple[Conflict, ...]:
        """Return the active tasks that conflict with a plan of the task. `footprint` is called only if there are any."""

    def new_conflicts(self, task: Task, footprint: Callable[[], ReadWriteSets]) -> tuple[Conflict, ...]:
        """Return the conflicts in which neither task has been preempted for the other yet."""

    def forecasts(self, task: Task) -> Mapping[Task, Forecast]:
        """Return what is expected of the plans of other active tasks that do not yield to this one."""

    def runs(self) -> tuple[Run, ...]:
        """Return the current runs of all tasks."""

    def running_calls(self, task: Task) -> tuple[RunningCalls, ...]:
        """Return the calls of other tasks that have begun and not ended."""

    async def preempt(self, task: Task, conflicts: tuple[Conflict, ...]) -> None:
        """Have the tasks of lower priority pause until this task is over; return when nothing of theirs is under way."""

    def release(self, task: Task) -> None:
        """Note that the task has no plan in mind any more: those that waited for it may try again."""

    async def begin_turn(self, task: Task) -> None:
        """Wait for the turn of the task to plan, with no plan in mind; one whose attempt failed waits for a change first."""

    def end_turn(self, task: Task, *, failed: bool, again: float = inf) -> None:
        """End the turn of the task to plan. After so many seconds it may try again though nothing is known to have changed."""


@dataclass(frozen=True)
class TaskContext:
    """A goal, and everything that is there to reach it.

    Args:
        task: the task.
        problem: its goal is pursued.
        knowledge: of the runs of the task, over the world that all tasks share.
        backend: carries the actions out.
        settings: planner, bindings, limits and policies.
        resources: shared by the calls of all tasks.
        source: answers what runs do not know; None for none.
        helper: the person who is asked for help when the task cannot go on; None for none.
        scheduler: knows the other tasks.
        on_conflict: what to do about a goal that is in conflict with those of other tasks.
        new_run_id: makes the identities of runs.
        journal: records the runs.
    """

    task: Task
    problem: Problem
    knowledge: Layered
    backend: Backend
    settings: Settings
    resources: Resources
    source: Source | None
    helper: Source | None
    scheduler: Scheduler
    on_conflict: OnConflict
    new_run_id: Callable[[], UUID]
    journal: Journal
    since: float | None = None
    """When the world was as the problem has it, on the clock of the event loop, if not when the task begins here."""

    @property
    def control(self) -> TaskControl:
        """The control of the task."""
        return self.task.control

    @property
    def observer(self) -> TaskObserver:
        """All who listen to the task."""
        return self.task.observer

    @property
    def world(self) -> KnowledgeBase:
        """The knowledge that all tasks share."""
        return self.knowledge.world

    @property
    def present(self) -> KnowledgeBase:
        """What is known of the world, with what calls have begun and sensors have not reported yet: what plans are judged by."""
        return present_state(self.world, self.scheduler.runs())

    def under_way(self, run: Run) -> ReadWriteSets:
        """Return what the calls of a run need and change that are still under way."""
        return read_write_sets(run.unsettled, TRUE, self.world)

    def unusable(self, history: History) -> frozenset[ForbiddenCall]:
        """Return the calls that would fail: their action server was not there too often, a resource is withheld, or a value is lacking."""
        bindings = self.settings.bindings
        names = self.resources.withheld_from(history.lacking)
        served = calls_served_by(self.problem, bindings, history.absent_servers(self.settings.limits))
        # With a source outside, something new may be known without a trace here.
        uninformed = history.uninformed if self.source is None else ()
        lacking = {ForbiddenCall.of(action) for action in uninformed if self.lacks_value(action)}
        return served | calls_acquiring(self.problem, bindings, names.keys()) | lacking

    def lacks_value(self, action: GroundAction) -> bool:
        """Return whether the goal of the action has a field for which nothing here has a value."""
        binding = self.settings.bindings.of(action.name)
        fields = self.backend.client.goal_fields(action)
        return bool(goal_data(action, binding, fields, EvaluationContext(self.knowledge, action, binding))[1])

    def forbidden(self, history: History) -> frozenset[ForbiddenCall]:
        """Return the calls that no plan may use now."""
        return history.forbidden(self.settings.limits) | self.unusable(history)
