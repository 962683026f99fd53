"""Requests to action servers and their reports: the protocol between executor and action clients.

A *request* is one dispatch of a call to an action server, with a UUID chosen by us. It is
answered by reports: at most one `Accepted`, then exactly one `Ended` with an `Outcome`. (An
`Accepted` may be left out before an end that implies it, any number of `Postponed` may come
before it, and of `Feedback` after it.) A client that cannot keep that promise is still safe: the run gives every request a limit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum, StrEnum
from hashlib import sha1
from typing import Final, Protocol, TypeAlias, runtime_checkable
from uuid import UUID

from pnm.core.machine.plan_graph import GroundAction

_FREE: Final = (1 << 96) - 1 & ~(0xF000 << 64 | 0xC000 << 48)
"""The bits of an identity that tell neither its run nor how it was made."""
_VERSION_5: Final = 5 << 76 | 0x8000 << 48


def identities(run: UUID) -> Callable[[str], UUID]:
    """Return the maker of the identities of a run's requests and questions.

    They follow from the identity of the run and what they are for; the first four bytes are the run's, to be found by.
    """
    beginning, prefix = sha1(run.bytes), run.int >> 96 << 96 | _VERSION_5

    def identity(what: str) -> UUID:
        hashed = beginning.copy()
        hashed.update(what.encode())
        return UUID(int=prefix | int.from_bytes(hashed.digest()[4:16]) & _FREE)

    return identity


class TransitionAction(Enum):
    """Action of a transition: what its firing does about the request or the assumed effects of its call."""

    SEND = "send the request"
    ADOPT = "take over the request that another run has sent"
    CANCEL = "ask for the request to be cancelled"
    BEGIN = "write the assumed start effects"
    FINISH = "write the assumed end effects"
    UNDO = "take the assumed start effects back"

    __hash__ = object.__hash__  # each is there once; shapes of blocks are hashed for every call


class OutcomeKind(Enum):
    """Kind of end of a request."""

    SUCCEEDED = "succeeded"
    ABORTED = "aborted"
    ABORTED_FOR_GOOD = "aborted_for_good"
    """For a reason that another attempt would meet again; see `Binding.final`."""
    CANCELED = "canceled"
    REJECTED = "rejected"
    TIMED_OUT = "timed_out"
    UNAVAILABLE = "unavailable"
    """No server was there, although it was waited for; or it went away before it answered."""
    LOST = "lost"
    """The server went away after it had accepted."""

    __hash__ = object.__hash__  # each is there once; what an end opens is looked up by its kind


BEFORE_ACCEPTANCE: Final = frozenset({OutcomeKind.REJECTED, OutcomeKind.UNAVAILABLE, OutcomeKind.LOST})
"""Ends that do not tell whether the goal was accepted before; any other implies that it was."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome of a request: the kind of its end, the fields of the result by name, and a message."""

    kind: OutcomeKind
    result: Mapping[str, object] = field(default_factory=dict)
    message: str = ""
    declared: str = ""
    """The name of the declared outcome of its action that the result tells; empty if it tells none."""


NOT_REATTACHED: Final = Outcome(OutcomeKind.LOST, message="its server cannot be asked for the result")
"""Outcome of a request that another process has sent, with a client that finds out nothing about such requests."""


@dataclass(frozen=True, slots=True)
class Request:
    """One dispatch of a call to an action server."""

    id: UUID
    action: GroundAction
    goal: Mapping[str, object]
    """Values for the fields of the goal message, by name; nested fields as mappings."""
    attempt: int = 1


@dataclass(frozen=True, slots=True)
class Accepted:
    """The server has taken the goal on; the action's clock starts."""

    request: UUID


@dataclass(frozen=True, slots=True)
class Ended:
    """The request is over."""

    request: UUID
    outcome: Outcome


@dataclass(frozen=True, slots=True)
class Postponed:
    """The goal waits until its server has answered others, or has waited until now: the limit for its acceptance begins anew."""

    request: UUID


@dataclass(frozen=True, slots=True)
class Feedback:
    """The feedback of the server about the goal, on one line; a few times a second at most."""

    request: UUID
    text: str


Report: TypeAlias = Accepted | Ended | Postponed | Feedback
Reporter: TypeAlias = Callable[[Report], None]


@runtime_checkable
class ActionClient(Protocol):
    """Carries out actions. Every method is called on the event loop's thread and returns at once."""

    def goal_fields(self, action: GroundAction, /) -> tuple[str, ...] | None:
        """Return the names of the fields a goal must have, or None when nothing is known about them."""

    def send(self, request: Request, report: Reporter, /) -> None:
        """Send the goal; `report` is then called on the event loop's thread, never from within `send`."""

    def cancel(self, request: UUID, /) -> None:
        """Ask for the request to be cancelled; its `Ended` says whether it was. Unknown ids are ignored."""


@runtime_checkable
class ReattachingClient(ActionClient, Protocol):
    """An action client that finds out about requests that another process has sent."""

    def reattach(self, request: Request, report: Reporter, /, *, accepted: bool) -> None:
        """Report on the request as if it were sent now; reports may repeat.

        If its server does not know it, it is sent, unless it was `accepted` before: then it is `LOST`.
        """


class CallOutcome(StrEnum):
    """Outcome of a call, so far or for good."""

    WAITING = "waiting"
    RUNNING = "running"
    """Its request is out."""
    SUSPENDED = "suspended"
    """Between two attempts: its last request has failed, or was cancelled for a pause, and the next one is not out yet."""
    HANDED_OVER = "handed over"
    """Another run goes on with its request."""
    SUCCEEDED = "succeeded"
    ALREADY_TRUE = "already true"
    """Not sent: its effects held."""
    SKIPPED = "skipped"
    """Not sent: the run came to its end before."""
    CANCELED = "canceled"
    UNCONFIRMED = "canceled, unconfirmed"
    """Cancelled, but its server has not confirmed that it stopped."""
    PASSED_OVER = "passed over"
    """Not successful, and the plan goes on all the same."""
    FAILED = "failed"
