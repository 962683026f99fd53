"""Numbers in policies: the values that a number may have, and facts which say that it is at least one of these.

What increases or decreases a number makes these facts true or false, each under the condition that another one holds. So a number is
carried back through actions as facts are: what is to be 20 after a drive that takes 10 has to be 30 before it.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from heapq import heappop, heappush
from math import inf, isfinite
from typing import Final, NamedTuple, TypeAlias

from pnm.core.logic.conditions import Compare
from pnm.core.logic.expressions import UNKNOWN, Constant, Fluent, State, Unknown, Value, ValueOf

Range: TypeAlias = tuple[float, float]
"""The least and the greatest value that a number may have."""
ANY_NUMBER: Final[Range] = -inf, inf
MOST_VALUES: Final = 128
"""Values that are told apart; of more, those between two count as the lesser."""
_DIGITS: Final = 9


@dataclass(frozen=True, slots=True)
class PartlyKnown:
    """A state of which these facts are known, and what never changes."""

    facts: Mapping[Fluent, Value | Unknown]
    constant: State
    changing: frozenset[str]

    def value(self, fluent: Fluent, /) -> Value | Unknown | None:
        """Return the value of a ground fluent."""
        if fluent[0] in self.changing:
            return self.facts.get(fluent, UNKNOWN)
        return self.constant.value(fluent)

    def objects(self, types: tuple[str, ...], /) -> tuple[str, ...]:
        """Return the objects of any of the types."""
        return self.constant.objects(types)


class AtLeast(NamedTuple):
    """The fact that a number has at least this value."""

    fluent: Fluent
    least: float

    def __str__(self) -> str:
        return str(Compare(">=", ValueOf(self.fluent), Constant(self.least)))


@dataclass(frozen=True)
class Scale:
    """The values of a number, the least first. Its facts are one after the other from a place on, none for the least value."""

    fluent: Fluent
    values: tuple[float, ...]
    ends: Range
    """The number never leaves it, which is still to be proved."""
    is_exact: bool
    """Whether these are all values; what follows for others is still to be proved, too."""
    first: int

    @cached_property
    def mask(self) -> int:
        """All its facts."""
        return self.up_to(len(self.values) - 1)

    @property
    def levels(self) -> list[AtLeast]:
        """All its facts, in the order of their places."""
        return [AtLeast(self.fluent, value) for value in self.values[1:]]

    def up_to(self, number: int) -> int:
        """Return the facts that are true of the value with this number."""
        return (1 << number) - 1 << self.first

    def bit(self, number: int) -> int:
        """Return the fact that it is at least the value with this number."""
        return 1 << self.first + number - 1 if 0 < number < len(self.values) else 0

    def value(self, state: int) -> float:
        """Return the value in a state."""
        return self.values[(state & self.mask).bit_count()]

    def runs(self, truths: Sequence[bool]) -> Iterator[tuple[int, int]]:
        """Yield the facts that are true, and those that are false, for every run of values of which something is so."""
        for number, is_so in enumerate(truths):
            if is_so and not (number and truths[number - 1]):
                yield self.bit(number), self.bit(next((end for end in range(number, len(truths)) if not truths[end]), 0))

    def range(self, true: int, false: int) -> tuple[int, int]:
        """Return the numbers of the least and the greatest value in states with these facts."""
        true, false = true & self.mask, false & self.mask
        top = (false & -false).bit_length() - self.first - 1 if false else len(self.values) - 1
        return true.bit_length() - self.first if true else 0, top

    def bounds(self, true: int, false: int) -> Range:
        """Return the least and the greatest value in states with these facts; infinite where it does not matter."""
        least, top = self.range(true, false)
        return self.values[least] if least else -inf, self.values[top] if top < len(self.values) - 1 else inf

    def facts(self, bounds: Range) -> tuple[int, int]:
        """Return the facts that are true, and those that are false, of all values in a range: what `bounds` has made one of."""
        return self.up_to(bisect_left(self.values[:-1], bounds[0])), self.mask & ~self.up_to(
            max(0, bisect_right(self.values, bounds[1]) - 1)
        )

    def changes(self, after: Sequence[float]) -> Iterator[tuple[tuple[int, int], int, int]]:
        """Yield how facts change with the value, if it is this one after each: true and false facts before, what becomes true and false."""
        for number in range(1, len(self.values)):
            enough = next((before for before, value in enumerate(after) if value >= self.values[number]), None)
            if enough is None:
                yield (0, 0), 0, self.bit(number)
            elif enough < number:
                yield (self.bit(enough), 0), self.bit(number), 0
            elif enough > number:
                yield (0, self.bit(enough)), 0, self.bit(number)


def values_from(first: float, after: Callable[[float], Iterable[float]], limits: Iterable[float]) -> tuple[tuple[float, ...], Range, bool]:
    """Return the values that may come after a first one, the least first, the range that they never leave, and whether they are all.

    Args:
        after: says which come after a value.
        limits: with which values are compared: where they only increase, all above the greatest are the same, and so with the least.
    """
    limits, seen = {*limits}, {first}
    for sign, limit in ((1, max(limits)), (-1, -min(limits))):
        found, waiting, is_one_way = {first}, [sign * first], True
        while waiting and len(found) <= MOST_VALUES:
            value = sign * heappop(waiting)
            new = {*after(value)}
            is_one_way &= all(sign * one >= sign * value for one in new)
            if is_one_way and sign * value > limit:
                values = tuple(sorted(one for one in found if sign * one <= sign * value))
                return values, (values[0], inf) if sign == 1 else (-inf, values[-1]), True
            for one in new - found:
                found.add(one)
                heappush(waiting, sign * one)
        if not waiting:
            values = tuple(sorted(found))
            return values, (values[0], values[-1]), True
        seen |= found
    known = {first} | {limit for limit in limits if isfinite(limit)}
    low, high = min(known), max(known | seen)
    known |= {round(low + (high - low) * number / MOST_VALUES, _DIGITS) for number in range(-1, MOST_VALUES + 1)}
    return tuple(sorted(known)), (-inf, high), False
