"""Exits of a place: which are open, and does one open in finite time, whatever the world answers?"""

from __future__ import annotations

from collections.abc import Collection

from pnm.core.machine.guards import (
    Ends,
    Guard,
    Moods,
    Opener,
)
from pnm.core.machine.requests import OutcomeKind
from pnm.core.machine.verification.part import Inside

_ANY = frozenset(OutcomeKind)


def is_open(guard: Guard | Inside, moods: Moods) -> bool | None:
    """Return whether the guard is open, closed, or either, depending on the world."""
    return guard.open_in(moods)


def asks_the_world(guard: Guard | Inside) -> bool:
    """Return whether the guard opens because of the world, of a request from outside, or of time."""
    return guard.opened_by is not Opener.TOKENS and guard.open_in(Moods()) is None


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
    # A condition and its complement: one of them opens, if perhaps only after the report delay.
    if any(guard.is_sure or guard.complement in guards for guard in guards):
        return ""
    for guard in guards:
        if guard.closed_for:
            return f"has no exit for when {guard.closed_for}"
    return "has no exit that is sure to open in finite time"
