"""A ROS 2 node with the states of a managed life cycle."""

from __future__ import annotations

from collections.abc import Callable
from time import time_ns
from typing import Any, Final
from uuid import uuid4

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.lifecycle import LifecycleNodeMixin
from rclpy.node import Node

from pnm.errors import RosError
from pnm.ros.node.messages import import_type

STARTED: Final = "~/_started/t"
"""The beginning of the names of topics that show the starts of nodes of this name; nothing is published there."""
_ENDING: Final = "transition_"
"""The prefix of the labels of transitions that end another one; the node makes them, clients may not."""


class ManagedNode(LifecycleNodeMixin, Node):  # type: ignore[misc]
    """A node with the services and the topic of a life cycle; belongs to the ROS thread."""

    def __init__(self, name: str, *, namespace: str, context: Any) -> None:
        Node.__init__(self, name, namespace=namespace, context=context)
        # reentrant: other services answer while a transition takes its time
        LifecycleNodeMixin.__init__(self, callback_group=ReentrantCallbackGroup())
        self.set_change_state(refuse_transition)
        self.start = f"{time_ns():020d}_{uuid4().hex}"
        """The start time of the node, and a random number: nodes of the same name are in this order."""
        self.create_publisher(import_type("builtin_interfaces/msg/Time"), STARTED + self.start, 1)

    def set_change_state(self, callback: Callable[[Any, Any], Any]) -> None:
        """Set the callback of the service ``change_state``, in place of that of `rclpy`, which has no other hook."""
        self._service_change_state.callback = callback

    @property
    def state(self) -> str:
        """The state, such as ``inactive``."""
        return str(self._state_machine.current_state[1])

    def begin(self, wanted: int | str) -> str:
        """Begin a transition, given by its number or its label; return the label, or raise a `RosError` if it cannot be made now."""
        available = self._state_machine.available_transitions
        possible = {number: label for number, label, *_ in available if not label.startswith(_ENDING)}
        for number, label in possible.items():
            if wanted in (number, label):
                self._state_machine.trigger_transition_by_id(number, True)
                return str(label)
        now = f"expected one of {', '.join(possible.values())}" if possible else "wait until that is over"
        raise RosError(f"the transition {wanted!r} cannot be made: the node is {self.state}; {now}")

    def end(self, how: str) -> None:
        """End the transition that has begun: ``success``, ``failure`` or ``error``."""
        self._state_machine.trigger_transition_by_label(_ENDING + how, True)


def refuse_transition(_request: Any, response: Any) -> Any:
    """Refuse a request for a transition: nothing is there to carry it out."""
    response.success = False
    return response
