"""Services whose requests are answered by coroutines on the event loop's thread; one that waits holds up no other."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from functools import partial
from typing import Any, Final, TypeAlias

from pnm.errors import PnmError, printable
from pnm.ros.node.messages import import_type, to_message
from pnm.ros.node.ros_thread import RosThread
from pnm.ros.node.service_client import until_true
from pnm.tasks import TaskRefused

DEPTH: Final = 1000
"""Requests that may wait unread; they come in bursts."""
_FAREWELL: Final = 1.0
"""Seconds to send the last responses."""
ARRIVAL: Final = 1.0
"""Seconds in which a response arrives: a publisher that is destroyed earlier takes unsent data along."""

Fields: TypeAlias = Mapping[str, object]
Handler: TypeAlias = Callable[[Any], Awaitable[Fields]]
"""Returns the fields of the response to a request; an exception becomes the message of a response without success."""

_log = logging.getLogger(__name__)


class RequestServices:
    """Some services, opened and closed together. Their responses have the fields ``success`` and ``message``.

    The mutable state is, on the event loop's thread, the requests at work, and when the last one was answered; on the ROS thread,
    the services and the number of requests that are not answered yet.

    Args:
        loop: the event loop that answers; the running one by default.
        cancelled: the message for requests that are cancelled, such as by `close`.
        ended: the message for requests after the end of the event loop.
        arrival: seconds that `close` leaves the last response to arrive.
    """

    def __init__(
        self,
        ros: RosThread,
        *,
        loop: asyncio.AbstractEventLoop | None = None,
        cancelled: str = "the node is shut down, or cleaned up",
        ended: str = "the node has ended",
        arrival: float = ARRIVAL,
    ) -> None:
        self._ros = ros
        self._loop = loop or asyncio.get_running_loop()
        self._cancelled = cancelled
        self._ended = ended
        self._arrival = arrival
        self._work: set[asyncio.Task[Fields]] = set()
        self._services: list[Any] = []
        self._unanswered = 0
        self._answered = -math.inf

    def __repr__(self) -> str:
        return f"<RequestServices {len(self._services)} services, {len(self._work)} requests at work>"

    # on the event loop's thread

    async def open(self, services: Mapping[str, tuple[str, Handler]]) -> None:
        """Offer services: by name, relative to the node's namespace, their types and handlers."""
        for name, (kind, handler) in services.items():
            await self._ros.ask(partial(self._offer, name, import_type(kind), handler))

    async def close(self) -> None:
        """Refuse the requests that are at work, and take the services down."""
        for task in self._work:
            task.cancel()
        if self._work:
            await asyncio.wait(self._work)
        # Three things in this order: the coroutines have ended, rclpy has sent their responses, and these have arrived.
        with suppress(TimeoutError):
            async with asyncio.timeout(_FAREWELL):
                await until_true(self._ros, lambda: not self._unanswered)
        await arrived(self._answered, self._arrival)
        await self._ros.ask(self._take_down)

    def _begin(self, handler: Handler, request: Any, reply: Callable[[Fields], object]) -> None:
        task = self._loop.create_task(_answer(handler, request))
        self._work.add(task)
        task.add_done_callback(partial(self._done, reply))

    def _done(self, reply: Callable[[Fields], object], task: asyncio.Task[Fields]) -> None:
        self._work.discard(task)
        self._answered = self._loop.time()
        reply(_refusal(self._cancelled) if task.cancelled() else task.result())

    # on the ROS thread

    def callback(self, handler: Handler) -> Callable[[Any, Any], Awaitable[Any]]:
        """Return a callback for `rclpy` that has the handler answer; for any service in a reentrant callback group."""
        return partial(self._serve, handler)

    def _offer(self, name: str, kind: Any, handler: Handler) -> None:
        from rclpy.callback_groups import ReentrantCallbackGroup  # here, because rclpy is an extra
        from rclpy.qos import QoSProfile

        # reentrant: the next request is taken while this one waits
        deep, group = QoSProfile(depth=DEPTH), ReentrantCallbackGroup()
        service = self._ros.node.create_service(kind, name, self.callback(handler), qos_profile=deep, callback_group=group)
        self._services.append(service)

    async def _serve(self, handler: Handler, request: Any, response: Any) -> Any:
        """Have the event loop answer; `rclpy` goes on with other callbacks until the future is set."""
        from rclpy.task import Future  # here, because rclpy is an extra

        answer = Future()
        self._unanswered += 1
        try:
            self._loop.call_soon_threadsafe(self._begin, handler, request, lambda fields: self._ros.call(lambda: answer.set_result(fields)))
            fields: Fields = await answer
        except RuntimeError:  # the event loop is closed
            fields = _refusal(self._ended)
        finally:
            self._unanswered -= 1
        known = type(response).get_fields_and_field_types()
        return to_message(type(response), {name: value for name, value in fields.items() if name in known})

    def _take_down(self) -> None:
        for service in self._services:
            self._ros.node.destroy_service(service)
        self._services.clear()


async def arrived(answered: float, arrival: float = ARRIVAL) -> None:
    """Wait until a response that was sent at this time, on the clock of the event loop, has arrived."""
    await asyncio.sleep(answered + arrival - asyncio.get_running_loop().time())


async def _answer(handler: Handler, request: Any) -> Fields:
    try:
        return {"success": True, **await handler(request)}
    except (PnmError, TaskRefused) as error:
        return _refusal(str(error))
    except Exception as error:
        _log.exception("a request failed")
        return _refusal(f"{type(error).__name__}: {error}")


def _refusal(message: str) -> Fields:
    return {"success": False, "message": printable(message)}
