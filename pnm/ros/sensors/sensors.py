"""All sensors of a file: topics that are listened to, and services that are polled.

Which publishers there are, and of which type, is looked up in the ROS graph again and again.
"""

from __future__ import annotations

import asyncio
import logging
from typing import Any, Final

from pnm.core.knowledge_base import KnowledgeBase
from pnm.errors import InputError
from pnm.knowledge.sensor_model import ByService, Instance, Sensing, instances
from pnm.ros.node.ros_thread import RosThread
from pnm.ros.sensors.sensor import Sense, checked
from pnm.ros.sensors.service_sensor import PolledSensor
from pnm.ros.sensors.topic_sensor import TopicSensor

LOOK: Final = 0.5
"""Seconds between two looks for publishers that are new."""
FIRST: Final = 3.0
"""Seconds that somebody who is there may take to say something for the first time."""

_log = logging.getLogger(__name__)


class Sensors:
    """All sensors of a file, from `open` to `close`. To be used on the event loop's thread.

    The mutable state is the sensors for every choice of objects, and the tasks that poll services.

    Args:
        lag: seconds that reports may be late of sensors that do not say so themselves.

    Raises:
        InputError: two sensors speak of the same, of derived facts, or a type is not installed
            or does not have a field that is looked for.
    """

    def __init__(self, ros: RosThread, sensing: Sensing, knowledge: KnowledgeBase, lag: float) -> None:
        self._ros = ros
        found = instances(sensing, knowledge.objects)
        for name in sorted(sensing.names & knowledge.rules.derived):
            raise InputError(f"facts of {name} follow from rules; they are neither set nor sensed")
        for sensor in sensing.sensors:
            if sensor.type is not None:
                checked(next((one for one in found if one.sensor is sensor), Instance(sensor, {})), sensor.type)
        self._senses = [Sense(instance, knowledge) for instance in found]
        self._topics = [TopicSensor(ros, sense) for sense in self._senses if not isinstance(sense.instance.sensor.way, ByService)]
        self._polls = [PolledSensor(ros, sense, way) for sense in self._senses if isinstance(way := sense.instance.sensor.way, ByService)]
        self._tasks: list[asyncio.Task[None]] = []
        self._timer: Any = None
        for name, late in sensing.lags(lag).items():
            knowledge.sense((name,), lag=late)

    def __repr__(self) -> str:
        return f"<Sensors: {len(self._topics)} topics, {len(self._polls)} services>"

    async def open(self) -> None:
        """Begin to listen and to ask, and wait until everybody has been heard who is there.

        Raises:
            InputError: somebody has a type that does not have a field that is looked for.
        """
        await self._ros.ask(self._resolve)
        if self._topics:
            self._timer = await self._ros.ask(lambda: self._ros.timer(LOOK, self._look))
        self._tasks = [asyncio.create_task(poll.ask_on()) for poll in self._polls]
        if self._senses:
            await self._first()
        for sense in self._senses:
            if sense.refused is not None:
                raise sense.refused

    async def close(self) -> None:
        """Stop listening and asking."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        for sense in self._senses:
            sense.close()
        await self._ros.ask(self._destroy)

    async def _first(self) -> None:
        everybody = asyncio.ensure_future(self._all_heard())
        settled = asyncio.ensure_future(self._ros.settled())
        try:
            await asyncio.wait((everybody, settled), return_when=asyncio.FIRST_COMPLETED)
            sources: list[TopicSensor | PolledSensor] = [*self._topics, *self._polls]
            if [one for one in sources if not one.sense.heard.is_set() and await one.is_there()]:
                await asyncio.wait((everybody,), timeout=FIRST)
        finally:
            everybody.cancel()
            settled.cancel()
        for sense in self._senses:
            if not sense.heard.is_set():
                _log.warning("nothing has been heard on %s yet", sense.instance.name)

    async def _all_heard(self) -> None:
        for sense in self._senses:
            await sense.heard.wait()

    # on the ROS thread

    def _resolve(self) -> None:
        for topic in self._topics:
            topic.resolve()
        for poll in self._polls:
            poll.resolve()

    def _look(self) -> None:
        for topic in self._topics:
            topic.look()

    def _destroy(self) -> None:
        if self._timer is not None:
            self._ros.node.destroy_timer(self._timer)
        for topic in self._topics:
            topic.destroy()
