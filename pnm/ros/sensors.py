"""Listens to topics and polls services, and records what they say of the world.

A topic is listened to in the way in which each of its publishers publishes: reliable or not, latched or not. Which
publishers there are, and of which type, is looked up in the ROS graph again and again.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, Final

from pnm.errors import InputError
from pnm.expressions import show
from pnm.knowledge import KnowledgeBase
from pnm.message_fields import Look
from pnm.queries import MISSING
from pnm.ros.fields import check_fields, value_at
from pnm.ros.messages import FieldError, import_type, to_message
from pnm.ros.node import RosThread
from pnm.ros.service_client import ServiceClient
from pnm.sensing import Instance, Polled, Reading, Sensing, instances, read, unknown
from pnm.silence import Silence
from pnm.sources.base import SourceError

LOOK: Final = 0.5
"""Seconds between two looks for publishers that are new."""
FIRST: Final = 3.0
"""Seconds that somebody who is there may take to say something for the first time."""
DEPTH: Final = 10
"""Messages that are kept until they are read."""

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
                _checked(next((one for one in found if one.sensor is sensor), Instance(sensor, {})), sensor.type)
        self._senses = [_Sense(instance, knowledge) for instance in found]
        self._topics = [_Topic(ros, sense) for sense in self._senses if not isinstance(sense.instance.sensor.way, Polled)]
        self._polls = [_Poll(ros, sense, way) for sense in self._senses if isinstance(way := sense.instance.sensor.way, Polled)]
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
        everybody = asyncio.gather(*(sense.heard.wait() for sense in self._senses))
        settled = asyncio.ensure_future(self._ros.settled())
        try:
            await asyncio.wait((everybody, settled), return_when=asyncio.FIRST_COMPLETED)
            sources: list[_Topic | _Poll] = [*self._topics, *self._polls]
            if [one for one in sources if not one.sense.heard.is_set() and await one.is_there()]:
                await asyncio.wait((everybody,), timeout=FIRST)
        finally:
            everybody.cancel()
            settled.cancel()
        for sense in self._senses:
            if not sense.heard.is_set():
                _log.warning("nothing has been heard on %s yet", sense.instance.name)

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


def _checked(instance: Instance, name: str) -> Any:
    """Return the type, which must have what the sensor looks for.

    Raises:
        InputError: it does not, or is not installed.
    """
    sensor = instance.sensor
    try:
        kind = import_type(name)
        if isinstance(sensor.way, Polled):
            to_message(kind.Request, instance.request(sensor.way))
    except (InputError, FieldError) as error:
        raise InputError(str(error), sensor.position) from error
    check_fields(sensor, kind.Response if isinstance(sensor.way, Polled) else kind)
    return kind


def _resolved(resolve: Callable[[str], object], instance: Instance, what: str) -> str:
    try:
        return str(resolve(instance.name))
    except Exception as error:
        reason = (str(error).strip().splitlines() or [repr(error)])[0]
        raise InputError(f"not a name for a {what}: {instance.name!r} ({reason})", instance.sensor.position) from error


class _Sense:
    """One sensor for one choice of objects, and what is made of what it says.

    The mutable state is its silence, what of it could not be understood the last time, and why it cannot be used.
    """

    def __init__(self, instance: Instance, knowledge: KnowledgeBase) -> None:
        self.instance = instance
        self.heard = asyncio.Event()
        self.refused: InputError | None = None
        self.loop = asyncio.get_running_loop()
        self._knowledge = knowledge
        self._unread: frozenset[int] = frozenset()
        self._silence = Silence(instance.sensor.stale, self._fall_silent)

    def hear(self, look: Look) -> None:
        """Record what a message says."""
        reading = read(self.instance, look, self._knowledge.objects)
        for number, reason in reading.unread.items():
            if number not in self._unread:
                _log.warning("%s: %s; %s is unknown", self.instance.name, reason, self._about(number))
        self._unread = frozenset(reading.unread)
        self._record(reading)
        self._silence.heard()
        self.heard.set()

    def refuse(self, error: InputError) -> None:
        """Note that the sensor cannot be used."""
        if self.refused is None:
            _log.error("%s", error)
            self.refused = error
            self.heard.set()

    def close(self) -> None:
        """Fall silent no more."""
        self._silence.close()

    def _fall_silent(self) -> None:
        _log.warning("nothing was heard on %s for %g s; what it tells is unknown", self.instance.name, self.instance.sensor.stale)
        self._record(unknown(self.instance, self._knowledge.objects))

    def _record(self, reading: Reading) -> None:
        self._knowledge.update(reading.facts)
        known = {name: self._knowledge.variable(name) for name in reading.variables}
        changed = {name: value for name, value in reading.variables.items() if value != (None if known[name] is MISSING else known[name])}
        if changed:
            self._knowledge.store(changed)

    def _about(self, number: int) -> str:
        statement = self.instance.sensor.statements[number]
        return statement.name if hasattr(statement, "name") else show(statement.fluent)


class _Topic:
    """The subscriptions to one topic: one for every way in which somebody publishes on it.

    The mutable state is, on the ROS thread, the type and the subscriptions; and the latest message, if it has not been
    handed over yet: of a flood of messages the last one counts.
    """

    def __init__(self, ros: RosThread, sense: _Sense) -> None:
        self.sense = sense
        self._ros = ros
        self._kind: Any = None
        self._subscriptions: dict[tuple[bool, bool], Any] = {}
        self._waiting = False
        self._latest: Any = None
        self._foreign: set[str] = set()

    # on the event loop's thread

    async def is_there(self) -> bool:
        """Tell whether somebody publishes."""
        return bool(await self._ros.ask(lambda: self._subscriptions))

    def _take(self) -> None:
        self._waiting = False
        self.sense.hear(partial(value_at, self._latest))

    # on the ROS thread

    def resolve(self) -> None:
        """Find out the full name.

        Raises:
            InputError: it cannot be a name in ROS.
        """
        self._full_name = _resolved(self._ros.node.resolve_topic_name, self.sense.instance, "topic")

    def look(self) -> None:
        """Subscribe to whoever is new."""
        from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

        for info in self._ros.node.get_publishers_info_by_topic(self._full_name):
            if self._fits(info.topic_type):
                profile = info.qos_profile
                reliable = profile.reliability == ReliabilityPolicy.RELIABLE
                self._subscribe(reliable, reliable and profile.durability == DurabilityPolicy.TRANSIENT_LOCAL)

    def destroy(self) -> None:
        """Subscribe no longer."""
        for subscription in self._subscriptions.values():
            self._ros.node.destroy_subscription(subscription)
        self._subscriptions.clear()

    def _fits(self, type_name: str) -> bool:
        """Tell whether messages of this type are understood; the first type that is there is the one, unless the file says it."""
        wanted = self.sense.instance.sensor.type
        if self._kind is None and not self.sense.refused:
            try:
                self._kind = _checked(self.sense.instance, wanted or type_name)
                self._type_name = wanted or type_name
            except InputError as error:
                self._hand_over(partial(self.sense.refuse, error))
        if self._kind is None or type_name == self._type_name:
            return self._kind is not None
        if type_name not in self._foreign:
            self._foreign.add(type_name)
            _log.warning("%s is ignored where it has the type %s; expected %s", self.sense.instance.name, type_name, self._type_name)
        return False

    def _subscribe(self, reliable: bool, latched: bool) -> None:
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        if (reliable, latched) not in self._subscriptions:
            profile = QoSProfile(
                depth=DEPTH,
                reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
                durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
            )
            instance = self.sense.instance
            create = self._ros.node.create_subscription
            try:
                self._subscriptions[reliable, latched] = create(self._kind, instance.name, self._receive, profile)
            except Exception as error:  # this process uses the topic with another type, for example
                reason = f"{instance.name} cannot be listened to: {error}"
                self._hand_over(partial(self.sense.refuse, InputError(reason, instance.sensor.position)))

    def _receive(self, message: Any) -> None:
        self._latest = message
        if not self._waiting:
            self._waiting = True
            self._hand_over(self._take)

    def _hand_over(self, function: Callable[[], object]) -> None:
        try:
            self.sense.loop.call_soon_threadsafe(function)
        except RuntimeError:
            _log.debug("the event loop is closed; nobody hears of the message")


class _Poll:
    """Asks one service again and again. The mutable state is its client, once its type is known."""

    def __init__(self, ros: RosThread, sense: _Sense, way: Polled) -> None:
        self.sense = sense
        self._ros = ros
        self._way = way
        self._client: ServiceClient | None = None

    async def is_there(self) -> bool:
        """Tell whether there is such a service."""
        return bool(await self._ros.ask(lambda: [*self._types()]))

    async def ask_on(self) -> None:
        """Ask until the task is cancelled, or the service turns out to be of no use."""
        request, trouble = self.sense.instance.request(self._way), ""
        try:
            while True:
                try:
                    answer = await (await self._connected()).call(request, self._way.limit)
                    self.sense.hear(partial(value_at, answer))
                    trouble = ""
                except SourceError as error:
                    if str(error) != trouble:
                        trouble = str(error)
                        _log.warning("%s", error)
                await asyncio.sleep(self._way.every)
        except InputError as error:
            self.sense.refuse(error)
        finally:
            if self._client is not None:
                await self._client.close()

    async def _connected(self) -> ServiceClient:
        if self._client is None:
            instance = self.sense.instance
            name = instance.sensor.type or next(iter(await self._ros.ask(lambda: [*self._types()])), None)
            if name is None:
                raise SourceError(f"there is no service {instance.name} yet")
            _checked(instance, name)
            self._client = ServiceClient(self._ros, name, instance.name)
        return self._client

    # on the ROS thread

    def resolve(self) -> None:
        """Find out the full name.

        Raises:
            InputError: it cannot be a name in ROS.
        """
        self._full_name = _resolved(self._ros.node.resolve_service_name, self.sense.instance, "service")

    def _types(self) -> Iterator[str]:
        for name, types in self._ros.node.get_service_names_and_types():
            if name == self._full_name:
                yield from types
