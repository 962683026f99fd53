"""Laws that hold at every moment, whatever tasks are paused, resumed, preempted or cancelled."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from planner_bridge.ordering.interference import interference, read_write_sets
from planner_bridge.tasks.plan_execution import PlanExecution
from planner_bridge.tasks.task import Task
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import TRUE
from pnm.core.machine.plan_graph import ActionCall


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
