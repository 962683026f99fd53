"""One goal on its way through an action server, and the outcome by its ROS status."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from pnm.core.machine.requests import Ended, Outcome, OutcomeKind, Postponed, Report, Request
from pnm.ros.action_client.liveness import Liveness

# action_msgs/msg/GoalStatus
UNKNOWN: Final = 0
OVER: Final = {4: OutcomeKind.SUCCEEDED, 5: OutcomeKind.CANCELED, 6: OutcomeKind.ABORTED}

_MESSAGES: Final = ("message", "error_msg", "error_string")
"""Result fields for an error text: ours, Nav2's, MoveIt's and ros2_control's."""


@dataclass(eq=False)
class Goal:
    """A request and its progress. Every field after the first five changes, on the ROS thread only."""

    request: Request
    accept: float
    """Seconds the server may take to answer the goal before it is cancelled."""
    report: Callable[[Report], None]
    mapped: Mapping[str, object] | None = None
    """The fields that the binding names, if it has a goal mapping."""
    is_blind: bool = False
    """Whether its values were collected before its type was known: for all fields that it may have."""
    sent: float = 0.0
    """When it was sent, or when the server answered an earlier goal since then: until then this one could not be answered."""
    postponed: float = 0.0
    """When its run was told last that it waits for others."""
    handle: Any = None
    liveness: Liveness = field(default_factory=lambda: Liveness(frozenset()))
    cancel_asked: bool = False
    cancel_sent: float | None = None
    cancel_answered: bool = False
    results: list[Any] = field(default_factory=list)
    """The futures of the requests for the result."""
    unknown_since: float | None = None
    """When the server answered first that it does not know the goal: it was restarted, or has not taken it up yet."""
    refused: str = ""
    """Why it is cancelled though nobody has asked for that."""
    ended: bool = False

    def postpone(self, now: float) -> None:
        """Report that the limit for its acceptance begins anew."""
        self.postponed = now
        self.report(Postponed(self.request.id))

    def end(self, kind: OutcomeKind, message: str = "", result: Mapping[str, object] | None = None) -> None:
        """Report the end, once."""
        if not self.ended:
            self.ended = True
            self.report(Ended(self.request.id, Outcome(kind, result or {}, message)))

    def unfilled(self, known: tuple[str, ...]) -> tuple[str, ...]:
        """Return the fields of the type for which no value was collected, because the type was not known."""
        return tuple(name for name in known if name not in self.request.goal) if self.is_blind and self.mapped is None else ()

    def data(self, known: tuple[str, ...]) -> dict[str, object]:
        """Return the values of the goal message, given the fields of its type."""
        wanted = {*known, *(self.mapped or ())}
        return {name: value for name, value in self.request.goal.items() if not self.is_blind or name in wanted}

    @property
    def over(self) -> bool:
        """Whether the status topic says that the goal is over."""
        return self.handle is not None and self.handle.status in OVER

    @property
    def wants_cancel(self) -> bool:
        """Whether a cancellation was requested that the server has not answered."""
        return self.cancel_asked and not self.cancel_answered


def message_in(result: Mapping[str, object]) -> str:
    """Return the error text of a result, if it has one of the usual fields."""
    texts = (result.get(name) for name in _MESSAGES)
    return next((text for text in texts if isinstance(text, str) and text), "")
