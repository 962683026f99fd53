"""A goal for a plan: what comes in with it, what is noted about it while it goes on, and what goes out at its end."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from uuid import UUID

from pnm.actions.base import Outcome, Report, Request
from pnm.errors import InputError
from pnm.machine import Rule
from pnm.observer import Observer
from pnm.performing import Performance
from pnm.plan_graph import ActionCall
from pnm.results import Failure
from pnm.sources.base import SourceError
from pnm.sources.people import printable
from pnm.sources.values import read_value, write_value
from pnm.yaml_files import parse_value


@dataclass(frozen=True, slots=True)
class Ending:
    """How a goal ended: the fields of its result."""

    success: bool
    reason: str
    """A word for programs, as the interface lists them."""
    message: str
    results: Mapping[str, object] = field(default_factory=dict)

    def fields(self) -> dict[str, object]:
        """Return the fields of the result as a message has them; values that JSON cannot say are told of in its message."""
        written: dict[str, str] = {}
        unsaid = ""
        for name, value in self.results.items():
            try:
                written[name] = f"{write_value(name)}: {write_value(value)}"
            except SourceError as error:
                unsaid += f"; {name} is left out: {error}"
        results = f"{{{', '.join(written.values())}}}"
        return {"success": self.success, "reason": self.reason, "message": printable(self.message + unsaid), "results": results}


@dataclass(eq=False)
class ServedGoal:
    """A goal and what becomes of it; every field after the first three changes, on the event loop's thread only."""

    plan: str
    id: UUID
    parameters: str
    """As they came."""
    performance: Performance | None = None
    ended: int = 0
    """Calls that have ended."""
    restarts: int = 0
    is_cancelled: bool = False
    """Whether its client has asked for it to be cancelled."""


class Audience:
    """Hears of goals: one method per moment. Must not raise and must not block."""

    def began(self, goal: ServedGoal) -> Observer:
        """Note that the goal was accepted; return who is told what happens in its run."""
        return Observer()

    def ended(self, goal: ServedGoal, ending: Ending) -> None:
        """Note how the goal ended."""


class Progress(Observer):
    """Counts what feedback tells about a goal, has it told, and passes on what it hears."""

    def __init__(self, goal: ServedGoal, tell: Callable[[], None], observer: Observer) -> None:
        self._goal = goal
        self._tell = tell
        self._observer = observer

    def fired(self, transition: str, rule: Rule, now: float) -> None:
        """Count how often the plan is begun anew."""
        if rule.name == "begin_anew":
            self._goal.restarts += 1
            self._tell()
        self._observer.fired(transition, rule, now)

    def sent(self, call: ActionCall, request: Request, now: float) -> None:
        """Have it told that a call is under way."""
        self._tell()
        self._observer.sent(call, request, now)

    def ended(self, call: ActionCall, outcome: Outcome, now: float) -> None:
        """Count the calls that have ended."""
        self._goal.ended += 1
        self._tell()
        self._observer.ended(call, outcome, now)

    def failed(self, failure: Failure, now: float) -> None:
        """Pass it on."""
        self._observer.failed(failure, now)

    def orphaned(self, report: Report, now: float) -> None:
        """Pass it on."""
        self._observer.orphaned(report, now)


def read_parameters(text: str) -> dict[str, object]:
    """Read what a goal says about the parameters of its plan: a mapping as YAML or JSON, or nothing.

    Raises:
        InputError: it is something else.
    """
    try:
        found = read_value(text)  # JSON first: not all of it means the same in YAML, such as 1e3 and escaped emoji
    except SourceError:
        found = parse_value(text, "parameters") if text.strip() else {}
    if not isinstance(found, dict):
        raise InputError(f"expected a mapping such as {{shop: bakery}} as parameters, found {text.strip()[:40]!r}")
    return found
