"""One sensor: its messages are checked, interpreted and recorded as facts, which become unknown when it falls silent.

They come from a service that is polled, or from a topic, with the QoS of each of its publishers: reliable or not, latched or not.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Final

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.computed_values import MISSING
from pnm.core.logic.expressions import fluent_text
from pnm.errors import InputError
from pnm.knowledge.message_fields import Look
from pnm.knowledge.sensor_model import ByService, Instance, Reading, read, unknown
from pnm.knowledge.sources.source import SourceError
from pnm.knowledge.state_reports import Watchdog
from pnm.ros.node.messages import FieldError, import_type, to_message
from pnm.ros.node.ros_thread import RosThread, call_on_loop
from pnm.ros.node.service_client import ServiceClient
from pnm.ros.sensors.fields import fitted, value_at

_log = logging.getLogger(__name__)


class SensorRecorder:
    """Records what one sensor, for one choice of objects, reports.

    The mutable state is the instance, whose constants are resolved once its type is known, its watchdog, the statements that
    the last message did not fit, why the sensor cannot be used, whether all sensors are open, and whether it is closed.
    """

    def __init__(self, instance: Instance, knowledge: KnowledgeBase) -> None:
        self.instance = instance
        self.heard = asyncio.Event()
        self.refused: InputError | None = None
        self.is_open = False
        self.loop = asyncio.get_running_loop()
        self._knowledge = knowledge
        self._unread: frozenset[int] = frozenset()
        self._closed = False
        self._watchdog = Watchdog(instance.sensor.stale, self._forget)

    def record(self, look: Look) -> None:
        """Record the facts and variables of a message, given how to read its fields."""
        if self._closed:
            return
        reading = read(self.instance, look, self._knowledge.objects)
        for number, reason in reading.unread.items():
            if number not in self._unread:
                statement = self.instance.sensor.statements[number]
                fluent = statement.name if hasattr(statement, "name") else fluent_text(statement.fluent)
                _log.warning("%s: %s; %s is unknown", self.instance.name, reason, fluent)
        self._unread = frozenset(reading.unread)
        self._store(reading)
        self._watchdog.reset()
        self.heard.set()

    def refuse(self, error: InputError) -> None:
        """Note that the sensor cannot be used: what it reports is unknown. While sensors are opened, this is raised, not logged."""
        if self.refused is None:
            if self.is_open:
                _log.error("%s", error)
            self.refused = error
            self._watchdog.close()
            self._store(unknown(self.instance, self._knowledge.objects))
            self.heard.set()

    def close(self) -> None:
        """Record nothing more."""
        self._closed = True
        self._watchdog.close()

    def _forget(self) -> None:
        _log.warning("nothing was heard on %s for %g s; what it reports is unknown", self.instance.name, self.instance.sensor.stale)
        self._store(unknown(self.instance, self._knowledge.objects))

    def _store(self, reading: Reading) -> None:
        self._knowledge.update(reading.facts)
        known = {name: self._knowledge.variable(name) for name in reading.variables}
        changed = {name: value for name, value in reading.variables.items() if value != (None if known[name] is MISSING else known[name])}
        if changed:
            self._knowledge.store(changed)


def checked(instance: Instance, name: str) -> tuple[Any, Instance]:
    """Return the type, and the sensor with the values of its constants; raise an `InputError` if the type does not fit it."""
    sensor = instance.sensor
    try:
        kind = import_type(name)
        if isinstance(sensor.way, ByService):
            to_message(kind.Request, instance.request(sensor.way))
    except (InputError, FieldError) as error:
        raise InputError(str(error), sensor.position) from error
    return kind, replace(instance, sensor=fitted(sensor, kind.Response if isinstance(sensor.way, ByService) else kind))


def resolved(resolve: Callable[[str], object], instance: Instance, what: str) -> str:
    """Return the full name of the sensor's topic or service; raise an `InputError` if it is not valid in ROS."""
    try:
        return str(resolve(instance.name))
    except Exception as error:
        reason = (str(error).strip().splitlines() or [repr(error)])[0]
        raise InputError(f"not a name for a {what}: {instance.name!r} ({reason})", instance.sensor.position) from error


class ServiceSensor:
    """Polls one service. The mutable state is its client, once its type is known."""

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
        self._full_name = resolved(self._ros.node.resolve_service_name, self.recorder.instance, "service")

    def _types(self) -> list[str]:
        return [kind for name, kinds in self._ros.node.get_service_names_and_types() if name == self._full_name for kind in kinds]


DEPTH: Final = 10
"""Unread messages that are kept."""


class TopicSensor:
    """The subscriptions to one topic, one for every QoS of its publishers.

    The mutable state is, on the ROS thread, the type and the subscriptions; and the latest message, until the event loop has
    taken it: of messages that come faster than that, only the last one counts.
    """

    def __init__(self, ros: RosThread, recorder: SensorRecorder) -> None:
        self.recorder = recorder
        self._ros = ros
        self._kind: Any = None
        self._subscriptions: dict[tuple[bool, bool], Any] = {}
        self._waiting = False
        self._latest: Any = None
        self._foreign: set[str] = set()

    # on the event loop's thread

    async def is_there(self) -> bool:
        """Return True if the topic has publishers of the right type."""
        return bool(await self._ros.ask(lambda: self._subscriptions))

    def _take(self) -> None:
        self._waiting = False
        self.recorder.record(partial(value_at, self._latest))

    # on the ROS thread

    def resolve(self) -> None:
        """Resolve the full name; raise an `InputError` if it is not valid in ROS."""
        self._full_name = resolved(self._ros.node.resolve_topic_name, self.recorder.instance, "topic")

    def look(self) -> None:
        """Subscribe to new publishers."""
        from rclpy.qos import DurabilityPolicy, ReliabilityPolicy  # here, because rclpy is an extra

        for info in self._ros.node.get_publishers_info_by_topic(self._full_name):
            if self._fits(info.topic_type):
                profile = info.qos_profile
                reliable = profile.reliability == ReliabilityPolicy.RELIABLE
                self._subscribe(reliable, reliable and profile.durability == DurabilityPolicy.TRANSIENT_LOCAL)

    def destroy(self) -> None:
        """Unsubscribe."""
        for subscription in self._subscriptions.values():
            self._ros.node.destroy_subscription(subscription)
        self._subscriptions.clear()

    def _fits(self, type_name: str) -> bool:
        """Return True for the type of the sensor: that in the file, or else the first one that is found."""
        wanted = self.recorder.instance.sensor.type
        if self._kind is None and not self.recorder.refused:
            try:
                self._kind, self.recorder.instance = checked(self.recorder.instance, wanted or type_name)
                self._type_name = wanted or type_name
            except InputError as error:
                call_on_loop(self.recorder.loop, self.recorder.refuse, error)
        if self._kind is None or type_name == self._type_name:
            return self._kind is not None
        if type_name not in self._foreign:
            self._foreign.add(type_name)
            _log.warning("%s is ignored where it has the type %s; expected %s", self.recorder.instance.name, type_name, self._type_name)
        return False

    def _subscribe(self, reliable: bool, latched: bool) -> None:
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy  # here, because rclpy is an extra

        if (reliable, latched) not in self._subscriptions:
            profile = QoSProfile(
                depth=DEPTH,
                reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
                durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
            )
            instance = self.recorder.instance
            create = self._ros.node.create_subscription
            try:
                self._subscriptions[reliable, latched] = create(self._kind, instance.name, self._receive, profile)
            except Exception as error:  # this process uses the topic with another type, for example
                reason = f"{instance.name} cannot be listened to: {error}"
                call_on_loop(self.recorder.loop, self.recorder.refuse, InputError(reason, instance.sensor.position))

    def _receive(self, message: Any) -> None:
        self._latest = message
        if not self._waiting:
            self._waiting = True
            call_on_loop(self.recorder.loop, self._take)
