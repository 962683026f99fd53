"""The shape of a block: blocks of one shape behave alike, so that exploring one of them is enough."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import count

from pnm.core.logic.conditions import Condition
from pnm.core.machine.guards import Due, Guard
from pnm.core.machine.verification.part import Inside, Part
from pnm.core.net.net import Weights


def shape_of(part: Part) -> object:
    """Return everything about a part but names, times and what its conditions say.

    Of every step it is what its guard depends on, and of every place its arcs and its roles.
    """
    conditions: list[Condition] = []
    steps = tuple(
        [
            (
                _kind(step.guard, step.inputs, conditions),
                step.action,
                step.gives_up,
                step.outcome,
                step.finds_cause,
                step.settles,
                step.counted and step.counted[1:],
            )
            for step in part.steps
        ]
    )
    places = frozenset(_arcs_and_roles(part).values())
    owed = tuple([call is None for call in part.owed])
    return steps, len(part.supplies), places, bool(part.finals), part.cancels, part.others_restart, part.repeats, owed


def kinds_of(guards: Iterable[tuple[Guard, Weights]]) -> tuple[object, ...]:
    """Return all that is proved of some guards of a block, each given with what its transition takes."""
    conditions: list[Condition] = []
    return tuple([_kind(guard, inputs, conditions) for guard, inputs in guards])


def without_twins(part: Part) -> Part:
    """Return the part with one place for all that have the same arcs and roles: they always hold the same tokens."""
    kept: dict[object, str] = {}
    for place, alike in _arcs_and_roles(part).items():
        kept.setdefault(alike, place)
    if len(kept) == len(part.places):
        return part
    places = dict.fromkeys(kept.values())

    def of(arcs: Weights) -> Weights:
        return {place: weight for place, weight in arcs.items() if place in places}

    return replace(
        part,
        places=tuple(places),
        steps=tuple(step._replace(inputs=of(step.inputs), outputs=of(step.outputs)) for step in part.steps),
        initial=of(part.initial),
        supplies=tuple(tuple(place for place in together if place in places) for together in part.supplies),
        outputs=part.outputs & places.keys(),
        early=part.early & places.keys(),
        resources=part.resources & places.keys(),
    )


def _arcs_and_roles(part: Part) -> dict[str, object]:
    """Return for every place all that decides which tokens it holds, and what they mean.

    Only records and the final places, of which one must be marked and not two, are told apart.
    """
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
    numbered, numbers, places = part.records | part.finals, count(), dict[str, object]()
    for place, connected in arcs.items():
        roles: object = None
        if place in special:
            memberships = tuple(place in members for members in (*part.supplies, *sets))
            # Records and finals are numbered, because tokens in two of them differ from two tokens in one.
            roles = part.initial.get(place, 0), memberships, next(numbers) if place in numbered else None
        places[place] = (tuple(connected), roles)
    return places


def _kind(guard: Guard | Inside, inputs: Weights, conditions: list[Condition]) -> object:
    """Return the proved part of a guard: its opening, as far as the world does not decide, and which conditions are the same."""
    if (condition := guard.asks) is not None:
        if condition not in conditions:  # only whether two guards have the same condition matters: then exactly one of them opens
            conditions.append(condition)
        return guard.proved, conditions.index(condition)
    return (guard.proved, all(place in inputs for place, _ in guard.since)) if isinstance(guard, Due) else guard.proved
