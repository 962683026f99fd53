"""A sensor whose messages are the answers of a service that is polled."""

from __future__ import annotations

import asyncio
import logging
from functools import partial

from pnm.errors import InputError
from pnm.knowledge.sensor_model import ByService
from pnm.knowledge.sources.source import SourceError
from pnm.ros.node.ros_thread import RosThread
from pnm.ros.node.service_client import ServiceClient
from pnm.ros.node.typed_fields import value_at
from pnm.ros.sensors.sensor import SensorRecorder, checked, resolved

_log = logging.getLogger(__name__)


class ServiceSensor:
    """A sensor that polls one service. The mutable state is its client, once its type is known."""

    def __init__(self, ros: RosThread, recorder: SensorRecorder, way: ByService) -> None:
        self.recorder = recorder
        self._ros = ros
        self._way = way
        self._client: ServiceClient | None = None

    async def is_there(self) -> bool:
        """Return True if there is such a service."""
        return bool(await self._ros.ask(self._types))

    async def poll(self) -> None:
        """Poll until cancelled, or until the service's type turns out not to fit the sensor. New errors are logged once."""
        request, last_error = self.recorder.instance.request(self._way), ""
        try:
            while True:
                try:
                    answer = await (await self._connected()).call(request, self._way.limit)
                    self.recorder.record(partial(value_at, answer))
                    last_error = ""
                except SourceError as error:
                    if str(error) != last_error:
                        last_error = str(error)
                        _log.warning("%s", error)
                await asyncio.sleep(self._way.every)
        except InputError as error:
            self.recorder.refuse(error)
        finally:
            if self._client is not None:
                await self._client.close()

    async def _connected(self) -> ServiceClient:
        if self._client is None:
            instance = self.recorder.instance
            name = instance.sensor.type or next(iter(await self._ros.ask(self._types)), None)
            if name is None:
                raise SourceError(f"there is no service {instance.name} yet")
            _, self.recorder.instance = checked(instance, name)
            self._client = ServiceClient(self._ros, name, instance.name)
        return self._client

    # on the ROS thread

    def resolve(self) -> None:
        """Resolve the full name; raise an `InputError` if it is not valid in ROS."""
        self.name = resolved(self._ros.node.resolve_service_name, self.recorder.instance, "service")

    def _types(self) -> list[str]:
        return [kind for name, kinds in self._ros.node.get_service_names_and_types() if name == self.name for kind in kinds]
