"""Faults of a simulation: failures of action servers, and changes of facts without an action; read from a file."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Literal

from pnm.core.knowledge_base import parse_statement
from pnm.core.logic.domain import Vocabulary
from pnm.core.logic.expressions import Fluent, Value
from pnm.core.machine.plan_graph import GroundAction
from pnm.errors import InputError
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
    """Requests of one action, or of one ground action, that fail."""

    what: str
    """An action's name, or a ground action such as ``move(r1, hall, kitchen)``."""
    kind: FaultKind
    after: int = 0
    """The number of requests that succeed first."""
    times: int | None = None
    """The number of requests that then fail; None for all."""
    message: str = ""
    ignores_cancel: bool = False
    chance: float = 1.0
    """The probability that each of these fails."""

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
    """Seed of the random numbers: with the same one the same requests fail."""


NO_FAULTS = Faults()
_MOMENT = re.compile(r"(start|end) of (.+)\Z")


def read_faults(path: Path, known: Vocabulary | None = None) -> Faults:
    """Read a faults file, its names checked against the known ones if given; raise `InputError` where something is wrong."""
    top = load_yaml(path)
    top.only("faults", "changes", "seed")
    faults = Faults(tuple(map(_fault, top.sequence("faults"))), tuple(map(_change, top.sequence("changes"))), top.whole("seed", 0))
    if known is not None:
        faults = _spelled(faults, known)
        for fault, entry in zip(faults.faults, top.sequence("faults"), strict=True):
            known.check_call(fault.what, entry.position("action" if "action" in entry.nodes else "call"))
        for change, entry in zip(faults.changes, top.sequence("changes"), strict=True):
            if change.what:
                known.check_call(change.what, entry.position("on"))
            for fluent, value in change.changes.items():
                known.check_change(fluent, value, entry.position("set"))
    return faults


def _spelled(faults: Faults, known: Vocabulary) -> Faults:
    """Return the faults with names spelled as they are declared."""

    def call(what: str) -> str:
        return re.sub(r"[^\s(),]+", lambda name: known.spelled(name[0]), what)

    def value(one: Value) -> Value:
        return known.spelled(one) if isinstance(one, str) else one

    return replace(
        faults,
        faults=tuple([replace(fault, what=call(fault.what)) for fault in faults.faults]),
        changes=tuple(
            replace(
                change,
                what=call(change.what),
                changes={tuple(map(known.spelled, fluent)): value(new) for fluent, new in change.changes.items()},
            )
            for change in faults.changes
        ),
    )


def ground_name(text: str) -> str:
    """Normalise ``move( r1,hall )`` or ``(move r1 hall)`` to ``move(r1, hall)``."""
    names = re.findall(r"[^\s(),]+", text)
    return f"{names[0]}({', '.join(names[1:])})" if names and ("(" in text) else text.strip()


def _fault(entry: Mapped) -> Fault:
    entry.only("action", "call", "do", "after", "times", "message", "ignores_cancel", "chance")
    action, call, failure = entry.string("action"), entry.string("call"), entry.string("do")
    if (action is None) == (call is None):
        raise InputError("expected either 'action' or 'call'", entry.start)
    kinds = [kind.value for kind in FaultKind]
    if failure not in kinds:
        raise InputError(f"expected 'do' to be one of {', '.join(kinds)}; found {failure!r}", entry.position("do"))
    chance = entry.number("chance", 1.0)
    if chance > 1.0:
        raise InputError(f"expected a share from 0 to 1 as 'chance', found {chance:g}", entry.position("chance"))
    return Fault(
        what=action or ground_name(call or ""),
        kind=FaultKind(failure),
        after=entry.whole("after", 0),
        times=entry.whole("times", None),
        message=entry.string("message") or "",
        ignores_cancel=entry.flag("ignores_cancel"),
        chance=chance,
    )


def _change(entry: Mapped) -> HiddenChange:
    entry.only("at", "on", "set")
    at, on = entry.number("at", None), entry.string("on")
    if (at is None) == (on is None):
        raise InputError("expected either 'at' (seconds) or 'on' (start of CALL, end of CALL)", entry.start)
    try:
        changes = dict(map(parse_statement, entry.strings("set")))
    except InputError as error:
        raise InputError(error.message, entry.position("set")) from error
    if on is None:
        return HiddenChange(changes, at=at)
    match = _MOMENT.match(on)
    if not match:
        raise InputError(f"expected 'start of CALL' or 'end of CALL', found {on!r}", entry.position("on"))
    return HiddenChange(changes, moment="start" if match[1] == "start" else "end", what=ground_name(match[2]))
