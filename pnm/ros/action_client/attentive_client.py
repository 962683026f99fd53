"""An action client of `rclpy` that keeps the latest feedback about each goal, and notices when a request is answered twice.

Two answers mean that two servers of one name are alive.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final
from uuid import UUID
from weakref import WeakValueDictionary

from rclpy.action import ActionClient
from rclpy.task import Future

from pnm.ros.action_client.goal import Goal

_REMEMBERED: Final = 1000
"""Requests whose second answer is noticed."""


class AttentiveClient(ActionClient):  # type: ignore[misc]
    """An action client that keeps feedback, and notices second answers, which `rclpy` ignores.

    The mutable state is the requests answered last, by kind and number, with the goal that the request has sent, if it was one; and
    the goals whose feedback is kept, as long as they are.

    Args:
        answered_twice: called with that goal.
        may_act: whether something may be cancelled; asked right before that. What may not be is as a request that got lost.
    """

    def __init__(
        self, *args: Any, answered_twice: Callable[[UUID | None], None], may_act: Callable[[], bool] = lambda: True, **options: Any
    ) -> None:
        self._answered_twice = answered_twice
        self._may_act = may_act
        self._answered: dict[tuple[str, int], UUID | None] = {}
        self._followed: WeakValueDictionary[bytes, Goal] = WeakValueDictionary()
        super().__init__(*args, **options)

    def follow(self, goal: Goal) -> None:
        """Keep the latest feedback about a goal as its `feedback`."""
        self._followed[goal.request.id.bytes] = goal

    def forget(self, goal: Goal) -> None:
        """Forget that a goal was accepted, so that it may be sent again; `rclpy` takes the second acceptance for an error otherwise."""
        self._goal_handles.pop(goal.request.id.bytes, None)

    def _cancel_goal_async(self, goal_handle: Any) -> Any:
        """Send the request to cancel a goal, however that was asked for."""
        return super()._cancel_goal_async(goal_handle) if self._may_act() else Future()

    async def execute(self, taken_data: dict[str, Any]) -> None:
        """Handle what has arrived."""
        if (feedback := taken_data.pop("feedback", None)) and (goal := self._followed.get(bytes(feedback.goal_id.uuid))):
            goal.feedback = feedback.feedback  # there may be a thousand a second: the last one counts, when somebody looks
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
