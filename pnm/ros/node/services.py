"""Services over ROS 2: a client of one that may be missing, slow or dead, and services and topics of ours, used on the event loop.

Every call of the client has a limit. At first contact a response may be lost: DDS matches the two topics of a service one after the
other, so a server may read our request before it has matched our reader of responses. So until a service has responded once, a request
is repeated, and the first response counts.
"""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Awaitable, Callable, Hashable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import partial
from typing import Any, Final, Generic, TypeAlias, TypeVar

from pnm.errors import PnmError, printable
from pnm.knowledge.source import SourceError
from pnm.ros.node.messages import FieldError, import_type, to_message
from pnm.ros.node.ros_thread import RosThread, call_on_loop, profile
from pnm.tasks import TaskRefused

# --- a client of a service -----------------------------------------------------------------

IN_FLIGHT: Final = 8
"""Requests without a response at a time; services keep 10 by default and silently drop older ones."""
AGAIN: Final = 1.0
"""Seconds after which a request is repeated to a service that has never responded."""
_LOOK: Final = 0.1
"""Seconds between two checks."""


async def until_true(ros: RosThread, check: Callable[[], object]) -> None:
    """Wait until the function returns something true, polled on the ROS thread; the time limit is the caller's."""
    while True:
        if await ros.ask(check):
            return
        await asyncio.sleep(_LOOK)


class ServiceClient:
    """A client of one service, connected when it is first needed.

    The mutable state is the client, on the ROS thread, whether the service has ever responded, and how many requests may
    still be sent. Until it has, a request may arrive more than once.
    """

    def __init__(self, ros: RosThread, type_name: str, name: str) -> None:
        self._ros = ros
        self._type = import_type(type_name)
        self._name = name
        self._client: Any = None
        self._met = False
        self._free = asyncio.Semaphore(IN_FLIGHT)

    async def call(self, request: Mapping[str, object], limit: float) -> Any:
        """Send the request once the service is there; `SourceError` if it is not, does not answer in time, or it does not fit."""
        is_there = False
        try:
            async with asyncio.timeout(limit), self._free:
                message = to_message(self._type.Request, request)
                await until_true(self._ros, self._ready)
                is_there = True
                return await self._answer(message)
        except FieldError as error:
            raise SourceError(f"{self._name}: {error}") from error
        except TimeoutError as error:
            if is_there:
                raise SourceError(f"the service {self._name} did not answer within {limit:g} s") from error
            raise SourceError(await self._ros.ask(self._absence)) from error

    async def close(self) -> None:
        """Destroy the client."""

        def destroy() -> None:
            if self._client is not None:
                self._ros.node.destroy_client(self._client)
                self._client = None

        await self._ros.ask(destroy)

    async def _answer(self, message: Any) -> Any:
        loop = asyncio.get_running_loop()
        answered: asyncio.Future[Any] = loop.create_future()

        def receive(future: Any) -> None:
            self._met = True
            if not answered.done():
                answered.set_result(future.result())

        def send() -> Any:
            future = self._client.call_async(message)
            future.add_done_callback(partial(call_on_loop, loop, receive))
            return future

        def forget() -> None:
            for future in sent if self._client is not None else ():
                self._client.remove_pending_request(future)

        sent: list[Any] = []
        try:
            while not answered.done():
                met = self._met
                sent.append(await self._ros.ask(send))
                await asyncio.wait((answered,), timeout=None if met else AGAIN)
            return answered.result()
        finally:
            self._ros.call(forget)

    # on the ROS thread

    def _ready(self) -> bool:
        if self._client is None:
            self._client = self._ros.node.create_client(self._type, self._name, qos_profile=profile(100))
        ready = bool(self._client.service_is_ready())
        self._met &= ready  # a service that comes back is a new process, which has yet to discover us
        return ready

    def _absence(self) -> str:
        full = str(self._ros.node.resolve_service_name(self._name))
        known = [name for name, _ in self._ros.node.get_service_names_and_types()]
        near = [name for name in get_close_matches(full, known, 4) if name != full]
        similar = f"; similar are {', '.join(near)}" if near else ""
        return f"there is no service {full}{similar}"


# --- services of ours, answered by coroutines; one that waits holds up no other ------------

DEPTH: Final = 1000
"""Requests that may wait unread, and messages that slow subscribers may be behind; they come in bursts."""
_FAREWELL: Final = 1.0
"""Seconds to send the last responses."""
ARRIVAL: Final = 1.0
"""Seconds in which a response arrives: a publisher that is destroyed earlier takes unsent data along."""
Fields: TypeAlias = Mapping[str, object]
Handler: TypeAlias = Callable[[Any], Awaitable[Fields | None]]
"""Returns the fields of the response to a request, if it has any; an exception becomes the message of a response without success."""
_log = logging.getLogger(__name__)


@dataclass(eq=False, repr=False)
class RequestServices:
    """Some services, opened and closed together. Their responses have the fields ``success`` and ``message``.

    The mutable state is, on the event loop's thread, the requests at work, and when the last one was answered; on the ROS thread,
    the services and the number of requests that are not answered yet.
    """

    ros: RosThread
    loop: asyncio.AbstractEventLoop = field(default_factory=asyncio.get_running_loop)
    cancelled: str = "the node is shut down, or cleaned up"
    """The message for requests that are cancelled, such as by `close`."""
    ended: str = "the node has ended"
    """The message for requests after the end of the event loop."""
    arrival: float = ARRIVAL
    """Seconds that `close` leaves the last response to arrive."""
    _work: set[asyncio.Task[Fields]] = field(default_factory=set)
    _services: list[Any] = field(default_factory=list)
    _unanswered: int = 0
    _answered: float = -math.inf

    # on the event loop's thread

    async def open(self, services: Mapping[str, tuple[str, Handler]]) -> None:
        """Offer services: by name, relative to the node's namespace, their types and handlers."""
        kinds = {name: import_type(kind) for name, (kind, _) in services.items()}

        def offer() -> None:
            from rclpy.callback_groups import ReentrantCallbackGroup  # here, because rclpy is an extra

            deep, group = profile(DEPTH), ReentrantCallbackGroup()  # reentrant: the next request is taken while this one waits
            for name, kind in kinds.items():
                callback, create = self.callback(services[name][1]), self.ros.node.create_service
                self._services.append(create(kind, name, callback, qos_profile=deep, callback_group=group))

        await self.ros.ask(offer)

    async def close(self) -> None:
        """Refuse the requests that are at work, and take the services down."""
        for task in self._work:
            task.cancel()
        if self._work:
            await asyncio.wait(self._work)
        # Three things in this order: the coroutines have ended, rclpy has sent their responses, and these have arrived.
        with suppress(TimeoutError):
            async with asyncio.timeout(_FAREWELL):
                await until_true(self.ros, lambda: not self._unanswered)
        await arrived(self._answered, self.arrival)

        def take_down() -> None:
            for service in self._services:
                self.ros.node.destroy_service(service)
            self._services.clear()

        await self.ros.ask(take_down)

    def _begin(self, handler: Handler, request: Any, reply: Callable[[Fields], object]) -> None:
        def done(task: asyncio.Task[Fields]) -> None:
            self._work.discard(task)
            self._answered = self.loop.time()
            reply(_refusal(self.cancelled) if task.cancelled() else task.result())

        task = self.loop.create_task(_answer(handler, request))
        self._work.add(task)
        task.add_done_callback(done)

    # on the ROS thread

    def callback(self, handler: Handler) -> Callable[[Any, Any], Awaitable[Any]]:
        """Return a callback for `rclpy` that has the handler answer; for any service in a reentrant callback group."""
        return partial(self._serve, handler)

    async def _serve(self, handler: Handler, request: Any, response: Any) -> Any:
        """Have the event loop answer; `rclpy` goes on with other callbacks until the future is set."""
        from rclpy.task import Future  # here, because rclpy is an extra

        answer = Future()
        self._unanswered += 1
        try:
            self.loop.call_soon_threadsafe(self._begin, handler, request, lambda fields: self.ros.call(lambda: answer.set_result(fields)))
            fields: Fields = await answer
        except RuntimeError:  # the event loop is closed
            fields = _refusal(self.ended)
        finally:
            self._unanswered -= 1
        known = type(response).get_fields_and_field_types()
        return to_message(type(response), {name: value for name, value in fields.items() if name in known})


async def arrived(answered: float, arrival: float = ARRIVAL) -> None:
    """Wait until a response that was sent at this time, on the clock of the event loop, has arrived."""
    await asyncio.sleep(answered + arrival - asyncio.get_running_loop().time())


async def _answer(handler: Handler, request: Any) -> Fields:
    try:
        return {"success": True, **(await handler(request) or {})}
    except (PnmError, TaskRefused) as error:
        return _refusal(str(error))
    except Exception as error:
        _log.exception("a request failed")
        return _refusal(f"{type(error).__name__}: {error}")


def _refusal(message: str) -> Fields:
    return {"success": False, "message": printable(message)}


# --- a topic of ours: a publisher that is used from the event loop's thread, and knows how many subscribe ---


@dataclass(eq=False, repr=False)
class Publisher:
    """One topic to publish on. What is private, and the number of subscriptions, changes."""

    ros: RosThread
    type_name: str
    name: str
    is_latched: bool = False
    """Whether late subscribers get the last message, and no earlier one: until the last came they would believe that."""
    matched: Callable[[], None] = lambda: None
    """Called on the event loop's thread at every new subscription."""
    subscriptions: int = 0
    """The number of subscriptions, on the event loop's thread."""
    _publisher: Any = None
    """That of `rclpy`, on the ROS thread."""

    def __post_init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._type = import_type(self.type_name)

    async def open(self) -> None:
        """Advertise the topic."""

        def count(info: Any) -> None:
            self.subscriptions = info.current_count
            if info.current_count_change > 0:
                self.matched()

        def advertise() -> None:
            from rclpy.event_handler import PublisherEventCallbacks  # here, because rclpy is an extra

            qos = profile(1 if self.is_latched else DEPTH, latched=self.is_latched)
            matched = PublisherEventCallbacks(matched=partial(call_on_loop, self._loop, count))
            self._publisher = self.ros.node.create_publisher(self._type, self.name, qos, event_callbacks=matched)

        await self.ros.ask(advertise)

    def publish(self, fields: Mapping[str, object] | Callable[[], Mapping[str, object]]) -> None:
        """Publish a message of these fields, or of those that a function returns on the ROS thread."""

        def publish() -> None:
            if self._publisher is not None:
                self._publisher.publish(to_message(self._type, fields() if callable(fields) else fields))

        self.ros.call(publish)

    async def close(self) -> None:
        """Withdraw the topic."""

        def withdraw() -> None:
            if self._publisher is not None:
                self.ros.node.destroy_publisher(self._publisher)
                self._publisher = None

        await self.ros.ask(withdraw)


# --- a rate limit: a call per key and period, at once after a pause; calls in between become one ----

K = TypeVar("K", bound=Hashable)


class Throttle(Generic[K]):
    """Calls a function for every key that was noted: in the next turn of the loop, or a period (seconds) after its last call.

    The mutable state is, by key, the timer of the call that is due and the time of the last call.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, period: float, function: Callable[[K], None]) -> None:
        self._loop = loop
        self._period = period
        self._function = function
        self._due: dict[K, asyncio.TimerHandle] = {}
        self._called: dict[K, float] = {}

    def note(self, key: K) -> None:
        """Make a call due, unless there is one."""
        if key not in self._due:
            at = self._called[key] + self._period if key in self._called else self._loop.time()
            self._due[key] = self._loop.call_at(at, self.at_once, key)

    def at_once(self, key: K) -> None:
        """Call now, however long the last call is ago, instead of a call that is due."""
        if key in self._due:
            self._due.pop(key).cancel()
        self._called[key] = self._loop.time()
        self._function(key)

    def forget(self, key: K) -> None:
        """Drop the call that is due for a key, and the time of its last call."""
        self._called.pop(key, None)
        if key in self._due:
            self._due.pop(key).cancel()

    def close(self) -> None:
        """Drop all calls that are due."""
        for key in (*self._due, *self._called):
            self.forget(key)
