"""The sensors of a file: messages of topics and answers of services are checked, interpreted and recorded as facts."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable, Coroutine, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

from pnm.core.knowledge_base import KnowledgeBase, parse_fluent, parse_statement, statement_text
from pnm.core.logic.computed_values import MISSING
from pnm.core.logic.expressions import UNKNOWN, Fluent, Unknown, Value, fluent_text
from pnm.core.message_fields import Look
from pnm.errors import InputError
from pnm.knowledge.sensor_model import ByService, Instance, Reading, Sensing, instances, read, unknown
from pnm.knowledge.source import SourceError
from pnm.knowledge.state_reports import StalenessWatchdog
from pnm.ros.node.graph import resolved
from pnm.ros.node.messages import FieldError, fitted, has_own_types, import_type, to_message, value_at
from pnm.ros.node.ros_thread import RosThread, call_on_loop, profile
from pnm.ros.node.services import ServiceClient

_log = logging.getLogger(__name__)


class SensorRecorder:
    """A sensor for one choice of objects, what it reports being recorded; it hears of that as one of its two kinds does.

    The mutable state is the instance, whose constants are resolved once its type is known, its watchdog, the statements that
    the last message did not fit, why the sensor cannot be used, whether all sensors are open, whether it has fallen silent, and whether it
    is closed.
    """

    def __init__(self, ros: RosThread, instance: Instance, knowledge: KnowledgeBase) -> None:
        self.ros = ros
        self.instance = instance
        self.heard = asyncio.Event()
        self.refused: InputError | None = None
        self.is_open = False
        self.is_stale = False
        self.loop = asyncio.get_running_loop()
        self._knowledge = knowledge
        self._unread: frozenset[int] = frozenset()
        self._closed = False
        self._watchdog = StalenessWatchdog(instance.sensor.stale, self._forget)

    def resolve(self) -> None:
        """Resolve the full name, on the ROS thread; raise an `InputError` if it is not valid in ROS."""
        node, position = self.ros.node, self.instance.sensor.position
        is_service = self.instance.sensor.service is not None
        resolve, what = (node.resolve_service_name, "a service") if is_service else (node.resolve_topic_name, "a topic")
        self.name = resolved(resolve, self.instance.name, what, position)

    def record(self, look: Look) -> None:
        """Record the facts and variables of a message, given how to read its fields."""
        if self._closed:
            return
        reading = read(self.instance, look, self._knowledge.objects)
        for number, reason in reading.unread.items():
            if number not in self._unread:
                _log.warning("%s: %s; %s is unknown", self.instance.name, reason, self.instance.sensor.statements[number])
        self._unread = frozenset(reading.unread)
        self._store(reading)
        self.is_stale = False
        self._watchdog.reset()
        if self.instance.sensor.service:
            self._watchdog.rest()
        self.heard.set()

    def expect(self) -> None:
        """Note that an answer is expected from now on; topics are always expected to say something."""
        if not self._closed:
            self._watchdog.expect()

    def refuse(self, error: InputError) -> None:
        """Note that the sensor cannot be used: what it reports is unknown. While sensors are opened, this is raised, not logged."""
        if self.refused is None:
            if self.is_open:
                _log.error("%s", error)
            self.refused = error
            self._watchdog.close()
            self._lose(str(error))
            self.heard.set()

    def close(self) -> None:
        """Record nothing more."""
        self._closed = True
        self._watchdog.close()

    def _forget(self) -> None:
        self.is_stale = True
        why = f"nothing was heard on {self.instance.name} for {self.instance.sensor.stale:g} s"
        _log.warning("%s; its facts are unknown", why)
        self._lose(why)

    def _lose(self, why: str) -> None:
        nothing = unknown(self.instance, self._knowledge.objects)
        self._knowledge.forget(nothing.facts, why)
        self._store(nothing)

    def _store(self, reading: Reading) -> None:
        self._knowledge.update(reading.facts)
        known = {name: self._knowledge.variable(name) for name in reading.variables}
        changed = {name: value for name, value in reading.variables.items() if value != (None if known[name] is MISSING else known[name])}
        if changed:
            self._knowledge.store(changed)


async def _first_of(*works: Coroutine[Any, Any, object]) -> None:
    """Wait until one of these is done, and cancel the others."""
    tasks = [*map(asyncio.ensure_future, works)]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()


@dataclass(frozen=True, slots=True)
class SensorUse:
    """The state of one sensor."""

    instance: Instance
    name: str
    """The full name of its topic or service."""
    is_heard: bool
    refused: InputError | None
    """Why it cannot be used."""
    is_stale: bool = False
    """Whether it has fallen silent."""


def checked(instance: Instance, name: str) -> tuple[Any, Instance]:
    """Return the type, and the sensor with the values of its constants; raise an `InputError` if the type does not fit it."""
    sensor = instance.sensor
    try:
        kind = import_type(name)
        if sensor.service:
            to_message(kind.Request, instance.request(sensor.service))
    except (InputError, FieldError) as error:
        raise InputError(str(error), sensor.position) from error
    return kind, replace(instance, sensor=fitted(sensor, kind.Response if sensor.service else kind))


# --- from a topic, with the QoS of each of its publishers: reliable or not, latched or not --

DEPTH: Final = 10
"""Unread messages that are kept."""


class TopicSensor(SensorRecorder):
    """A sensor that subscribes to one topic, once for every QoS of its publishers.

    The mutable state is, on the ROS thread, the type and the subscriptions; the latest message, until the event loop has
    taken it: of messages that come faster than that, only the last one counts; and for when the last one speaks.
    """

    def __init__(self, ros: RosThread, instance: Instance, knowledge: KnowledgeBase) -> None:
        super().__init__(ros, instance, knowledge)
        self._kind: Any = None
        self._subscriptions: dict[tuple[bool, bool], Any] = {}
        self._waiting = False
        self._latest: Any = None
        self._spoken = 0
        self._news = asyncio.Event()
        self._foreign: set[str] = set()

    # on the event loop's thread

    async def is_there(self) -> bool:
        """Return True if the topic has publishers of the right type."""
        return bool(await self.ros.ask(lambda: self._subscriptions))

    async def refresh(self, since: int, until: float) -> None:
        """Wait until the topic speaks for a time after this one, in nanoseconds of ROS; until then on the loop's clock at most.

        What has said nothing yet has no publisher, and what is latched only speaks when something changes: neither is waited for.
        """
        with suppress(TimeoutError):
            async with asyncio.timeout_at(until):
                while self._spoken <= since and self.heard.is_set() and not all(latched for _, latched in self._subscriptions):
                    self._news.clear()
                    await self._news.wait()

    # on the ROS thread

    def look(self) -> None:
        """Subscribe to new publishers."""
        from rclpy.qos import DurabilityPolicy, ReliabilityPolicy  # here, because rclpy is an extra

        for info in self.ros.node.get_publishers_info_by_topic(self.name):
            if self._fits(info.topic_type):
                qos = info.qos_profile
                reliable = qos.reliability == ReliabilityPolicy.RELIABLE
                self._subscribe(reliable, reliable and qos.durability == DurabilityPolicy.TRANSIENT_LOCAL)

    def destroy(self) -> None:
        """Unsubscribe."""
        for subscription in self._subscriptions.values():
            self.ros.node.destroy_subscription(subscription)
        self._subscriptions.clear()

    def _fits(self, type_name: str) -> bool:
        """Return True for the type of the sensor: that in the file, or else the first one that is found."""
        wanted = self.instance.sensor.type
        if self._kind is None and not self.refused:
            try:
                self._kind, self.instance = checked(self.instance, wanted or type_name)
                self._type_name = wanted or type_name
            except InputError as error:
                call_on_loop(self.loop, self.refuse, error)
        if self._kind is None or type_name == self._type_name:
            return self._kind is not None
        if type_name not in self._foreign:
            self._foreign.add(type_name)
            _log.warning("%s is ignored where it has the type %s; expected %s", self.instance.name, type_name, self._type_name)
        return False

    def _subscribe(self, reliable: bool, latched: bool) -> None:
        from rclpy.qos import ReliabilityPolicy  # here, because rclpy is an extra

        if (reliable, latched) not in self._subscriptions:
            instance, create, qos = self.instance, self.ros.node.create_subscription, profile(DEPTH, latched=latched)
            qos.reliability = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
            try:
                self._subscriptions[reliable, latched] = create(self._kind, instance.name, self._receive, qos)
            except Exception as error:  # this process uses the topic with another type, for example
                reason = f"{instance.name} cannot be listened to: {error}"
                call_on_loop(self.loop, self.refuse, InputError(reason, instance.sensor.position))

    def _receive(self, message: Any) -> None:
        def take() -> None:
            self._waiting = False
            latest, received = self._latest
            self.record(partial(value_at, latest))
            self._spoken = max(self._spoken, spoken(latest, received))
            self._news.set()

        self._latest = message, self.ros.node.get_clock().now().nanoseconds
        if not self._waiting:
            self._waiting = True
            call_on_loop(self.loop, take)


def spoken(message: Any, received: int) -> int:
    """Return the time, in nanoseconds, for which a message speaks: that of its stamp if it has one, and else when it was received."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    stamped = 0 if stamp is None else stamp.sec * 10**9 + stamp.nanosec
    return min(stamped or received, received)


# --- from a service, as its answers --------------------------------------------------------

RETRY: Final = 1.0
"""Seconds after which a service that has not answered is asked again."""


class ServiceSensor(SensorRecorder):
    """A sensor that asks one service.

    The mutable state is its client, once its type is known, whether there is a reason to ask, who waits for an answer to a request
    that is still to be sent, and whether nothing is asked any more.
    """

    def __init__(self, ros: RosThread, instance: Instance, knowledge: KnowledgeBase, service: ByService) -> None:
        super().__init__(ros, instance, knowledge)
        self._service = service
        self._client: ServiceClient | None = None
        self._is_wanted = asyncio.Event()
        self._waiting: list[asyncio.Future[None]] = []
        self._is_over = False

    async def is_there(self) -> bool:
        """Return True if there is such a service."""
        return bool(await self.ros.ask(self._types))

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
                if error and error != last_error and self.is_open:  # before, the look at all sensors says it
                    _log.warning("%s", error)
                    last_error = error
                last_error = error and last_error
                pause = RETRY if error and self._service.every is None else self._service.every
                with suppress(TimeoutError):
                    await asyncio.wait_for(self._is_wanted.wait(), pause)
        except InputError as error:
            self.refuse(error)
        finally:
            self._is_over = True
            _release([*waiting, *self._waiting])
            if self._client is not None:
                await self._client.close()

    async def _ask(self) -> str:
        """Ask once, and record the answer; return why there is none."""
        self.expect()
        instance = self.instance
        if self._client is None:
            kind = instance.sensor.type or next(iter(await self.ros.ask(self._types)), None)
            if kind is None:
                return f"there is no service {instance.name} yet"
            _, self.instance = checked(instance, kind)
            self._client = ServiceClient(self.ros, kind, instance.name)
        try:
            answer = await self._client.call(instance.request(self._service), self._service.limit)
        except SourceError as error:
            return str(error)
        self.record(partial(value_at, answer))
        return ""

    def _types(self) -> list[str]:
        return [kind for name, kinds in self.ros.node.get_service_names_and_types() if name == self.name for kind in kinds]


def _release(waiting: Iterable[asyncio.Future[None]]) -> None:
    for answered in waiting:
        if not answered.done():
            answered.set_result(None)


# --- the sensors of a file -----------------------------------------------------------------
# Publishers of topics, and their types, are looked up in the ROS graph periodically.

LOOK: Final = 0.5
"""Seconds between two looks for new publishers."""
FIRST: Final = 3.0
"""Seconds to wait for the first message of publishers and services that are there."""


class Sensors:
    """The sensors of a file, for every choice of their objects. To be used on the event loop's thread.

    The mutable state is the sensors, the tasks that ask services, and when the last action has ended.
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
        self._topics = [TopicSensor(ros, one, knowledge) for one in self.instances if not one.sensor.service]
        self._polls = [ServiceSensor(ros, one, knowledge, service) for one in self.instances if (service := one.sensor.service)]
        self._sensors: tuple[TopicSensor | ServiceSensor, ...] = (*self._topics, *self._polls)
        self._tasks: list[asyncio.Task[None]] = []
        self._lag = lag
        self._ended = (0, 0.0)
        self._timer: Any = None
        for name, late in sensing.lags(lag).items():
            knowledge.sense((name,), lag=late)

    async def open(self) -> None:
        """Subscribe and ask, and wait for the first message of all publishers and services that are there."""
        for sensor in self._sensors:
            await self._ros.ask(sensor.resolve)
        if self._topics:
            self._timer = await self._ros.ask(lambda: self._ros.timer(LOOK, self._look))
        self._tasks = [asyncio.create_task(poll.poll()) for poll in self._polls]
        if self._sensors:
            await self._wait_for_first()
        for sensor in self._sensors:
            sensor.is_open = True

    def uses(self) -> tuple[SensorUse, ...]:
        """Return the states of the sensors, once they are open."""
        return tuple(SensorUse(one.instance, one.name, one.heard.is_set(), one.refused, one.is_stale) for one in self._sensors)

    def expect_news(self) -> None:
        """Note that an action has ended: what topics have said before may not be so any more."""
        self._ended = self._ros.node.get_clock().now().nanoseconds, asyncio.get_running_loop().time()

    async def refresh(self) -> None:
        """Have all services asked at once, and wait for their answers, each for twice its limit at most.

        Topics are waited for that have said nothing since the last action has ended, each until its lag after that is over.
        """
        since, ended = self._ended
        topics = (topic.refresh(since, ended + topic.instance.sensor.lag_or(self._lag)) for topic in self._topics)
        await asyncio.gather(*topics, *(poll.refresh() for poll in self._polls))

    async def close(self) -> None:
        """Unsubscribe, and stop asking."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        for sensor in self._sensors:
            sensor.close()

        def destroy() -> None:
            if self._timer is not None:
                self._ros.node.destroy_timer(self._timer)
            for topic in self._topics:
                topic.destroy()

        await self._ros.ask(destroy)

    async def _wait_for_first(self) -> None:
        async def hear_all() -> None:
            for sensor in self._sensors:
                await sensor.heard.wait()

        await _first_of(hear_all(), self._ros.settled())
        await self._ros.ask(self._look)  # the timer's last look may be older than the publishers that are there
        if [sensor for sensor in self._sensors if not sensor.heard.is_set() and await sensor.is_there()]:
            with suppress(TimeoutError):
                await asyncio.wait_for(hear_all(), FIRST)

    # on the ROS thread

    def _look(self) -> None:
        for topic in self._topics:
            topic.look()


# --- both ends of the topic ``knowledge/sensed``: complete reports about some names ---------

TOPIC = "knowledge/sensed"
Facts = dict[Fluent, Value | Unknown]
Listener = Callable[[frozenset[str], Facts, int], None]
Refuse = Callable[[frozenset[str], str], None]


_STATE: Final = "pnm_interfaces/msg/State"


class SensedReports:
    """Passes every report on ``knowledge/sensed`` to a listener, on the event loop's thread: names, true facts, sequence number.

    A report is complete about the predicates and functions it names: it replaces all earlier reports about them, from any
    publisher. So several publishers need disjoint names. What cannot be read goes to `refuse`, with the names of the report
    and the reason.
    """

    def __init__(self, ros: RosThread, loop: asyncio.AbstractEventLoop, listener: Listener, refuse: Refuse, topic: str = TOPIC) -> None:
        self._ros = ros
        self._loop = loop
        self._listener = listener
        self._refuse = refuse
        self._topic = topic
        self._heard = asyncio.Event()
        self._closed = False
        self._subscription: Any = None

        def subscribe() -> None:
            self._subscription = ros.node.create_subscription(import_type(_STATE), topic, self._receive, profile(10, latched=True))

        if has_own_types():
            ros.call(subscribe)

    async def first(self, limit: float) -> bool:
        """Wait for the first report until `limit` seconds are over, or the graph is known to have no publisher; return whether it came.

        Raises `InputError` if there is a publisher, but the type of its reports is not installed.
        """
        try:
            async with asyncio.timeout(limit):
                await _first_of(self._ros.settled(), self._heard.wait())
                if not (self._heard.is_set() or await self._ros.ask(lambda: self._ros.node.count_publishers(self._topic))):
                    return False
                import_type(_STATE)
                await self._heard.wait()
        except TimeoutError:
            _log.warning("nothing was reported on %s within %g s", self._topic, limit)
        return self._heard.is_set()

    def close(self) -> None:
        """Unsubscribe."""
        if not self._closed:
            self._closed = True
            self._ros.call(lambda: self._subscription and self._ros.node.destroy_subscription(self._subscription))

    def _pass_on(self, listener: Callable[..., None], *report: object) -> None:
        if not self._closed:
            listener(*report)

    # on the ROS thread

    def _receive(self, message: Any) -> None:
        names = frozenset(message.names)
        try:
            facts = read_state(message)
        except InputError as error:
            call_on_loop(self._loop, self._pass_on, self._refuse, names, str(error))
        else:
            call_on_loop(self._loop, self._pass_on, self._listener, names, facts, int(message.sequence))
            call_on_loop(self._loop, self._heard.set)


def read_state(message: Any) -> Facts:
    """Return the facts, objects and numbers of a ``State``, a NaN as unknown; raise `InputError` if one of them is malformed."""
    if len(message.fluents) != len(message.values):
        raise InputError(f"{len(message.fluents)} fluents, but {len(message.values)} values")
    facts: Facts = dict(map(parse_statement, message.facts))
    for text, value in zip(message.fluents, message.values, strict=True):
        facts[parse_fluent(text)] = UNKNOWN if math.isnan(value) else float(value)
    return facts


def write_state(names: frozenset[str], facts: Mapping[Fluent, Value | Unknown], sequence: int) -> dict[str, object]:
    """Return the fields of a ``pnm_interfaces/msg/State`` that reports these facts, objects and numbers."""
    stated = [statement_text(fluent, value) for fluent, value in facts.items() if value is True or isinstance(value, str)]
    numbers = {
        fluent_text(fluent): math.nan if isinstance(value, Unknown) else value
        for fluent, value in facts.items()
        if not isinstance(value, bool | str)
    }
    return {"names": sorted(names), "facts": stated, "fluents": list(numbers), "values": list(numbers.values()), "sequence": sequence}
