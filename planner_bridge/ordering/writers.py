"""The writers of a fluent: which of them may be the last before a happening, and which may come between two.

They are kept in *runs*: each writer of a run comes before the next in every order. Of a run the last that comes before a happening
stands for all that are earlier in it. The causal links of a plan order all of its writers of a fluent, so there is one run, whatever
its length; only a timed change is a run of its own, because it may be taken to come after what is planned for before it.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from typing import Generic, NamedTuple, TypeVar

from planner_bridge.ordering.partial_order import PartialOrder

T = TypeVar("T")


class Before(NamedTuple):
    """The writers of smaller numbers than a happening has, as far as they matter to it, by position."""

    last: list[int]
    """Of every run, the last that comes before it in every order."""
    loose: list[int]
    """Those that some order has after it."""


class Writers(Generic[T]):
    """The happenings that write a fluent, by number, and the value that each leaves; the initial state is the first of them.

    The mutable state is all of it: they are added.
    """

    __slots__ = ("_order", "_runs", "numbers", "values")

    def __init__(self, order: PartialOrder, initial: T) -> None:
        self._order = order
        self.numbers = [0]
        self.values = [initial]
        self._runs = [0]
        """The positions at which the runs begin."""

    def add(self, number: int, value: T) -> None:
        """Add a writer of a greater number than those before."""
        order, numbers = self._order, self.numbers
        if order.is_change(number) or order.is_change(numbers[-1]) or not order.comes_before(numbers[-1], number):
            self._runs.append(len(numbers))
        numbers.append(number)
        self.values.append(value)

    def before(self, number: int, *, itself: bool = False) -> Before:
        """Return the writers of smaller numbers, and, if so wanted, the happening itself, which then is before itself."""
        found = Before([], [])
        position = (bisect_right(self.numbers, number) if itself else bisect_left(self.numbers, number)) - 1
        while position >= 0:
            if self._order.comes_before(self.numbers[position], number):
                found.last.append(position)
                position = self._runs[bisect_right(self._runs, position) - 1]
            else:
                found.loose.append(position)
            position -= 1
        return found

    def not_after(self, number: int) -> list[int]:
        """Return the positions of those of greater numbers that some order has before it."""
        found, position = list[int](), bisect_right(self.numbers, number)
        while position < len(self.numbers):
            if self._order.comes_before(number, self.numbers[position]):
                run = bisect_right(self._runs, position)
                position = self._runs[run] if run < len(self._runs) else len(self.numbers)
            else:
                found.append(position)
                position += 1
        return found

    def between(self, first: int, last: int) -> list[int]:
        """Return the numbers of those that some order has after the first happening and before the last one."""
        inside = range(bisect_right(self.numbers, first), bisect_left(self.numbers, last))
        return [self.numbers[one] for one in (*self.before(first, itself=True).loose, *inside, *self.not_after(last))]
