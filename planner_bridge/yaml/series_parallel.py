"""Partial orders taken apart: into blocks that follow each other or lie beside each other, as far as they go.

An order is series-parallel if four of its elements never form an N. What is not so is left as a `Mesh`: its
elements, each with those that come directly before it. Sets of elements are integers with one bit for each.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias


@dataclass(frozen=True, slots=True)
class Series:
    """One after the other."""

    parts: tuple[Block, ...]


@dataclass(frozen=True, slots=True)
class Parallel:
    """In no order."""

    parts: tuple[Block, ...]


@dataclass(frozen=True, slots=True)
class Mesh:
    """In an order that is not series-parallel."""

    before: Mapping[int, tuple[int, ...]]
    """For every element, in an order that fits, those directly before it."""


Block: TypeAlias = int | Series | Parallel | Mesh


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


def blocks(before: Sequence[tuple[int, ...]]) -> Block:
    """Take apart a transitively reduced order of at least one element."""
    earlier = closure(before)
    related = list(earlier)
    for number, ancestors in enumerate(earlier):
        for element in _members(ancestors):
            related[element] |= 1 << number
    return _block((1 << len(before)) - 1, before, earlier, related)


def _block(members: int, before: Sequence[tuple[int, ...]], earlier: Sequence[int], related: Sequence[int]) -> Block:
    if members.bit_count() == 1:
        return members.bit_length() - 1
    beside = _components(members, related)
    if len(beside) > 1:
        return Parallel(tuple([_block(part, before, earlier, related) for part in beside]))
    chained = _components(members, [~neighbours for neighbours in related])
    if len(chained) > 1:
        chained.sort(key=lambda part: (earlier[_lowest(part)] & members & ~part).bit_count())
        return Series(tuple([_block(part, before, earlier, related) for part in chained]))
    return Mesh({element: tuple(other for other in before[element] if members >> other & 1) for element in _members(members)})


def _components(members: int, neighbours: Sequence[int]) -> list[int]:
    """Return the parts of a set that no neighbours connect, by their lowest members."""
    parts: list[int] = []
    left = members
    while left:
        part = frontier = 1 << _lowest(left)
        while frontier:
            reached = 0
            for element in _members(frontier):
                reached |= neighbours[element]
            frontier = reached & left & ~part
            part |= frontier
        parts.append(part)
        left &= ~part
    return parts


def _lowest(members: int) -> int:
    return (members & -members).bit_length() - 1


def _members(members: int) -> Iterator[int]:
    while members:
        lowest = _lowest(members)
        yield lowest
        members ^= 1 << lowest
