"""Σ and its answer: the events that a run handles, and the commands that it returns.

A run handles *events* (reports about requests besides) and returns *commands*. All times
are seconds on the clock of its caller.

Who listens to a run: one empty method per moment. Progress, traces and journals are observers.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Final, NamedTuple, TypeAlias, TypeVar, cast
from uuid import UUID

from pnm.core.execution.call_results import Explanation, Failure
from pnm.core.logic.computed_values import Question
from pnm.core.machine.guards import Rule
from pnm.core.machine.machine import MachineBlocks
from pnm.core.machine.plan_graph import ActionCall
from pnm.core.machine.requests import Ended, Outcome, OutcomeKind, Report, Request


@dataclass(frozen=True, slots=True)
class Begin:
    """Start the run."""


@dataclass(frozen=True, slots=True)
class Restarted:
    """Go on in another process: what was out when the last one died is asked for again, by the same identities."""


@dataclass(frozen=True, slots=True)
class KnowledgeChanged:
    """Facts have changed; conditions that were waiting are asked again."""


@dataclass(frozen=True, slots=True)
class ResourcesChanged:
    """A claim in line may be granted now; calls that wait for resources ask again."""


@dataclass(frozen=True, slots=True)
class Tick:
    """The moment of a `Wake` has come."""


@dataclass(frozen=True, slots=True)
class Stop:
    """End the run: start nothing more; cancel what runs, or let it end by itself."""

    cancel: bool = True
    reason: str = "cancelled"


@dataclass(frozen=True, slots=True)
class Pause:
    """Start nothing more until `Resume`; let what runs come to its end, or have it cancelled and begin anew later."""

    at_once: bool = False


@dataclass(frozen=True, slots=True)
class Resume:
    """Go on after a pause."""


@dataclass(frozen=True, slots=True)
class InHands:
    """People have these robots, or other objects or resources, in their hands, and no others.

    Calls that need one begin nothing; those that run are cancelled, to begin anew later. All other calls go on.
    """

    names: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class SingleStep:
    """Let one call send its request during a pause, if one can now; the pause goes on, and does not cancel it."""


@dataclass(frozen=True, slots=True)
class Answered:
    """Answer to the question of an `Ask`; `MISSING` if there is none, or none in time."""

    id: UUID
    value: object
    message: str = ""
    """Why there is no value, when there is none."""


@dataclass(frozen=True, slots=True)
class Settled:
    """A person says how a request ends: it is cancelled, and ends in this way once its server is done with it.

    Until then its robot is at work, and keeps what it has.
    """

    request: UUID
    kind: OutcomeKind

    def end(self, report: Ended) -> Ended:
        """Return the end of the request, with the words of its server; with its result only if that is one."""
        heard = report.outcome
        result = heard.result if heard.kind is OutcomeKind.SUCCEEDED else {}  # of a goal that was cancelled it is what fields begin with
        how = "is done" if self.kind is OutcomeKind.SUCCEEDED else "has failed"
        said = f"a person says that it {how}; its server said: {heard.kind.value}"
        return Ended(self.request, Outcome(self.kind, result, f"{said}, {heard.message}" if heard.message else said))


Event: TypeAlias = (
    Begin
    | Restarted
    | KnowledgeChanged
    | ResourcesChanged
    | Tick
    | Stop
    | Pause
    | Resume
    | InHands
    | SingleStep
    | Answered
    | Settled
    | Report
)


@dataclass(frozen=True, slots=True)
class Send:
    """Send the request."""

    request: Request


@dataclass(frozen=True, slots=True)
class Reattach:
    """Find out what has become of a request that another process has sent, or was about to send; reports follow as if it were sent now.

    One that was not accepted is sent if its server does not know it: it was not sent, or got lost.
    """

    request: Request
    accepted: bool


@dataclass(frozen=True, slots=True)
class Cancel:
    """Ask for the request to be cancelled."""

    request: UUID


@dataclass(frozen=True, slots=True)
class Wake:
    """Call back with a `Tick` at this time; replaces an earlier `Wake`."""

    at: float


@dataclass(frozen=True, slots=True)
class Ask:
    """Ask the question outside of the run; exactly one `Answered` follows."""

    id: UUID
    question: Question


@dataclass(frozen=True, slots=True)
class Withdraw:
    """The answer to the question is no longer needed."""

    id: UUID


@dataclass(frozen=True, slots=True)
class Store:
    """Store the value outside of the run; one `Ended` follows, as for a request that was sent."""

    id: UUID
    question: Question
    """Name and layer determine where the value is stored; the meta data go with it."""
    value: object


Command: TypeAlias = Send | Reattach | Cancel | Wake | Ask | Withdraw | Store


class Performed(NamedTuple):
    """The consequences of a transition's action: commands, ends of requests about knowledge alone, and whether knowledge changed."""

    commands: tuple[Command, ...] = ()
    reports: tuple[Ended, ...] = ()
    changes_knowledge: bool = False


class Fired(NamedTuple):
    """A transition that has fired. Its name and its rule are made for those who ask, who are few; so many fire."""

    net: MachineBlocks
    number: int
    kind: Rule
    """A rule of its kind: the step that it says it is about may be another, and so may be the guard."""

    @property
    def name(self) -> str:
        """The name of the transition."""
        return self.net.transition_name(self.number)

    @property
    def rule(self) -> Rule:
        """Its rule."""
        return self.net.rule(self.number)


class Observer:
    """Does nothing; override what is of interest. Must not raise and must not block. `now` is in seconds of the event loop."""

    def fired(self, fired: Fired, now: float) -> None:
        """Note that a transition has fired."""

    def sent(self, call: ActionCall, request: Request, now: float) -> None:
        """Note that a request is being sent."""

    def late(self, call: ActionCall, limit: float, now: float) -> None:
        """Note that a request has not ended within its limit, in seconds, and is being cancelled."""

    def ended(self, call: ActionCall, outcome: Outcome, now: float) -> None:
        """Note that a request is over."""

    def turned_out(self, call: ActionCall, outcome: str, now: float) -> None:
        """Note which of its declared outcomes a call has had: that is no failure."""

    def progressed(self, call: ActionCall, feedback: str, now: float) -> None:
        """Note new feedback of the server of a running call."""

    def hindered(self, call: ActionCall, cause: Explanation, now: float) -> None:
        """Note why a call does not go on as planned: it is tried again, recovers, or fails."""

    def spared(self, call: ActionCall, now: float) -> None:
        """Note that a call is not made, because its effects hold already."""

    def failed(self, failure: Failure, now: float) -> None:
        """Note that a failure place was marked."""

    def withheld(self, call: ActionCall, names: tuple[str, ...], now: float) -> None:
        """Note that a request was given up, and keeps these resources until its server reports the end."""

    def waiting(self, is_so: bool, now: float) -> None:
        """Note that nothing goes on before a person has answered, or that this is over."""

    def orphaned(self, report: Report, now: float) -> None:
        """Note a report that nothing waits for: late, repeated, or about an unknown request."""


SILENT: Final = Observer()
"""The observer of a run that nobody observes: what takes time to find out is not worked out for it."""


# --- broadcast ------------------------------------------------------------------------------------
# One listener that passes every moment on to several listeners.


L = TypeVar("L")


def broadcast(kind: type[L], listeners: Sequence[L]) -> L:
    """Return a listener that passes every moment on to all listeners, in their order.

    The moments are the public methods of the class, so that a new one is passed on as soon as it is there.

    Args:
        kind: the class of the listeners, with an empty method per moment.
        listeners: may change at any time, unless it is a tuple; those of the time at which a moment comes are called.
    """
    listener: L = _broadcaster(cast("Hashable", kind))()
    listener.__dict__["listeners"] = listeners
    if isinstance(listeners, tuple):  # a moment that one of them hears at most needs nobody who passes it on
        nobody = kind()
        for moment, empty in _moments(kind).items():
            heard = [hear for hear in (getattr(one, moment) for one in listeners) if getattr(hear, "__func__", None) is not empty]
            if len(heard) < 2:
                listener.__dict__[moment] = heard[0] if heard else empty.__get__(nobody)
    return listener


@cache
def _broadcaster(kind: Any) -> Any:
    return type(f"Broadcast{kind.__name__}", (kind,), {name: _passes_on(name, empty) for name, empty in _moments(kind).items()})


def _moments(kind: type) -> dict[str, Any]:
    """Return the empty methods of a class of listeners, by the names of their moments."""
    return {name: getattr(kind, name) for name in dir(kind) if not name.startswith("_")}


def _passes_on(moment: str, empty: object) -> Callable[..., None]:
    def pass_on(self: Any, *arguments: object, **options: object) -> None:
        for listener in tuple(self.listeners):
            hear = getattr(listener, moment)
            if getattr(hear, "__func__", None) is not empty:
                hear(*arguments, **options)

    return pass_on
