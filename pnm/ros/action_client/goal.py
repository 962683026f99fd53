"""One goal on its way through an action server: the outcome by its ROS status, the liveness of its server, its feedback on one line."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum
from math import inf
from typing import Any, Final

from pnm.core.machine.bindings import Binding, Foreign, WhenLost
from pnm.core.machine.requests import Ended, Feedback, Outcome, OutcomeKind, Postponed, Report, Request
from pnm.ros.node.messages import fields, plain

# action_msgs/msg/GoalStatus
UNKNOWN: Final = 0
OVER: Final = {4: OutcomeKind.SUCCEEDED, 5: OutcomeKind.CANCELED, 6: OutcomeKind.ABORTED}
_MESSAGES: Final = ("message", "error_msg", "error_string")
"""Result fields for an error text: ours, Nav2's, MoveIt's and ros2_control's."""


class Kept(Enum):
    """The progress of a goal in another process."""

    ACCEPTED = "accepted"
    UNANSWERED = "unanswered"
    """It may not even have been sent."""


@dataclass(eq=False)
class Goal:
    """A request and its progress. What has a default changes, on the ROS thread only, but for `foreign`, `timeout` and `is_blind`."""

    request: Request
    binding: Binding
    """Of its action; fitted to the server's type before it is sent."""
    report: Callable[[Report], None]
    kept: Kept | None = None
    """Its progress in another process: it is asked for, instead of being sent."""
    foreign: Foreign = Foreign.SHARE
    """The treatment of its server while that works on goals of other programs."""
    timeout: float = inf
    """Seconds that the action may take, and that it waits for goals of other programs."""
    is_blind: bool = False
    """Whether its values were collected before its type was known: for all fields that it may have."""
    sent: float = 0.0
    """The time of its sending, or of the server's answer to an earlier goal since then: until then this one could not be answered."""
    postponed: float = 0.0
    """The beginning of the limit for its acceptance, as its run knows it."""
    is_accepted: bool = False
    status: int = UNKNOWN
    """The last entry of the status topic about it."""
    liveness: Liveness = field(default_factory=lambda: Liveness(frozenset()))
    cancel_asked: bool = False
    cancel_sent: float | None = None
    cancel_answered: bool = False
    results_asked: int = 0
    """Requests for the result without an answer."""
    unknown_since: float | None = None
    """The time of the server's first answer that it does not know the goal: it was restarted, or has not taken it up yet."""
    is_resent: bool = False
    """Whether it was sent once more, because its server did not know it."""
    refused: str = ""
    """Why it is cancelled though nobody has asked for that."""
    waits_since: float | None = None
    """Since when it waits for the server to be done with goals of other programs."""
    ended: bool = False
    feedback: Any = None
    """The latest message about it that was not reported yet."""

    def report_feedback(self) -> None:
        """Report the feedback that has come since the last report, if there is some."""
        if self.feedback is not None:
            self.report(Feedback(self.request.id, feedback_line(self.feedback)))
            self.feedback = None

    def postpone(self, now: float, lag: float) -> None:
        """Report that the limit for its acceptance begins anew, unless it began `lag` seconds ago at most."""
        if now - self.postponed > lag:
            self.postponed = now
            self.report(Postponed(self.request.id))

    def finish(self, status: int, result: Mapping[str, object]) -> None:
        """Report the end that its server has reported, as the binding judges it."""
        if self.refused and OVER[status] is OutcomeKind.CANCELED:
            self.end(OutcomeKind.UNAVAILABLE, self.refused)
            return
        texts = (text for name in _MESSAGES if isinstance(text := result.get(name), str) and text)
        outcome = self.binding.judged(Outcome(OVER[status], result, next(texts, "")))
        self.end(outcome.kind, outcome.message, result, outcome.declared)

    def end(self, kind: OutcomeKind, message: str = "", result: Mapping[str, object] | None = None, declared: str = "") -> None:
        """Report the end, once."""
        if not self.ended:
            self.ended = True
            self.report(Ended(self.request.id, Outcome(kind, result or {}, message, declared)))

    def unfilled(self, known: tuple[str, ...]) -> tuple[str, ...]:
        """Return the fields of the type for which no value was collected, because the type was not known."""
        return tuple(name for name in known if name not in self.request.goal) if self.is_blind and self.binding.goal is None else ()

    def data(self, known: tuple[str, ...]) -> dict[str, object]:
        """Return the values of the goal message, given the fields of its type."""
        wanted = {*known, *(self.binding.goal or ())}
        return {name: value for name, value in self.request.goal.items() if not self.is_blind or name in wanted}

    @property
    def may_be_resent(self) -> bool:
        """Whether it is sent to a server that does not know it: nobody can have begun it, or to begin it twice does no harm."""
        return self.kept is Kept.UNANSWERED or (self.binding.when_lost is WhenLost.RESEND and not self.is_resent)


# --- the liveness of its server ------------------------------------------------------------
# When the goal is lost, and when its result must be requested again.
#
# A server that dies sends nothing. But every server process publishes the status of its goals under a GID of its own, which
# the ROS graph shows:
#
# - The process is *gone* from the graph: at once after an orderly shutdown, after its lease (20 s) when it is killed
#   or cut off. The goal is lost a moment later, unless the same process comes back.
# - *Another* process appeared under the name: for the rest of the lease, a restart looks like this. The result is requested
#   again: the new process answers that it knows no such goal. If it says on the status topic that it is at work on the goal,
#   it goes on with what the other has accepted: both may have it from then on, see `pnm.ros.action_client.server_link`.
# - The status topic says that the goal is *over*, but no result has arrived: it is requested again.
#
# A server that is too busy to answer is never taken for dead, because none of the three is a question to it.
# Nothing here does I/O or reads a clock.

GRACE: Final = 3.0
"""Seconds for which a process may be missing from the graph before its goals are lost."""
AGAIN: Final = 1.0
"""Seconds between two requests for the same result."""
ASKS: Final = 5
"""Requests for the same result; a server keeps each one until it answers."""
PATIENT_ASKS: Final = 20
"""Those to a server that may be missing for longer than others, such as a node that takes up a journal on a busy machine."""


class Verdict(Enum):
    """The treatment of a goal."""

    FINE = "nothing"
    ASK = "ask for the result"
    LOST = "the server went away"
    SILENT = "the goal is over but there is no result"


@dataclass
class Liveness:
    """Observations about the server of one goal. All fields change."""

    processes: frozenset[bytes]
    """The server's processes when the goal was accepted, by GID."""
    gone_since: float | None = None
    over_since: float | None = None
    asked: float = -inf
    asks: int = 0
    seen: frozenset[bytes] = frozenset()
    """The processes that were present at the last look."""
    grace: float = GRACE
    """Seconds for which all of them may be missing from the graph."""

    def check(self, present: frozenset[bytes], over: bool, now: float) -> Verdict:
        """Return the verdict, given the present processes and whether the status topic says that the goal is over."""
        if present - self.seen:  # a process that has not been asked: the one that was may have died before it could answer
            self.asks = 0
        self.seen = present
        if not self.processes:  # the publisher was not discovered yet when the goal was accepted
            self.processes = present
        if not present & self.processes:  # none of the processes that may have the goal is left; another one under the name does not count
            if self.gone_since is None:
                self.gone_since = now
            if now - self.gone_since >= self.grace:  # a process may be missing from the graph for a moment while discovery is busy
                return Verdict.LOST
            return self._ask(now) if present else Verdict.FINE
        # It is back: an answer may have been lost meanwhile, so the result is requested again, with all attempts.
        if self.gone_since is not None:
            self.gone_since, self.asks = None, 0
            return self._ask(now)
        if over:
            if self.over_since is None:
                self.over_since, self.asks = now, 0
            if now - self.over_since < AGAIN:  # the result most often arrives right after the status; it is given a moment
                return Verdict.FINE
            if self.asks >= ASKS and now - self.asked >= AGAIN:
                return Verdict.SILENT
            return self._ask(now)
        return self._ask(now) if present - self.processes else Verdict.FINE

    @property
    def has_asked(self) -> bool:
        """Whether that is often enough: what may be missing for longer may also take longer until it says which goals it has."""
        return self.asks >= (ASKS if self.grace <= GRACE else PATIENT_ASKS)

    def _ask(self, now: float) -> Verdict:
        if self.has_asked or now - self.asked < AGAIN:
            return Verdict.FINE
        self.asked, self.asks = now, self.asks + 1
        return Verdict.ASK


# --- feedback on one line ------------------------------------------------------------------
# Its numbers and texts by the names of their fields, the outer fields first.

LENGTH: Final = 160
"""Characters of a line."""
ITEMS: Final = 5
"""Numbers or texts of a list that are written; of a longer list, and of one of messages, only how many there are."""
_TIME: Final = ("sec", "nanosec")
"""The fields of a time or a duration."""


def feedback_line(message: Any) -> str:
    """Return the fields that somebody filled in, but for headers and empty texts, as "distance_remaining 1.2, recoveries 0"."""
    line = ""
    for part in readable_fields(message):
        longer = f"{line}, {part}" if line else part
        if len(longer) > LENGTH:
            return f"{line}, …" if line else f"{part[: LENGTH - 1]}…"
        line = longer
    return line


def readable_fields(message: Any) -> Iterator[str]:
    """Yield the fields with their names, level by level; those of nested messages with the names of both."""
    level = [("", message)]
    while level:
        deeper: list[tuple[str, Any]] = []
        for path, outer in level:
            for name in fields(outer):
                value = getattr(outer, name)
                if name == "header":
                    continue
                if _is_message(value) and fields(value) != _TIME:
                    if value != type(value)():  # the pose of a server that fills in only the distance
                        deeper.append((f"{path}{name}.", value))
                elif text := _text(value):
                    yield f"{path}{name} {text}"
        level = deeper


def _is_message(value: Any) -> bool:
    return hasattr(value, "get_fields_and_field_types")


def _text(value: Any) -> str:
    """Return a value in a few characters; empty when there is nothing to say."""
    match value:
        case bool():
            return str(value).lower()
        case int():
            return str(value)
        case float():
            return f"{round(value, 3):g}"
        case str():
            return " ".join(value.split())
        case bytes():
            return str(plain(value))
        case _ if _is_message(value):
            return f"{round(value.sec + value.nanosec * 1e-9, 1):g} s"
    if len(value) > ITEMS or (len(value) and _is_message(value[0])):
        return f"{len(value)} items"
    items = plain(value)
    return f"[{', '.join(map(_text, items))}]" if isinstance(items, list) and items else ""
