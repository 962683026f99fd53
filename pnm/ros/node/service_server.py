"""Services whose requests are answered by coroutines on the event loop's thread; one that waits holds up no other."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from functools import partial
from typing import Any, Final, TypeAlias

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.qos import QoSProfile
from rclpy.task import Future

from pnm.errors import PnmError
from pnm.knowledge.sources.person_text import printable
from pnm.ros.node.messages import import_type, to_message
from pnm.ros.node.ros_thread import RosThread
from pnm.ros.node.service_client import until_true
from pnm.tasks import TaskRefused

DEPTH: Final = 1000
"""Requests that may wait unread."""
_FAREWELL: Final = 1.0
"""Seconds in which the last answers are sent."""
ARRIVAL: Final = 1.0
"""Seconds in which an answer arrives: whoever is destroyed before takes along what has not."""

Fields: TypeAlias = Mapping[str, object]
Work: TypeAlias = Callable[[Any], Awaitable[Fields]]
"""Returns the fields of the response to a request; what it raises is the message of a response without success."""

_log = logging.getLogger(__name__)


class RequestServices:
    """Some services, opened and closed together. Their responses have the fields ``success`` and ``message``.

    The mutable state is, on the event loop's thread, the requests at work, and when the last one was answered; on the ROS thread,
    the services and the number of requests that are not answered yet.
    """

    def __init__(self, ros: RosThread) -> None:
        self._ros = ros
        self._loop = asyncio.get_running_loop()
        self._work: set[asyncio.Task[Fields]] = set()
        self._services: list[Any] = []
        self._unanswered = 0
        self._answered = -math.inf

    def __repr__(self) -> str:
        return f"<RequestServices {len(self._services)} services, {len(self._work)} requests at work>"

    # on the event loop's thread

    async def open(self, services: Mapping[str, tuple[str, Work]]) -> None:
        """Offer services: by name, relative to the node's namespace, their types and who does the work.

        Raises:
            InputError: a type is not installed.
        """
        for name, (kind, work) in services.items():
            await self._ros.ask(partial(self._offer, name, import_type(kind), work))

    async def close(self) -> None:
        """Refuse what is still at work, and take the services down."""
        for task in self._work:
            task.cancel()
        if self._work:
            await asyncio.wait(self._work)
        with suppress(TimeoutError):
            async with asyncio.timeout(_FAREWELL):
                await until_true(self._ros, lambda: not self._unanswered)
        await arrived(self._answered)
        await self._ros.ask(self._take_down)

    def _begin(self, work: Work, request: Any, reply: Callable[[Fields], object]) -> None:
        task = self._loop.create_task(_answer(work, request))
        self._work.add(task)
        task.add_done_callback(partial(self._done, reply))

    def _done(self, reply: Callable[[Fields], object], task: asyncio.Task[Fields]) -> None:
        self._work.discard(task)
        self._answered = self._loop.time()
        reply(_refusal("the node is shut down, or cleaned up") if task.cancelled() else task.result())

    # on the ROS thread

    def answering(self, work: Work) -> Callable[[Any, Any], Awaitable[Any]]:
        """Return the callback of a service that has the work done; it may be that of any service in a reentrant group."""
        return partial(self._serve, work)

    def _offer(self, name: str, kind: Any, work: Work) -> None:
        # reentrant: the next request is taken while this one waits
        deep, group = QoSProfile(depth=DEPTH), ReentrantCallbackGroup()
        service = self._ros.node.create_service(kind, name, self.answering(work), qos_profile=deep, callback_group=group)
        self._services.append(service)

    async def _serve(self, work: Work, request: Any, response: Any) -> Any:
        """Have the work done on the event loop's thread; rclpy goes on with others until the future is set."""
        answer = Future()
        self._unanswered += 1
        try:
            self._loop.call_soon_threadsafe(self._begin, work, request, lambda fields: self._ros.call(lambda: answer.set_result(fields)))
            fields: Fields = await answer
        except RuntimeError:  # the event loop is closed
            fields = _refusal("the node has ended")
        finally:
            self._unanswered -= 1
        known = type(response).get_fields_and_field_types()
        return to_message(type(response), {name: value for name, value in fields.items() if name in known})

    def _take_down(self) -> None:
        for service in self._services:
            self._ros.node.destroy_service(service)
        self._services.clear()


async def arrived(answered: float) -> None:
    """Wait until an answer that was given at this time, on the clock of the event loop, has arrived."""
    await asyncio.sleep(answered + ARRIVAL - asyncio.get_running_loop().time())


async def _answer(work: Work, request: Any) -> Fields:
    try:
        return {"success": True, **await work(request)}
    except (PnmError, TaskRefused) as error:
        return _refusal(str(error))
    except Exception as error:
        _log.exception("a request failed")
        return _refusal(f"{type(error).__name__}: {error}")


def _refusal(message: str) -> Fields:
    return {"success": False, "message": printable(message)}
