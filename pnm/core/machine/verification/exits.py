"""Exits of a place: which are open, and does one open in finite time, whatever the world answers?"""

from __future__ import annotations

from collections.abc import Collection
from math import isfinite
from typing import NamedTuple

from pnm.core.machine.machine import (
    After,
    Always,
    CancelAsked,
    ConditionFalse,
    ConditionTrue,
    Due,
    EffectsMissing,
    EffectsSeen,
    Ending,
    Ends,
    Failing,
    Guard,
)
from pnm.core.machine.requests import OutcomeKind
from pnm.core.machine.verification.part import Inside

_ANY = frozenset(OutcomeKind)


class Moods(NamedTuple):
    """What opens guards besides tokens and the world: whether a run is failing, ending, and to cancel what is under way."""

    failing: bool = False
    ending: bool = False
    cancels: bool = False


def is_open(guard: Guard | Inside, moods: Moods) -> bool | None:
    """Return whether the guard is open, closed, or either, depending on the world."""
    match guard:
        case Always():
            return True
        case Ending():
            return moods.ending
        case Failing():
            return moods.failing
        case CancelAsked():
            return moods.cancels
        case _:
            return None


def asks_the_world(guard: Guard | Inside) -> bool:
    """Return whether the guard opens because of the world, of a request from outside, or of time."""
    return not isinstance(guard, Inside) and is_open(guard, Moods()) is None


def lacking_exit(guards: Collection[Guard | Inside], moods: Moods) -> str:
    """Return for which answer of the world none of the guards at a place opens; empty if one does, or the world is not asked."""
    asking = list(filter(asks_the_world, guards))
    return missing_exit(asking) if asking and not any(is_open(guard, moods) for guard in guards) else ""


def missing_exit(guards: Collection[Guard | Inside]) -> str:
    """Return for which answer of the world none of these guards opens in finite time; empty when one always does."""
    # Ends first: a request that is out may end in any way, whatever other exits there are.
    outcomes = [guard.kinds for guard in guards if isinstance(guard, Ends)]
    if outcomes and (others := _ANY.difference(*outcomes)):
        return f"has no exit for a request that has {'/'.join(sorted(kind.value for kind in others))}"
    for guard in guards:
        match guard:
            # A condition and its complement: one of them opens, if perhaps only after the report delay.
            case ConditionFalse(condition) if ConditionTrue(condition) in guards:
                return ""
            case EffectsMissing(call) if EffectsSeen(call) in guards:
                return ""
            case _ if is_timed(guard):
                return ""
            case _:
                pass
    for guard in guards:
        match guard:
            case ConditionTrue(condition):
                return f"has no exit for when {condition} does not hold"
            case ConditionFalse(condition):
                return f"has no exit for when {condition} holds"
            case EffectsSeen():
                return "has no exit for when the effects are not seen"
            case _:
                pass
    return "has no exit that is sure to open in finite time"


def is_timed(guard: object) -> bool:
    """Return whether the guard opens by itself, in finite time."""
    match guard:
        case After(seconds):
            return isfinite(seconds)
        case Due(seconds, since):
            return all(map(isfinite, (seconds, *(delay for _, delay in since))))
        case _:
            return False
