"""Faults of a simulation: failures of action servers, and changes of facts without an action; read from a file."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from random import Random
from typing import Literal

from pnm.core.knowledge_base import parse_statement
from pnm.core.logic.domain import Vocabulary
from pnm.core.logic.effects import Effects
from pnm.core.logic.expressions import Fluent, Value
from pnm.core.machine.plan_graph import GroundAction
from pnm.errors import InputError, Position, located
from pnm.files.yaml_nodes import Mapped, load_yaml


class FaultKind(Enum):
    """The way in which a server fails."""

    ABORT = "abort"
    REJECT = "reject"
    HANG = "hang"
    NO_EFFECT = "no_effect"
    """Succeeds, but the world stays as it was."""
    SLOW = "slow"
    """Takes ten times as long."""
    LOSE_SERVER = "lose_server"
    """Goes away half-way and does not come back."""


@dataclass(frozen=True, slots=True)
class Fault:
    """Requests of one action, or of one ground action, that fail, or that end in an outcome that is not left to chance."""

    what: str
    """An action's name, or a ground action such as ``move(r1, hall, kitchen)``."""
    kind: FaultKind | None = None
    """None for a declared outcome."""
    after: int = 0
    """The number of requests that succeed first."""
    times: int | None = None
    """The number of requests that then fail; None for all."""
    message: str = ""
    ignores_cancel: bool = False
    chance: float = 1.0
    """The probability that each of these fails."""
    seconds: float | None = None
    """Seconds of the world until its server tells the end; by default as the duration of the action has it."""
    for_good: bool = False
    """Whether an abort is for a reason that another attempt would meet again."""
    outcome: str = ""
    """The name of the declared outcome."""
    succeeded: Effects | None = None
    """The effects of a request that succeeds, in place of those of the action at its end."""
    failed: Effects = ()
    """The effects of a request that does not."""

    def concerns(self, action: GroundAction) -> bool:
        """Return whether the fault applies to this ground action."""
        return self.what in (action.name, str(action))


@dataclass(frozen=True, slots=True)
class HiddenChange:
    """Facts that change without any action: at a time, or at the start or end of a ground action."""

    changes: Mapping[Fluent, Value]
    at: float | None = None
    moment: Literal["start", "end"] | None = None
    what: str = ""

    def follows(self, moment: str, action: GroundAction) -> bool:
        """Return whether the change happens at this moment of this ground action."""
        return self.moment == moment and self.what in (action.name, str(action))


@dataclass(frozen=True, slots=True)
class Faults:
    """All faults and hidden changes of a simulation."""

    faults: tuple[Fault, ...] = ()
    changes: tuple[HiddenChange, ...] = ()
    seed: int = 0
    """Seed of the random numbers: with the same one the same requests fail, and end in the same outcomes."""
    drawn: Callable[[GroundAction, Random], Fault | None] | None = None
    """Draws the fault of each request, in place of those above."""


NO_FAULTS = Faults()
_NAME = re.compile(r"[^\s(),]+")
_MOMENT = re.compile(r"(start|end) of (.+)\Z")


def read_faults(path: Path, known: Vocabulary | None = None) -> Faults:
    """Read a faults file, its names checked against the known ones if given; raise `InputError` where something is wrong."""
    top = load_yaml(path)
    top.only("faults", "changes", "seed")
    faults = tuple([_fault(entry, known) for entry in top.sequence("faults")])
    return Faults(faults, tuple([_change(entry, known) for entry in top.sequence("changes")]), top.whole("seed", 0))


def ground_name(text: str) -> str:
    """Normalise ``move( r1,hall )`` or ``(move r1 hall)`` to ``move(r1, hall)``."""
    names = _NAME.findall(text)
    return f"{names[0]}({', '.join(names[1:])})" if names and ("(" in text) else text.strip()


def _call(what: str, position: Position, known: Vocabulary | None) -> str:
    """Return a call, its names spelled as they are declared."""
    if known is not None:
        what = _NAME.sub(lambda name: known.spelled(name[0]), what)
        known.check_call(what, position)
    return what


def _fault(entry: Mapped, known: Vocabulary | None) -> Fault:
    entry.only("action", "call", "do", "outcome", "after", "times", "message", "ignores_cancel", "chance")
    action, call, failure, outcome = (entry.string(key) for key in ("action", "call", "do", "outcome"))
    if (action is None) == (call is None):
        raise InputError("expected either 'action' or 'call'", entry.start)
    kinds = [kind.value for kind in FaultKind]
    if outcome is not None and failure is not None:
        raise InputError("expected either 'do' or 'outcome'", entry.start)
    if outcome is None and failure not in kinds:
        raise InputError(f"expected 'do' to be one of {', '.join(kinds)}; found {failure!r}", entry.position("do"))
    what = _call(action or ground_name(call or ""), entry.position("action" if action else "call"), known)
    if known is not None and outcome is not None:
        known.check_outcome(what.partition("(")[0], outcome, entry.position("outcome"))
    chance = entry.number("chance", 1.0)
    if chance > 1.0:
        raise InputError(f"expected a share from 0 to 1 as 'chance', found {chance:g}", entry.position("chance"))
    return Fault(
        what=what,
        kind=None if failure is None else FaultKind(failure),
        after=entry.whole("after", 0),
        times=entry.whole("times", None),
        message=entry.string("message") or "",
        ignores_cancel=entry.flag("ignores_cancel"),
        chance=chance,
        outcome=outcome or "",
    )


def _change(entry: Mapped, known: Vocabulary | None) -> HiddenChange:
    entry.only("at", "on", "set")
    at, on = entry.number("at", None), entry.string("on")
    if (at is None) == (on is None):
        raise InputError("expected either 'at' (seconds) or 'on' (start of CALL, end of CALL)", entry.start)
    with located(entry.position("set")):
        changes = dict(map(parse_statement, entry.strings("set")))
    match = _MOMENT.match(on or "")
    if on is not None and match is None:
        raise InputError(f"expected 'start of CALL' or 'end of CALL', found {on!r}", entry.position("on"))
    what = _call(ground_name(match[2]), entry.position("on"), known) if match else ""
    if known is not None:
        names = {tuple(map(known.spelled, fluent)): value for fluent, value in changes.items()}
        changes = {fluent: known.spelled(value) if isinstance(value, str) else value for fluent, value in names.items()}
        for fluent, value in changes.items():
            known.check_change(fluent, value, entry.position("set"))
    return HiddenChange(changes, at, None if match is None else "start" if match[1] == "start" else "end", what)
