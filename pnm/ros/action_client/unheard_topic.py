"""A subscription that wakes nobody: its messages wait in the middleware until they are taken.

Action servers report what they are at work on more often than anybody can look at it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks


class Unheard(CallbackGroup):  # type: ignore[misc]
    """A callback group of which the executor executes nothing, and waits for nothing."""

    def can_execute(self, entity: object) -> bool:
        """Return False."""
        return False

    def beginning_execution(self, entity: object) -> bool:
        """Return False."""
        return False


class UnheardTopic:
    """A subscription without a callback, only to be used on the ROS thread.

    Args:
        raw: whether messages are taken as the bytes that have arrived.
    """

    def __init__(self, node: Any, kind: Any, topic: str, qos: Any, *, raw: bool = False) -> None:
        self._node = node
        quiet = SubscriptionEventCallbacks(use_default_callbacks=False)
        self._subscription = node.create_subscription(
            kind, topic, lambda message: None, qos, raw=raw, callback_group=Unheard(), event_callbacks=quiet
        )

    def __repr__(self) -> str:
        return f"<UnheardTopic {self._subscription.topic_name}>"

    def take(self) -> Iterator[Any]:
        """Yield the messages that have arrived since the last time."""
        with self._subscription.handle:
            while (taken := self._subscription.handle.take_message(self._subscription.msg_type, self._subscription.raw)) is not None:
                yield taken[0]

    def destroy(self) -> None:
        """Unsubscribe."""
        self._node.destroy_subscription(self._subscription)
