"""A sensor whose messages are the answers of a service that is asked."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Iterable
from contextlib import suppress
from functools import partial
from typing import Final

from pnm.errors import InputError
from pnm.knowledge.sensor_model import ByService
from pnm.knowledge.source import SourceError
from pnm.ros.node.ros_thread import RosThread
from pnm.ros.node.service_client import ServiceClient
from pnm.ros.node.typed_fields import value_at
from pnm.ros.sensors.sensor import SensorRecorder, checked, resolved

_log = logging.getLogger(__name__)


RETRY: Final = 1.0
"""Seconds after which a service that has not answered is asked again."""


class ServiceSensor:
    """A sensor that asks one service.

    The mutable state is its client, once its type is known, whether there is a reason to ask, who waits for an answer to a request
    that is still to be sent, and whether nothing is asked any more.
    """

    def __init__(self, ros: RosThread, recorder: SensorRecorder, way: ByService) -> None:
        self.recorder = recorder
        self._ros = ros
        self._way = way
        self._client: ServiceClient | None = None
        self._is_wanted = asyncio.Event()
        self._waiting: list[asyncio.Future[None]] = []
        self._is_over = False

    async def is_there(self) -> bool:
        """Return True if there is such a service."""
        return bool(await self._ros.ask(self._types))

    async def refresh(self) -> None:
        """Ask at once, and wait for the answer; for twice the limit at most, since a request may be under way."""
        if not self._is_over:
            answered = asyncio.get_running_loop().create_future()
            self._waiting.append(answered)
            self._is_wanted.set()
            await answered

    async def poll(self) -> None:
        """Ask until cancelled, or until the service's type turns out not to fit the sensor. New errors are logged once."""
        last_error, waiting = "", self._waiting
        try:
            while True:
                self._is_wanted.clear()
                waiting, self._waiting = self._waiting, []
                error = await self._ask()
                _release(waiting)
                if error and error != last_error and self.recorder.is_open:  # before, the look at all sensors says it
                    _log.warning("%s", error)
                    last_error = error
                last_error = error and last_error
                pause = RETRY if error and self._way.every is None else self._way.every
                with suppress(TimeoutError):
                    await asyncio.wait_for(self._is_wanted.wait(), pause)
        except InputError as error:
            self.recorder.refuse(error)
        finally:
            self._is_over = True
            _release((*waiting, *self._waiting))
            if self._client is not None:
                await self._client.close()

    async def _ask(self) -> str:
        """Ask once, and record the answer; return why there is none."""
        self.recorder.expect()
        instance = self.recorder.instance
        if self._client is None:
            kind = instance.sensor.type or next(iter(await self._ros.ask(self._types)), None)
            if kind is None:
                return f"there is no service {instance.name} yet"
            _, self.recorder.instance = checked(instance, kind)
            self._client = ServiceClient(self._ros, kind, instance.name)
        try:
            answer = await self._client.call(instance.request(self._way), self._way.limit)
        except SourceError as error:
            return str(error)
        self.recorder.record(partial(value_at, answer))
        return ""

    # on the ROS thread

    def resolve(self) -> None:
        """Resolve the full name; raise an `InputError` if it is not valid in ROS."""
        self.name = resolved(self._ros.node.resolve_service_name, self.recorder.instance, "service")

    def _types(self) -> list[str]:
        return [kind for name, kinds in self._ros.node.get_service_names_and_types() if name == self.name for kind in kinds]


def _release(waiting: Iterable[asyncio.Future[None]]) -> None:
    for answered in waiting:
        if not answered.done():
            answered.set_result(None)
