"""Laws that hold at every moment, whatever tasks are held, paused, resumed, preempted or cancelled."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Final
from uuid import UUID

from planner_bridge.ordering.interference import interference, read_write_sets
from planner_bridge.tasks.plan_execution import PlanExecution
from planner_bridge.tasks.task import Task
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import TRUE
from pnm.core.machine.plan_graph import ActionCall
from pnm.tasks import TaskState

QUIET: Final = 200.0
"""Virtual seconds for which nothing happens, at most, where nothing is waited for: longer than any back-off, lag or limit of a server."""


def standing_still(tasks: Iterable[Task], quiet: Mapping[UUID, float]) -> Iterator[str]:
    """Yield the tasks that make no progress although nothing of theirs is under way, nothing is awaited, and nobody has paused them.

    Of tasks that wait for each other one has to go on: if all are quiet, none of them may wait.

    Args:
        tasks: that are not over.
        quiet: the seconds for which nothing has happened to each.
    """
    begun = [task for task in tasks if task.control.has_begun and not task.is_held]
    free = [task for task in begun if not (_live_requests(task) or task.control.awaits_help or task.control.awaits_hands or _asks(task))]
    is_all_quiet = free == begun and all(quiet[task.id] > QUIET for task in free)
    for task in free:
        waits_for_others = task.control.is_paused or task.control.state is TaskState.QUEUED
        if quiet[task.id] > QUIET and (is_all_quiet or not waits_for_others):
            yield f"nothing has happened to {task.name} for {quiet[task.id]:g} s: {task.control.state.word} {task.control.reason}"


def _live_requests(task: Task) -> tuple[UUID, ...]:
    run = task.control.run
    return run.open_requests if run and task.control.execution else ()


def _asks(task: Task) -> bool:
    return task.control.awaits_answers


def contradictory_requests(sender: Task, call: str, tasks: Iterable[Task], world: KnowledgeBase) -> Iterator[str]:
    """Yield the live requests of other tasks that contradict a call that is being sent: one changes what the other needs.

    Nothing is yielded for plans that were written by people: they are not checked for interference.
    """
    mine = [one for one in _live(sender) if str(one.action) == call]
    for task in tasks:
        for other in _live(task) if task is not sender else ():
            for one in mine:
                if why := interference(*(read_write_sets([live], TRUE, world) for live in (one, other))):
                    yield f"{one.action} of {sender.name} is sent while {other.action} of {task.name} is under way: {why}"


def _live(task: Task) -> list[ActionCall]:
    run = task.control.run
    return [*run.open_calls.values()] if run and isinstance(task.control.execution, PlanExecution) else []
