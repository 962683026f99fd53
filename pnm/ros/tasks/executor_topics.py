"""What is told about tasks and knowledge on topics, to whoever wants to see what goes on."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Final
from uuid import UUID

from pnm.ros.node.publisher import Publisher
from pnm.ros.node.ros_thread import RosThread
from pnm.ros.node.throttle import Throttle
from pnm.ros.tasks.task_messages import Fields, marking_fields, moment_fields, net_fields, plan_fields, status_fields
from pnm.tasks import ServedWorld, TaskEnding, TaskListener, Tasks, TaskState, TaskStatus, TraceEvent

PERIOD: Final = 0.1
"""Seconds between two messages about all tasks, and between two about where the tokens of one net are."""


class TaskTopics(TaskListener):
    """The topics under ``executor``, and ``knowledge/changes``.

    Nets and markings are large, so they are worked out only while somebody listens. The mutable state is what is to be told
    soon, the nets as they were written, and how many changes of the knowledge were told.

    Args:
        world: says what has changed in it.
        paused: tells whether all tasks are paused.
    """

    def __init__(self, ros: RosThread, tasks: Tasks, world: ServedWorld, paused: Callable[[], bool]) -> None:
        self._ros = ros
        self._tasks = tasks
        self._world = world
        self._paused = paused
        self._loop = asyncio.get_running_loop()
        self._soon: Throttle[Callable[[], None]] = Throttle(self._loop, PERIOD, lambda tell: tell())
        self._moved: Throttle[UUID] = Throttle(self._loop, PERIOD, self._tell_marking)
        self._nets: dict[UUID, tuple[int, Fields]] = {}
        self._changes = 0
        self._stops: list[Callable[[], None]] = []
        self._status = Publisher(ros, "pnm_interfaces/msg/ExecutorStatus", "executor/status", is_latched=True)
        self._plan = Publisher(ros, "pnm_interfaces/msg/Plans", "executor/plan", is_latched=True)
        self._net = Publisher(ros, "pnm_interfaces/msg/Nets", "executor/net", is_latched=True, matched=self._note_nets)
        self._marking = Publisher(ros, "pnm_interfaces/msg/Marking", "executor/marking", matched=self._note_markings)
        self._trace = Publisher(ros, "pnm_interfaces/msg/TraceEvent", "executor/trace")
        self._change = Publisher(ros, "pnm_interfaces/msg/KnowledgeChange", "knowledge/changes")

    def __repr__(self) -> str:
        return f"<TaskTopics {self._soon}>"

    @property
    def _topics(self) -> tuple[Publisher, ...]:
        return (self._status, self._plan, self._net, self._marking, self._trace, self._change)

    async def open(self) -> None:
        """Begin to tell."""
        for topic in self._topics:
            await topic.open()
        self._stops += [self._tasks.listen(self), self._world.follow(self._known)]
        self.note()

    async def close(self) -> None:
        """Tell nothing more."""
        for stop in self._stops:
            stop()
        self._stops.clear()
        self._soon.close()
        self._moved.close()
        for topic in self._topics:
            await topic.close()

    def note(self) -> None:
        """Have it told how everything is."""
        self._soon.note(self._tell_status)
        self._soon.note(self._tell_plans)

    # what happens to tasks

    def changed(self, task: UUID) -> None:
        """Have the status told; the plan as well, because calls of it may have begun or ended."""
        self.note()

    def planned(self, task: UUID) -> None:
        """Have plans and nets told."""
        self.note()
        self._note_nets()
        self.moved(task)

    def happened(self, moment: TraceEvent) -> None:
        """Tell of an event."""
        if self._trace.subscriptions:
            self._trace.publish(lambda: moment_fields(moment, ahead(self._ros, self._loop)))

    def moved(self, task: UUID) -> None:
        """Have it told where the tokens are."""
        if self._marking.subscriptions:
            self._moved.note(task)

    def ended(self, task: UUID, ending: TaskEnding) -> None:
        """Tell how things are, at once: whoever reads the result of the task must not read later that it goes on."""
        self._soon.at_once(self._tell_status)
        self._soon.note(self._tell_plans)
        self._moved.forget(task)
        self._nets.pop(task, None)
        self._note_nets()

    # telling it

    def _note_nets(self) -> None:
        if self._net.subscriptions:
            self._soon.note(self._tell_nets)

    def _note_markings(self) -> None:
        for status in self._going_on():
            self._moved.note(status.id)

    def _going_on(self) -> tuple[TaskStatus, ...]:
        return tuple(status for status in self._tasks.status() if status.state is not TaskState.OVER)

    def _tell_status(self) -> None:
        tasks = [status_fields(status) for status in self._tasks.status()]
        paused = self._paused()
        self._status.publish(lambda: {"stamp": ahead(self._ros, self._loop) + self._loop.time(), "paused": paused, "tasks": tasks})

    def _tell_plans(self) -> None:
        plans = [(status, *self._tasks.plan(status.id)) for status in self._going_on()]
        self._plan.publish({"plans": [plan_fields(status.id, status.goal, number, steps) for status, number, steps in plans if steps]})

    def _tell_nets(self) -> None:
        going_on = [status.id for status in self._going_on()]
        for task in going_on:
            found = self._tasks.net(task)
            if found is not None and (task not in self._nets or self._nets[task][0] != found[0]):
                self._nets[task] = found[0], net_fields(task, *found[:2])
        self._net.publish({"nets": [self._nets[task][1] for task in going_on if task in self._nets]})

    def _tell_marking(self, task: UUID) -> None:
        found = self._tasks.net(task)
        if found is not None:
            number, _, marking = found
            self._marking.publish(marking_fields(task, number, marking))

    def _known(self, changes: Mapping[str, object]) -> None:
        self._changes += 1
        fields, at = {**changes, "sequence": self._changes}, self._loop.time()
        self._change.publish(lambda: {**fields, "stamp": ahead(self._ros, self._loop) + at})


def ahead(ros: RosThread, loop: asyncio.AbstractEventLoop) -> float:
    """Return what the clock of the node is ahead of that of the event loop, in seconds; only on the ROS thread."""
    return float(ros.node.get_clock().now().nanoseconds * 1e-9 - loop.time())
