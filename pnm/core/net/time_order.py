"""Order of time of a net: which places come before which, and the arcs that lead back, such as those of a retry."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass

from pnm.core.net.net import PetriNet


@dataclass(frozen=True, slots=True)
class TimeOrder:
    """Order of time of a net."""

    when: Mapping[str, int]
    """The position of every place: behind all from which tokens come to it, but for arcs that lead back; those aside come last."""
    back: frozenset[tuple[str, str]]
    """Transitions and places: the arcs between them that lead back. Without them there is no cycle."""


def time_order(net: PetriNet, begin: str, aside: Collection[str]) -> TimeOrder:
    """Return the order of time of a net.

    Args:
        net: the net.
        begin: the place where its token begins.
        aside: places that no token passes through, such as counters and resources: they order nothing.
    """
    left: list[str] = []
    """Places and transitions that were left, last ones first: whatever a node leads to is left before it."""
    entered: set[str] = {begin}
    on_the_way: dict[str, Iterator[str]] = {begin: iter(net.postset(begin))}
    back: set[tuple[str, str]] = set()
    while on_the_way:
        node, following = next(reversed(on_the_way.items()))
        after = next(following, None)
        if after is None:
            left.append(node)
            del on_the_way[node]
        elif after in on_the_way:
            back.add((node, after))
        elif after not in entered and after not in aside:
            entered.add(after)
            on_the_way[after] = iter(net.postset(after))
    passed = (node for node in reversed(left) if node not in net.inputs)
    places = (*passed, *(place for place in net.places if place not in entered))
    return TimeOrder({place: position for position, place in enumerate(places)}, frozenset(back))
