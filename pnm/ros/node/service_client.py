"""A client of a service that may be missing, slow or dead: every call has a limit.

At first contact a response may be lost: DDS matches the two topics of a service one after the other, so a server may read our
request before it has matched our reader of responses. So until a service has responded once, a request is repeated,
and the first response counts.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping
from difflib import get_close_matches
from functools import partial
from typing import Any, Final

from pnm.knowledge.source import SourceError
from pnm.ros.node.messages import FieldError, import_type, to_message
from pnm.ros.node.ros_thread import RosThread, call_on_loop

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

    def __repr__(self) -> str:
        return f"<ServiceClient {self._name}>"

    async def call(self, request: Mapping[str, object], limit: float) -> Any:
        """Send the request as soon as the service is there, and return the response.

        Raises `SourceError` if there is no such service, it does not answer in time, or the request does not fit it.
        """
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
        await self._ros.ask(self._destroy)

    async def _answer(self, message: Any) -> Any:
        loop = asyncio.get_running_loop()
        answered: asyncio.Future[Any] = loop.create_future()

        def receive(future: Any) -> None:
            self._met = True
            if not answered.done():
                answered.set_result(future.result())

        sent: list[Any] = []
        try:
            while not answered.done():
                met = self._met
                sent.append(await self._ros.ask(partial(self._send, message, partial(call_on_loop, loop, receive))))
                await asyncio.wait((answered,), timeout=None if met else AGAIN)
            return answered.result()
        finally:
            self._ros.call(partial(self._forget, sent))

    # on the ROS thread

    def _ready(self) -> bool:
        from rclpy.qos import QoSProfile  # here, because rclpy is an extra

        if self._client is None:
            self._client = self._ros.node.create_client(self._type, self._name, qos_profile=QoSProfile(depth=100))
        ready = bool(self._client.service_is_ready())
        self._met &= ready  # a service that comes back is a new process, which has yet to discover us
        return ready

    def _send(self, message: Any, answered: Callable[[Any], None]) -> Any:
        future = self._client.call_async(message)
        future.add_done_callback(answered)
        return future

    def _forget(self, futures: Iterable[Any]) -> None:
        if self._client is not None:
            for future in futures:
                self._client.remove_pending_request(future)

    def _absence(self) -> str:
        full = str(self._ros.node.resolve_service_name(self._name))
        known = [name for name, _ in self._ros.node.get_service_names_and_types()]
        near = [name for name in get_close_matches(full, known, 4) if name != full]
        similar = f"; similar are {', '.join(near)}" if near else ""
        return f"there is no service {full}{similar}"

    def _destroy(self) -> None:
        if self._client is not None:
            self._ros.node.destroy_client(self._client)
            self._client = None
