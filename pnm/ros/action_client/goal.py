"""One goal on its way through an action server, and what its end is called."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from pnm.core.machine.requests import Ended, Outcome, OutcomeKind, Report, Request
from pnm.ros.action_client.liveness import Watch

# action_msgs/msg/GoalStatus
UNKNOWN: Final = 0
OVER: Final = {4: OutcomeKind.SUCCEEDED, 5: OutcomeKind.CANCELED, 6: OutcomeKind.ABORTED}

_MESSAGES: Final = ("message", "error_msg", "error_string")
"""Result fields in which servers say how it went: ours, Nav2's, MoveIt's and control's."""


@dataclass(eq=False)
class Goal:
    """A request and how far it has come; every field after the first five changes, on the ROS thread only."""

    request: Request
    accept: float
    """Seconds the server may take to answer."""
    tell: Callable[[Report], None]
    mapped: Mapping[str, object] | None = None
    """The fields that the binding names, if it has a goal mapping."""
    is_blind: bool = False
    """Whether it was filled when nobody knew which fields there are: with all that may be one."""
    sent: float = 0.0
    handle: Any = None
    watch: Watch = field(default_factory=lambda: Watch(frozenset()))
    cancel_asked: bool = False
    cancel_sent: float | None = None
    cancel_answered: bool = False
    results: list[Any] = field(default_factory=list)
    """The futures of the requests for the result."""
    restarted: float | None = None
    """When the server said that it does not know the goal."""
    ended: bool = False

    def end(self, kind: OutcomeKind, message: str = "", result: Mapping[str, object] | None = None) -> None:
        """Report the end, once."""
        if not self.ended:
            self.ended = True
            self.tell(Ended(self.request.id, Outcome(kind, result or {}, message)))

    def unfilled(self, known: tuple[str, ...]) -> tuple[str, ...]:
        """Return the fields that should have a value and have none; what was not looked for cannot be missed before."""
        return tuple(name for name in known if name not in self.request.goal) if self.is_blind and self.mapped is None else ()

    def data(self, known: tuple[str, ...]) -> dict[str, object]:
        """Return the values for the fields."""
        wanted = {*known, *(self.mapped or ())}
        return {name: value for name, value in self.request.goal.items() if not self.is_blind or name in wanted}

    @property
    def over(self) -> bool:
        """Whether the server's status topic says that the goal is over."""
        return self.handle is not None and self.handle.status in OVER

    @property
    def wants_cancel(self) -> bool:
        """Whether a cancellation was asked for that the server has not answered."""
        return self.cancel_asked and not self.cancel_answered


def message_in(result: Mapping[str, object]) -> str:
    """Return what the result says in words, if it has a field for it."""
    texts = (result.get(name) for name in _MESSAGES)
    return next((text for text in texts if isinstance(text, str) and text), "")
