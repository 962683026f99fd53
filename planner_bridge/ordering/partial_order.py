"""The partial order of a plan graph: which happenings come before which, in every order that the graph allows.

Timed changes have no place in a graph. A call comes after a change if it is released only then, and before one that is its deadline;
it starts before one that is its latest start.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Collection, Iterable, Iterator, Sequence
from math import inf
from typing import Final, Generic, NamedTuple, TypeAlias, TypeVar

from pnm.core.logic.effects import TimedChange
from pnm.core.machine.plan_graph import ActionCall, Moment, Ordering, PlanEvent, PlanGraphError
from pnm.core.net.net import topological_order

NEAR: Final = 1e-4
"""Times that differ by less are the same: planners separate events by 0.001."""

Happening: TypeAlias = PlanEvent | TimedChange | None
"""An event of a call, a timed change, or None: the initial state if it is the first happening, and the goal if it is the last."""

_Key: TypeAlias = PlanEvent | int
"""An event, or the position of a timed change among them."""


class PartialOrder:
    """The happenings of a plan, numbered in one order that its graph allows, as near to the planned times as there is one.

    The starts of calls that are under way belong to the initial state. What comes before what is searched for when it is asked: the
    orderings of a plan that follow from its causal links lead directly, or in few steps, from a writer to its readers and to the next.

    Args:
        timed: what changes by itself.
        due: before this the goal is not looked at.

    Raises:
        PlanGraphError: orderings and timed changes contradict each other.
    """

    def __init__(
        self, calls: Sequence[ActionCall], orderings: Iterable[Ordering], timed: Sequence[TimedChange] = (), due: float = 0.0
    ) -> None:
        self._calls = calls
        keys: list[PlanEvent | TimedChange] = [PlanEvent(call.index, moment) for call in calls for moment in (Moment.START, Moment.END)]
        planned = [*map(self._time_of_event, keys)]  # type: ignore[arg-type]
        self._makespan = max(planned, default=0.0)
        preceding: list[list[int]] = [[] for _ in (*keys, *timed)]
        for first, second in direct_orderings(calls, orderings, timed):
            preceding[_position(second, len(keys))].append(_position(first, len(keys)))
        begun = [2 * call.index for call in calls if call.under_way]
        for key in begun:
            planned[key] = -inf  # so that they come first
        keys += timed
        planned += [change.time for change in timed]
        in_order = topological_order(preceding, planned.__getitem__)[len(begun) :]
        if len(in_order) < len(preceding) - len(begun):
            raise PlanGraphError("the orderings of the plan and the times at which facts change contradict each other")
        self.happenings: tuple[Happening, ...] = (None, *[keys[key] for key in in_order], None)
        self._numbers = [0] * len(keys)
        for number, key in enumerate(in_order, 1):
            self._numbers[key] = number
        at_last = (number for key, number in zip(keys, self._numbers, strict=True) if isinstance(key, PlanEvent) or key.time <= due + NEAR)
        self._preceding: list[Collection[int]] = [
            (),
            *[[self._numbers[earlier] for earlier in preceding[key]] for key in in_order],
            frozenset(at_last),
        ]
        """For every happening, those that come directly before it."""
        self._changes = {number: change.time for number, change in enumerate(self.happenings) if isinstance(change, TimedChange)}

    def number(self, call: int, moment: Moment) -> int:
        """Return the number of an event; 0 for the start of a call that is under way."""
        return self._numbers[2 * call + (moment is Moment.END)]

    def time(self, happening: Happening) -> float:
        """Return the planned time of an event, the time of a change, or the planned end of everything."""
        match happening:
            case PlanEvent():
                return self._time_of_event(happening)
            case TimedChange(time):
                return time
            case None:
                return self._makespan

    def _time_of_event(self, event: PlanEvent) -> float:
        call = self._calls[event.call]
        return call.planned + (call.action.duration or 0.0 if event.moment is Moment.END else 0.0)

    def comes_before(self, first: int, second: int) -> bool:
        """Return whether the first comes before the second, or is the same, in every order."""
        if first == second or not first or first in self._preceding[second]:
            return True
        reached = {number for number in self._preceding[second] if number > first}
        new = reached
        while new:  # numbers rise along every ordering: what has a smaller one cannot come later
            new = {number for one in new for number in self._preceding[one] if number >= first} - reached
            if first in new:
                return True
            reached |= new
        return False

    def is_change(self, number: int) -> bool:
        """Return whether a happening is a timed change."""
        return number in self._changes

    def is_ahead(self, first: int, change: int) -> bool:
        """Return whether the change is one by itself, before which the first, an event, is planned for; or the initial state."""
        if change not in self._changes:
            return False
        happening = self.happenings[first]
        return not first or (isinstance(happening, PlanEvent) and self._time_of_event(happening) < self._changes[change] - NEAR)


def _position(key: _Key, events: int) -> int:
    return 2 * key.call + (key.moment is Moment.END) if isinstance(key, PlanEvent) else events + key


def direct_orderings(
    calls: Iterable[ActionCall], orderings: Iterable[Ordering], timed: Sequence[TimedChange]
) -> Iterator[tuple[_Key, _Key]]:
    """Yield which event, or timed change by its number, comes directly before which."""
    yield from ((number - 1, number) for number in range(1, len(timed)))
    for ordering in orderings:
        yield ordering.before, ordering.after
    for call in calls:
        start, end = PlanEvent(call.index, Moment.START), PlanEvent(call.index, Moment.END)
        yield start, end
        for number, change in enumerate(timed):
            if call.release and change.time <= call.release + NEAR and not call.under_way:
                yield number, start
            elif call.release and change.time <= call.release + (call.action.duration or 0.0) + NEAR:
                yield number, end
            elif call.deadline <= change.time + NEAR:
                yield end, number
            elif call.latest_start <= change.time + NEAR:
                yield start, number


# --- writers --------------------------------------------------------------------------------------
# The writers of a fluent: which of them may be the last before a happening, and which may come between two.
#
# They are kept in *runs*: each writer of a run comes before the next in every order. Of a run the last that comes before a happening
# stands for all that are earlier in it. The causal links of a plan order all of its writers of a fluent, so there is one run, whatever
# its length; only a timed change is a run of its own, because it may be taken to come after what is planned for before it.


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
