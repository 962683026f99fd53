"""An action client of `rclpy` that notices when a request is answered twice: then two servers of one name are alive."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final
from uuid import UUID

from rclpy.action import ActionClient

_REMEMBERED: Final = 1000
"""Requests whose second answer is noticed."""


class AttentiveClient(ActionClient):  # type: ignore[misc]
    """An action client that notices second answers, which `rclpy` ignores.

    The mutable state is the requests answered last, by kind and number, with the goal that the request has sent, if it was one.

    Args:
        answered_twice: called with that goal.
    """

    def __init__(self, *args: Any, answered_twice: Callable[[UUID | None], None], **options: Any) -> None:
        self._answered_twice = answered_twice
        self._answered: dict[tuple[str, int], UUID | None] = {}
        super().__init__(*args, **options)

    async def execute(self, taken_data: dict[str, Any]) -> None:
        """Handle what has arrived."""
        for kind in taken_data.keys() & {"goal", "cancel", "result"}:
            number, _ = taken_data[kind]
            if (kind, number) in self._answered:
                del taken_data[kind]
                self._answered_twice(self._answered[kind, number])
            else:
                sent = self._goal_sequence_number_to_goal_id.get(number) if kind == "goal" else None
                self._answered[kind, number] = UUID(bytes=bytes(sent.uuid)) if sent else None
                if len(self._answered) > _REMEMBERED:
                    del self._answered[next(iter(self._answered))]
        await super().execute(taken_data)
