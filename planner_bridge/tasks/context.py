"""The context of a task: its problem, where its actions are carried out, and what it shares with other tasks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from uuid import UUID

from planner_bridge.model.forbidden_actions import ForbiddenCall, calls_acquiring
from planner_bridge.model.problem import Problem
from planner_bridge.tasks.control import TaskControl
from planner_bridge.tasks.replanning import History
from planner_bridge.tasks.scheduling.planning_queue import PlanningQueue
from planner_bridge.tasks.scheduling.preemption import Preemption
from planner_bridge.tasks.settings import Settings, TaskObserver
from planner_bridge.tasks.task import Task
from pnm.actions.backend import Backend
from pnm.core.execution.resources import Resources
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.knowledge.sources.source import Source
from pnm.tasks import OnConflict


@dataclass(frozen=True)
class TaskContext:
    """A goal, and everything that is there to reach it.

    Args:
        task: the task.
        problem: its goal is pursued.
        knowledge: of the runs of the task, over the world that all tasks share.
        site: where actions are carried out.
        settings: planner, bindings, limits and policies.
        resources: shared by the calls of all tasks.
        source: answers what runs do not know; None for none.
        preemption: finds and preempts tasks in conflict.
        queue: where tasks wait for their turn to plan.
        on_conflict: what to do about a goal that is in conflict with those of other tasks.
        new_run_id: makes the identities of runs.
    """

    task: Task
    problem: Problem
    knowledge: Layered
    site: Backend
    settings: Settings
    resources: Resources
    source: Source | None
    preemption: Preemption
    queue: PlanningQueue[Task]
    on_conflict: OnConflict
    new_run_id: Callable[[], UUID]

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

    def withheld(self, history: History) -> frozenset[ForbiddenCall]:
        """Return the calls that need a resource that was waited for in vain and is still withheld."""
        names = self.resources.withheld_from(history.lacking)
        return calls_acquiring(self.problem.domain, self.settings.bindings, names.keys())

    def forbidden(self, history: History) -> frozenset[ForbiddenCall]:
        """Return the calls that no plan may use now."""
        return history.forbidden(self.settings.limits) | self.withheld(history)
