"""The partial order of a plan graph: which happenings come before which, in every order that the graph allows.

Timed changes have no place in a graph. A call comes after a change if it is released only then, and before one that is its deadline;
it starts before one that is its latest start.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from graphlib import CycleError, TopologicalSorter
from heapq import heappop, heappush
from typing import Final, TypeAlias

from pnm.core.logic.effects import TimedChange
from pnm.core.machine.plan_graph import Moment, PlanEvent, PlanGraph, PlanGraphError

NEAR: Final = 1e-4
"""Times that differ by less are the same: planners separate events by 0.001."""

Happening: TypeAlias = PlanEvent | TimedChange | None
"""An event of a call, a timed change, or None: the initial state if it is the first happening, and the goal if it is the last."""

_Key: TypeAlias = PlanEvent | int
"""An event, or the position of a timed change among them."""


class PartialOrder:
    """The happenings of a plan, numbered in one order that its graph allows, as near to the planned times as there is one.

    Sets of happenings are numbers whose bits say which belong to them. The starts of calls that are under way belong to the
    initial state.

    Raises:
        PlanGraphError: orderings and timed changes contradict each other.
    """

    def __init__(self, graph: PlanGraph, timed: Sequence[TimedChange]) -> None:
        self._graph = graph
        events = [PlanEvent(call.index, moment) for call in graph.calls for moment in Moment]
        begun = {event for event in events if event.moment is Moment.START and graph.calls[event.call].under_way}
        self._makespan = max(map(self.time, events), default=0.0)
        keys: dict[_Key, Happening] = {event: event for event in events if event not in begun} | dict(enumerate(timed))
        preceding: dict[_Key, list[_Key]] = {key: [] for key in keys}
        for first, second in direct_orderings(graph, timed):
            if first not in begun:
                preceding[second].append(first)
        in_order = in_planned_order(preceding, {key: self.time(happening) for key, happening in keys.items()})
        self.happenings: tuple[Happening, ...] = (None, *(keys[key] for key in in_order), None)
        numbers: dict[_Key, int] = {key: number for number, key in enumerate(in_order, 1)}
        self.number = dict.fromkeys(begun, 0) | {key: number for key, number in numbers.items() if isinstance(key, PlanEvent)}
        at_last = [numbers[key] for key in keys if isinstance(key, PlanEvent) or timed[key].time <= graph.due + NEAR]
        direct = [[], *([numbers[earlier] for earlier in preceding[key]] for key in in_order), at_last]
        self.before: list[int] = []
        """For every happening, those that come before it."""
        self.after = [0] * len(direct)
        """For every happening, those that come after it."""
        for number, directly_before in enumerate(direct):
            bits = 1 if number else 0
            for earlier in directly_before:
                bits |= self.before[earlier] | 1 << earlier
            self.before.append(bits)
        for number in range(len(direct) - 1, 0, -1):
            for earlier in (0, *direct[number]):
                self.after[earlier] |= self.after[number] | 1 << number
        self.ahead = {
            number: 1
            | sum(1 << event for event in self.number.values() if event and self.time(self.happenings[event]) < change.time - NEAR)
            for number, change in enumerate(self.happenings)
            if isinstance(change, TimedChange)
        }
        """For every timed change, the events that are planned for before it, and the initial state."""

    def time(self, happening: Happening) -> float:
        """Return the planned time of an event, the time of a change, or the planned end of everything."""
        match happening:
            case PlanEvent(index, moment):
                call = self._graph.calls[index]
                return call.planned + (call.action.duration or 0.0 if moment is Moment.END else 0.0)
            case TimedChange(time):
                return time
            case None:
                return self._makespan

    def comes_before(self, first: int, second: int) -> bool:
        """Return whether the first comes before the second, or is the same, in every order."""
        return first == second or bool(self.before[second] >> first & 1)


def in_planned_order(preceding: Mapping[_Key, Sequence[_Key]], times: Mapping[_Key, float]) -> list[_Key]:
    """Return the keys in an order in which each comes after all that precede it: of those that may be next always the earliest.

    Raises:
        PlanGraphError: some precede each other.
    """
    sorter = TopologicalSorter(preceding)
    try:
        sorter.prepare()
    except CycleError as error:
        raise PlanGraphError("the orderings of the plan and the times at which facts change contradict each other") from error
    position = {key: number for number, key in enumerate(preceding)}
    in_order: list[_Key] = []
    ready: list[tuple[float, int, _Key]] = []
    while sorter.is_active():
        for key in sorter.get_ready():
            heappush(ready, (times[key], position[key], key))
        in_order.append(heappop(ready)[-1])
        sorter.done(in_order[-1])
    return in_order


def direct_orderings(graph: PlanGraph, timed: Sequence[TimedChange]) -> Iterator[tuple[_Key, _Key]]:
    """Yield which event, or timed change by its number, comes directly before which."""
    yield from ((number - 1, number) for number in range(1, len(timed)))
    for ordering in graph.orderings:
        yield ordering.before, ordering.after
    for call in graph.calls:
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
