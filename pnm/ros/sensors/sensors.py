"""The sensors of a file: topics that are subscribed to, and services that are asked.

Publishers and their types are looked up in the ROS graph periodically.
"""

from __future__ import annotations

import asyncio
import logging
from typing import Any, Final

from pnm.core.knowledge_base import KnowledgeBase
from pnm.errors import InputError
from pnm.knowledge.sensor_model import ByService, ByTopic, Sensing, instances
from pnm.ros.node.ros_thread import RosThread
from pnm.ros.sensors.sensor import SensorRecorder, SensorUse
from pnm.ros.sensors.service_sensor import ServiceSensor
from pnm.ros.sensors.topic_sensor import TopicSensor

LOOK: Final = 0.5
"""Seconds between two looks for new publishers."""
FIRST: Final = 3.0
"""Seconds to wait for the first message of publishers and services that are there."""

_log = logging.getLogger(__name__)


class Sensors:
    """The sensors of a file, for every choice of their objects. To be used on the event loop's thread.

    The mutable state is the recorders, the tasks that ask services, and when the last action has ended.
    `lag` is that of sensors that do not specify it, in seconds.
    Raises `InputError` if two sensors report the same facts, or one reports derived facts. A sensor whose type is not installed, or
    lacks a field, is refused: its use says why.
    """

    def __init__(self, ros: RosThread, sensing: Sensing, knowledge: KnowledgeBase, lag: float) -> None:
        self._ros = ros
        self.instances = instances(sensing, knowledge.objects)
        """The sensors for every choice of their objects, as the file has them."""
        for name in sorted(sensing.names & knowledge.rules.derived):
            raise InputError(f"facts of {name} follow from rules; they are neither set nor sensed")
        self._recorders = [SensorRecorder(instance, knowledge) for instance in self.instances]
        self._topics: list[TopicSensor] = []
        self._polls: list[ServiceSensor] = []
        for recorder in self._recorders:
            match recorder.instance.sensor.way:
                case ByService() as way:
                    self._polls.append(ServiceSensor(ros, recorder, way))
                case ByTopic():
                    self._topics.append(TopicSensor(ros, recorder))
        self._sensors: tuple[TopicSensor | ServiceSensor, ...] = (*self._topics, *self._polls)
        self._tasks: list[asyncio.Task[None]] = []
        self._lag = lag
        self._ended = (0, 0.0)
        self._timer: Any = None
        for name, late in sensing.lags(lag).items():
            knowledge.sense((name,), lag=late)

    def __repr__(self) -> str:
        return f"<Sensors: {len(self._topics)} topics, {len(self._polls)} services>"

    async def open(self) -> None:
        """Subscribe and ask, and wait for the first message of all publishers and services that are there."""
        for sensor in self._sensors:
            await self._ros.ask(sensor.resolve)
        if self._topics:
            self._timer = await self._ros.ask(lambda: self._ros.timer(LOOK, self._look))
        self._tasks = [asyncio.create_task(poll.poll()) for poll in self._polls]
        if self._recorders:
            await self._wait_for_first()
        for recorder in self._recorders:
            recorder.is_open = True

    def uses(self) -> tuple[SensorUse, ...]:
        """Return how the sensors, once they are open, are doing."""
        return tuple(
            SensorUse(one.recorder.instance, one.name, one.recorder.heard.is_set(), one.recorder.refused, one.recorder.is_stale)
            for one in self._sensors
        )

    def expect_news(self) -> None:
        """Note that an action has ended: what topics have said before may not be so any more."""
        self._ended = self._ros.node.get_clock().now().nanoseconds, asyncio.get_running_loop().time()

    async def refresh(self) -> None:
        """Have all services asked at once, and wait for their answers, each for twice its limit at most.

        Topics are waited for that have said nothing since the last action has ended, each until its lag after that is over.
        """
        since, ended = self._ended
        topics = (topic.refresh(since, ended + topic.recorder.instance.sensor.lag_or(self._lag)) for topic in self._topics)
        await asyncio.gather(*topics, *(poll.refresh() for poll in self._polls))

    async def close(self) -> None:
        """Unsubscribe, and stop asking."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        for recorder in self._recorders:
            recorder.close()
        await self._ros.ask(self._destroy)

    async def _wait_for_first(self) -> None:
        async def hear_all() -> None:
            for recorder in self._recorders:
                await recorder.heard.wait()

        all_heard = asyncio.ensure_future(hear_all())
        settled = asyncio.ensure_future(self._ros.settled())
        try:
            await asyncio.wait((all_heard, settled), return_when=asyncio.FIRST_COMPLETED)
            await self._ros.ask(self._look)  # the timer's last look may be older than the publishers that are there
            if [sensor for sensor in self._sensors if not sensor.recorder.heard.is_set() and await sensor.is_there()]:
                await asyncio.wait((all_heard,), timeout=FIRST)
        finally:
            all_heard.cancel()
            settled.cancel()

    # on the ROS thread

    def _look(self) -> None:
        for topic in self._topics:
            topic.look()

    def _destroy(self) -> None:
        if self._timer is not None:
            self._ros.node.destroy_timer(self._timer)
        for topic in self._topics:
            topic.destroy()
