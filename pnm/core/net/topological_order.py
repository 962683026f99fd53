"""Topological order: everything comes after all that precedes it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from heapq import heapify, heappop, heappush
from itertools import count


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
    rank = rank or _turns()
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


def _turns() -> Callable[[int], float]:
    turns = count()
    return lambda _: next(turns)
