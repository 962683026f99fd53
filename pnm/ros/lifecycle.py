"""A managed node, as the life cycle of ROS 2 has it, whose transitions take their time.

`rclpy` makes a transition within one callback. Ours wait for action servers, which are reached through the same thread; so a
transition begins on that thread, its work is done on the event loop's, and it ends on the ROS thread again.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any, Final, Protocol

from lifecycle_msgs.msg import Transition
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.lifecycle import LifecycleNodeMixin
from rclpy.node import Node

from pnm.errors import PnmError
from pnm.ros.node import RosError, RosThread
from pnm.ros.request_services import Fields, RequestServices

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


class ManagedNode(LifecycleNodeMixin, Node):  # type: ignore[misc]
    """A node with the services and the topic of the life cycle; belongs to the ROS thread."""

    def __init__(self, name: str, *, namespace: str, context: Any) -> None:
        Node.__init__(self, name, namespace=namespace, context=context)
        # reentrant: others are served while a transition takes its time
        LifecycleNodeMixin.__init__(self, callback_group=ReentrantCallbackGroup())
        self.answer(_refuse)

    def answer(self, callback: Callable[[Any, Any], Any]) -> None:
        """Have somebody answer who is asked for transitions, in place of rclpy, which has no other way in."""
        self._service_change_state.callback = callback

    @property
    def state(self) -> str:
        """The state, such as ``inactive``."""
        return str(self._state_machine.current_state[1])

    def begin(self, wanted: int | str) -> str:
        """Begin a transition, given by its number or its label; return the label.

        Raises:
            RosError: it is none that can be made now.
        """
        possible = {number: label for number, label, *_ in self._state_machine.available_transitions if number in _ASKED}
        for number, label in possible.items():
            if wanted in (number, label):
                self._state_machine.trigger_transition_by_id(number, True)
                return str(label)
        now = f"expected one of {', '.join(possible.values())}" if possible else "wait until that is over"
        raise RosError(f"the transition {wanted!r} cannot be made: the node is {self.state}; {now}")

    def end(self, how: str) -> None:
        """End the transition that has begun: ``success``, ``failure`` or ``error``."""
        self._state_machine.trigger_transition_by_label(f"transition_{how}", True)


def _refuse(_request: Any, response: Any) -> Any:
    response.success = False
    return response


_ASKED: Final = frozenset(
    {
        Transition.TRANSITION_CONFIGURE,
        Transition.TRANSITION_CLEANUP,
        Transition.TRANSITION_ACTIVATE,
        Transition.TRANSITION_DEACTIVATE,
        Transition.TRANSITION_UNCONFIGURED_SHUTDOWN,
        Transition.TRANSITION_INACTIVE_SHUTDOWN,
        Transition.TRANSITION_ACTIVE_SHUTDOWN,
    }
)
"""The transitions that others may ask for; how one ends is for the node to say."""


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
