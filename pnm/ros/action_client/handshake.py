"""Whether a goal may be sent to the processes that serve an action: they know us, and are done with what we gave up.

A server answers into the void as long as it has not discovered who asks. So strange processes are *greeted* first: they
are asked for the result of a goal that nobody has, again and again until an answer gets through; the service of results
is the last that a client announces, so whoever found it found all. Processes that left the graph are strangers
when they come back, because they have forgotten us as well: that is what a link looks like that was cut and has healed.
The same holds for those that nobody has looked after for a while.

A goal that was given up because its server went away is a *stray*: cut off from us, the server may go on with it. When
it is back it is asked to cancel the strays, and sent nothing new before it says that they are over or that it knows
nothing of them. Everything here runs on the ROS thread.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any, Final
from uuid import UUID, uuid4

from pnm.ros.action_client.liveness import AGAIN

UNWATCHED: Final = 2.0
"""Seconds between two looks after which an acquaintance is over: a cut that we and the servers noticed lasts longer."""


class Acquaintance:
    """What the processes that serve one action know of us.

    The mutable state is who has answered, when that was last looked after, the greetings without an answer, and the strays.

    Args:
        client: of the action.
        changed: called when an answer got through.
    """

    def __init__(self, client: Any, changed: Callable[[], None]) -> None:
        self._client = client
        self._changed = changed
        self._met: frozenset[bytes] | None = None
        self._looked = -math.inf
        self._greetings: list[Any] = []
        self._greeted = -math.inf
        self._strays: dict[UUID, Any] = {}
        self._called_back = -math.inf

    def __repr__(self) -> str:
        return f"<Acquaintance {'strange' if self._met is None else 'met'}, {len(self._strays)} strays>"

    @property
    def strays(self) -> int:
        """How many goals were given up of which the servers have not said that they are over."""
        return len(self._strays)

    def look(self, present: frozenset[bytes], now: float) -> bool:
        """Note who is there now; tell whether all of them know us and none may be at work on a stray."""
        if self._met is not None:
            self._met = self._met & present if now - self._looked < UNWATCHED else None
        self._looked = now
        return self._met is not None and present <= self._met and not self._strays

    def approach(self, present: frozenset[bytes], now: float) -> None:
        """Greet those who are there, or call the strays back; to be called when the server is ready."""
        if self.look(present, now):
            return
        if self._met is None or not present <= self._met:
            if now - self._greeted >= AGAIN:
                self._greet(present, now)
        elif now - self._called_back >= AGAIN:
            self._called_back = now
            for goal, handle in tuple(self._strays.items()):
                handle.cancel_goal_async()
                handle.get_result_async().add_done_callback(partial(self._found, goal))

    def give_up(self, goal: UUID, handle: Any) -> None:
        """Note a stray, with its handle if it was ever accepted."""
        self._strays[goal] = handle or self._handle(goal)

    def _greet(self, present: frozenset[bytes], now: float) -> None:
        self._greeted = now
        future = self._handle(uuid4()).get_result_async()
        self._greetings.append(future)
        future.add_done_callback(partial(self._meet, present))

    def _meet(self, present: frozenset[bytes], future: Any) -> None:
        if not future.cancelled():
            self._met = present
            self._greetings.clear()
            self._changed()

    def _found(self, goal: UUID, future: Any) -> None:
        """Whatever is said of a stray ends it: it is over, or the server does not know it."""
        if not future.cancelled() and self._strays.pop(goal, None) is not None and not self._strays:
            self._changed()

    def _handle(self, goal: UUID) -> Any:
        from rclpy.action.client import ClientGoalHandle

        return ClientGoalHandle(self._client, ros_uuid(goal), self._client._action_type.Impl.SendGoalService.Response())


def ros_uuid(uuid: UUID) -> Any:
    """Return the id as a message."""
    from unique_identifier_msgs import msg

    return msg.UUID(uuid=list(uuid.bytes))
