"""When do two blocks behave alike? When they have the same shape, so that exploring one of them is enough."""

from __future__ import annotations

from math import isfinite

from pnm.core.logic.conditions import Condition
from pnm.core.machine.machine import After, ConditionFalse, ConditionTrue, ConditionUnknown, Due, Ends, Withheld
from pnm.core.machine.verification.exits import is_timed
from pnm.core.machine.verification.part import Part, Step


def shape_of(part: Part) -> object:
    """Return everything about a part but names, times and what its conditions say.

    Of every step it is what its guard depends on, and of every place its arcs and its roles. Places that have all of
    this in common always hold the same tokens, so one stands for all of them; only records and the final places, of which
    one must be marked and not two, are told apart.
    """
    conditions: list[Condition] = []
    guards = tuple(
        [(_kind(step, conditions), step.action, step.gives_up, step.finds_cause, step.counted and step.counted[1:]) for step in part.steps]
    )
    arcs: dict[str, list[tuple[int, int]]] = {place: [] for place in part.places}
    for number, step in enumerate(part.steps):
        for place, weight in step.inputs.items():
            arcs[place].append((number, -weight))
        for place, weight in step.outputs.items():
            arcs[place].append((number, weight))
    sets = (
        *(part.records, part.counters, part.failures, part.outputs, part.ends, part.finals),
        *(part.early, part.restarts, part.resources, part.alive, part.settling),
    )
    special = frozenset(part.initial).union(*sets, *part.supplies)
    places: set[object] = set()
    for number, (place, connected) in enumerate(arcs.items()):
        roles: object = None
        if place in special:
            memberships = tuple(place in members for members in (*part.supplies, *sets))
            # Records and finals keep their number, because tokens in two of them differ from two tokens in one.
            roles = part.initial.get(place, 0), memberships, number if place in part.records | part.finals else None
        places.add((tuple(connected), roles))
    return guards, len(part.supplies), frozenset(places), bool(part.finals), part.cancels, part.others_restart, part.repeats


def _kind(step: Step, conditions: list[Condition]) -> object:
    """Return what is proved of a guard: when it opens, as far as the world does not decide, and which conditions are the same."""
    match guard := step.guard:
        case ConditionTrue(condition) | ConditionFalse(condition) | ConditionUnknown(condition):
            if condition not in conditions:  # only whether two guards have the same condition matters: then exactly one of them opens
                conditions.append(condition)
            return type(guard), conditions.index(condition)
        case Ends():
            return Ends, guard.kinds
        case After():
            return After, is_timed(guard)
        case Due(_, since):
            return Due, is_timed(guard), all(place in step.inputs for place, _ in since)
        case Withheld(_, seconds):
            return Withheld, isfinite(seconds)
        case _:
            return type(guard)
