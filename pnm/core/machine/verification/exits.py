"""Exits of a place: does one open in finite time, whatever the world answers?"""

from __future__ import annotations

from collections.abc import Collection
from math import isfinite

from pnm.core.machine.machine import After, ConditionFalse, ConditionTrue, Due, EffectsMissing, EffectsSeen, Ends, Guard
from pnm.core.machine.requests import OutcomeKind

_ANY = frozenset(OutcomeKind)


def missing_exit(guards: Collection[Guard]) -> str:
    """Return for which answer of the world none of these guards opens in finite time; empty when one always does."""
    # Ends first: a request that is out may end in any way, whatever other exits there are.
    outcomes = [guard.kinds for guard in guards if isinstance(guard, Ends)]
    if outcomes and (others := _ANY.difference(*outcomes)):
        return f"has no exit for {set(others)}"
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
