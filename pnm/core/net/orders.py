"""Orders: of the places of a net in time, and of any graph."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from heapq import heapify, heappop, heappush
from itertools import count

from pnm.core.net.net import PetriNet


def topological_order(preceding: Sequence[Sequence[int]], rank: Callable[[int], float] | None = None) -> list[int]:
    """Return the numbers in an order in which each comes after all that precede it; those that precede each other are left out.

    Args:
        preceding: for every number, those that come before it, directly.
        rank: of those that may be next, that of the least rank comes first; without ranks that which may be next for the longest time,
            at first that which is mentioned first.
    """
    missing = [*map(len, preceding)]
    following: list[list[int]] = [[] for _ in preceding]
    first: dict[int, None] = {}
    for number, earlier in enumerate(preceding):
        for one in earlier:
            following[one].append(number)
            if not missing[one]:
                first[one] = None
        if not earlier:
            first[number] = None
    turns = count()
    rank = rank or (lambda _: next(turns))
    ready = [(rank(number), number) for number in first]
    heapify(ready)
    in_order: list[int] = []
    while ready:
        _, next_one = heappop(ready)
        in_order.append(next_one)
        for number in following[next_one]:
            missing[number] -= 1
            if not missing[number]:
                heappush(ready, (rank(number), number))
    return in_order


def reduced(size: int, edges: Iterable[tuple[int, int]]) -> list[tuple[int, ...]]:
    """Return, for elements numbered in an order that fits, those that come directly before each: the transitive reduction."""
    before: list[set[int]] = [set() for _ in range(size)]
    for first, second in edges:
        before[second].add(first)
    earlier = closure(before)
    return [tuple(sorted(element for element in own if not any(earlier[other] >> element & 1 for other in own))) for own in before]


def closure(before: Sequence[Iterable[int]]) -> list[int]:
    """Return, for elements numbered in an order that fits, the set of all that come before each."""
    earlier: list[int] = []
    for own in before:
        ancestors = 0
        for element in own:
            ancestors |= earlier[element] | 1 << element
        earlier.append(ancestors)
    return earlier


def places(bits: int) -> Iterator[int]:
    """Yield the places of the bits that are set, the lowest first: the elements of a set that is a number, as in `closure`."""
    while bits:
        low = bits & -bits
        yield low.bit_length() - 1
        bits ^= low


@dataclass(frozen=True, slots=True)
class TimeOrder:
    """Order of time of a net."""

    when: Mapping[str, int]
    """The position of every place: behind all from which tokens come to it, but for arcs that lead back; those aside come last."""
    back: frozenset[tuple[str, str]]
    """Transitions and places: the arcs between them that lead back. Without them there is no cycle."""


def time_order(net: PetriNet, begin: str, aside: Collection[str]) -> TimeOrder:
    """Return the order of time of a net whose token begins at a place.

    Places aside, such as counters and resources, order nothing: no token passes through them.
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
