"""A managed node, as the life cycle of ROS 2 has it, whose transitions take their time.

`rclpy` makes a transition within one callback. Ours wait for action servers, which are reached through the same thread; so a
transition begins on that thread, its work is done on the event loop's, and it ends on the ROS thread again.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any, Protocol

from pnm.errors import PnmError
from pnm.ros.node.managed_node import _refuse
from pnm.ros.node.ros_thread import RosThread
from pnm.ros.node.service_server import Fields, RequestServices

_log = logging.getLogger(__name__)


class Managed(Protocol):
    """What a managed node does. A transition that cannot be made raises, and leaves everything as it was."""

    async def configure(self) -> None:
        """Read what is needed, and get ready."""

    async def activate(self) -> None:
        """Begin to work, or go on."""

    async def deactivate(self) -> None:
        """Stop working for now."""

    async def cleanup(self) -> None:
        """Let go of everything that `configure` got hold of, if there is anything."""


class Lifecycle:
    """Leads a managed node through its states, for whoever asks.

    The mutable state is the service's requests at work.

    Args:
        ros: the thread of a node that was made with ``managed=True``.
        managed: does the work.
    """

    def __init__(self, ros: RosThread, managed: Managed) -> None:
        self._ros = ros
        self._managed = managed
        self._requests = RequestServices(ros)
        self.finalized = asyncio.Event()
        """Set when the node was shut down by a transition."""

    async def open(self) -> None:
        """Answer those who ask for transitions."""
        await self._ros.ask(lambda: self._ros.node.answer(self._requests.answering(self._asked)))

    async def close(self) -> None:
        """Stop what goes on, and shut the node down."""
        await self._ros.ask(lambda: self._ros.node.answer(_refuse))
        await self._requests.close()
        if not self.finalized.is_set():
            await self.change("shutdown")

    async def change(self, wanted: int | str) -> None:
        """Make a transition, given by its number or its label.

        Raises:
            RosError: it cannot be made in this state.
            PnmError: it was tried and has failed; the node is in the state in which it was.
        """
        label = await self._ros.ask(partial(self._ros.node.begin, wanted))
        try:
            await self._work(label)()
        except BaseException as error:
            await self._fail(error)
            raise
        await self._ros.ask(partial(self._ros.node.end, "success"))
        if label == "shutdown":
            self.finalized.set()

    async def _fail(self, error: BaseException) -> None:
        if isinstance(error, PnmError):
            await self._ros.ask(partial(self._ros.node.end, "failure"))
            return
        await self._ros.ask(partial(self._ros.node.end, "error"))
        await self._managed.cleanup()
        await self._ros.ask(partial(self._ros.node.end, "success"))  # of dealing with the error: the node is unconfigured

    def _work(self, label: str) -> Callable[[], Awaitable[None]]:
        match label:
            case "configure":
                return self._managed.configure
            case "activate":
                return self._managed.activate
            case "deactivate":
                return self._managed.deactivate
            case _:  # cleanup and shutdown
                return self._managed.cleanup

    async def _asked(self, request: Any) -> Fields:
        wanted = request.transition.label or request.transition.id
        try:
            await self.change(wanted)
        except PnmError as error:
            _log.error("the transition %s has failed: %s", wanted, error)
            raise
        return {}
