"""The life cycle of a managed ROS 2 node, with transitions that take their time, and whether it is the only one of its name.

`rclpy` makes a transition within one callback. Ours wait for action servers, which are reached through the same thread; so a
transition begins on the ROS thread, is carried out on the event loop, and ends on the ROS thread again.
"""

from __future__ import annotations

import asyncio
import logging
from functools import partial
from typing import Any, Final, Protocol

from pnm.errors import PnmError, RosError
from pnm.ros.node.graph import processes
from pnm.ros.node.managed_node import STARTED, refuse_transition
from pnm.ros.node.ros_thread import RosThread
from pnm.ros.node.services import RequestServices

_log = logging.getLogger(__name__)


class ManagedTransitions(Protocol):
    """The transitions of a managed node. One that cannot be made raises, and changes nothing."""

    async def configure(self) -> None:
        """Read the configuration, and acquire resources."""

    async def activate(self) -> None:
        """Begin to work, or resume it."""

    async def deactivate(self) -> None:
        """Suspend work."""

    async def cleanup(self) -> None:
        """Release the resources that `configure` acquired, if there are any."""


class Lifecycle:
    """Makes the transitions of a node made with ``managed=True``, for its program or over the service ``change_state``."""

    def __init__(self, ros: RosThread, transitions: ManagedTransitions) -> None:
        self._ros = ros
        self._transitions = transitions
        self._requests = RequestServices(ros)
        self.finalized = asyncio.Event()
        """Set when the node was shut down by a transition."""

    async def open(self) -> None:
        """Accept requests for transitions."""

        async def requested(request: Any) -> None:
            wanted = request.transition.label or request.transition.id
            try:
                await self.change(wanted)
            except PnmError as error:
                _log.error("the transition %s has failed: %s", wanted, error)
                raise

        await self._ros.ask(lambda: self._ros.node.set_change_state(self._requests.callback(requested)))

    async def close(self) -> None:
        """Refuse requests from now on, cancel those at work, and shut the node down."""
        await self._ros.ask(lambda: self._ros.node.set_change_state(refuse_transition))
        await self._requests.close()
        if not self.finalized.is_set():
            await self.change("shutdown")

    async def change(self, wanted: int | str) -> None:
        """Make a transition, given by number or label; raise `RosError` if it cannot be made in this state, `PnmError` if it has failed."""
        label = await self._ros.ask(partial(self._ros.node.begin, wanted))
        transition = getattr(self._transitions, "cleanup" if label == "shutdown" else label)
        try:
            await transition()
        except PnmError:
            await self._ros.ask(partial(self._ros.node.end, "failure"))  # back to the previous state
            raise
        except BaseException:
            await self._ros.ask(partial(self._ros.node.end, "error"))
            await self._transitions.cleanup()
            await self._ros.ask(partial(self._ros.node.end, "success"))  # of the state "error processing": unconfigured
            raise
        await asyncio.shield(self._ros.ask(partial(self._ros.node.end, "success")))  # it is done, and a signal may come just now
        if label == "shutdown":
            self.finalized.set()


# --- the only node of its name -------------------------------------------------------------
# Of several that start at the same time the one that was started first goes on.

_ADVICE: Final = "(one that was killed is remembered for up to 20 s)"


async def check_alone(ros: RosThread, servers: tuple[str, ...]) -> None:
    """Raise a `RosError` if another process has the name of the node, unless it was started later, or of one of these action servers."""

    def is_first() -> bool:
        """Return whether all other nodes of the name, if there are any, show that they were started later."""
        for name in servers:
            if processes(ros.node, name):
                raise RosError(f"there is an action server {name} already; another process offers it {_ADVICE}")
        own = (ros.node.get_name(), ros.node.get_namespace())
        prefix = ros.node.resolve_topic_name(STARTED)
        starts = [topic for topic, _ in ros.node.get_topic_names_and_types() if topic.startswith(prefix)]
        rivals = ros.node.get_node_names_and_namespaces().count(own) - 1
        return rivals < 1 or bool(len(starts) > rivals and min(starts) == prefix + ros.node.start)

    for _ in range(2):  # of a node that is being started, its name may be seen before its start
        await ros.settled()
        if await ros.ask(is_first):
            return
    name = await ros.ask(ros.node.get_fully_qualified_name)
    raise RosError(f"there is a node {name} already; is this being served? {_ADVICE}")
