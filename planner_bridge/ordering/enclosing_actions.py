"""Enclosing actions: when may an action start that must not end before others have (required concurrency)?

An end that other events must precede (a match that must burn until the fuse is mended) cannot be
delayed: it comes when the duration of its action is up. Only the start can be timed. The plan had it
start so late that everything inside fits. So the start is delayed: it waits for every predecessor of the
enclosed events, with the plan's distance from it. A predecessor that the plan had before the start, it
waits for directly; for a later one, it waits for the last events that lead to that one, plus the planned
offset from them, plus 1 % slack, unless it has to end inside another such action itself: a plan may leave
no slack at all, and real robots are never quite on time.
(Cushing et al. 2007, *When is Temporal Planning Really Temporal?*, on required concurrency.)
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

from planner_bridge.ordering.partial_order import NEAR
from pnm.core.logic.expressions import Fluent
from pnm.core.machine.plan_graph import ActionCall, Moment, Ordering, PlanEvent

SLACK: Final = 0.01
"""The share of its duration by which an action starts later than it could, if its end must come late enough for others or for time."""


def delay_enclosing_starts(calls: Sequence[ActionCall], orderings: Sequence[Ordering]) -> tuple[Sequence[ActionCall], Sequence[Ordering]]:
    """Return the calls and orderings of a plan with those orderings that let every enclosing action start late enough."""
    protected: dict[int, list[Fluent]] = {}
    for ordering in orderings:
        # An end that another event must precede; the start of a call that is under way cannot be delayed any more.
        if ordering.after.moment is Moment.END and not calls[ordering.after.call].under_way:
            protected.setdefault(ordering.after.call, []).extend(ordering.protects)
    if not protected:
        return calls, orderings
    events = _EventGraph(calls, orderings)
    enclosing = _Spans(events, protected)
    added: list[Ordering] = []
    releases: dict[int, float] = {}
    for index in sorted(protected):  # in a fixed order, because each round adds orderings that the next one sees
        start = PlanEvent(index, Moment.START)
        # Only the outermost action gets slack: an inner one that starts later might outlast the one around it.
        slack = 0.0 if events.is_enclosed(index, enclosing) else SLACK
        starts_at = events.time(start) + slack * (calls[index].action.duration or 0.0)
        enclosed = events.enclosed(index)
        predecessors = events.predecessors(index, enclosed)
        # Something inside waits for a release time, which no delay after an event can stand for.
        if any(events.is_released(event, start) for event in (*enclosed, *predecessors)):
            releases[index] = starts_at
        for event in predecessors:
            for anchor in events.last_before(event, start):
                events.order(anchor, start)
                # A predecessor that the plan had earlier is waited for directly, without a delay.
                delay = 0.0 if anchor == event else starts_at - events.time(anchor)
                added.append(Ordering(anchor, start, tuple(dict.fromkeys(protected[index])), delay))
    late = [replace(call, release=max(call.release, releases[call.index])) if call.index in releases else call for call in calls]
    return late, (*orderings, *added)


@dataclass
class _EventGraph:
    """The events of a plan with their planned times and their direct predecessors and successors."""

    calls: Sequence[ActionCall]
    orderings: Sequence[Ordering]
    before: dict[PlanEvent, set[PlanEvent]] = field(default_factory=dict)
    after: dict[PlanEvent, set[PlanEvent]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for call in self.calls:
            self.order(PlanEvent(call.index, Moment.START), PlanEvent(call.index, Moment.END))
        for ordering in self.orderings:
            self.order(ordering.before, ordering.after)

    def order(self, first: PlanEvent, second: PlanEvent) -> None:
        self.before.setdefault(second, set()).add(first)
        self.after.setdefault(first, set()).add(second)

    def time(self, event: PlanEvent) -> float:
        call = self.calls[event.call]
        return call.planned + (0.0 if event.moment is Moment.START else call.action.duration or 0.0)

    def is_enclosed(self, call: int, others: _Spans) -> bool:
        """Whether the call must end before one of the others does that is under way then."""
        end = PlanEvent(call, Moment.END)
        time = self.time(end)
        around = {PlanEvent(other, Moment.END): until for other, until in others.around(time) if other != call}
        latest = max(around.values(), default=time)
        return bool(around) and not around.keys().isdisjoint(_reachable(end, self.after, lambda event: self.time(event) <= latest + NEAR))

    def enclosed(self, call: int) -> set[PlanEvent]:
        """Return the events between the start and the end of the call, and the end."""
        start, end = PlanEvent(call, Moment.START), PlanEvent(call, Moment.END)
        earliest = self.time(start) - NEAR
        before = _reachable(end, self.before, lambda event: self.time(event) >= earliest) | {end}
        return _reachable(start, self.after, before.__contains__)

    def predecessors(self, call: int, enclosed: set[PlanEvent]) -> list[PlanEvent]:
        """Return the other events that the enclosed ones wait for, and that the start of the call does not wait for yet."""
        start = PlanEvent(call, Moment.START)
        waiting = {other for event in enclosed for other in self.before.get(event, ()) if other not in enclosed and other != start}
        return _sorted(waiting - self.before.get(start, set()))

    def last_before(self, event: PlanEvent, start: PlanEvent) -> list[PlanEvent]:
        """Return the last events that lead to this one and that the plan had before the start."""
        last: set[PlanEvent] = set()
        seen = {event}
        waiting = [event]
        while waiting:
            candidate = waiting.pop()
            # An event planned later than the start cannot be waited for by it: those that lead to it are looked at instead.
            if self.time(candidate) <= self.time(start):
                last.add(candidate)
            else:
                earlier = self.before.get(candidate, set()) - seen
                seen |= earlier
                waiting.extend(earlier)
        return _sorted(last)

    def is_released(self, event: PlanEvent, start: PlanEvent) -> bool:
        """Whether the event comes after the start because of the release time of a call that leads to it."""
        begun = self.time(start)
        earlier = _reachable(event, self.before, lambda other: self.time(other) > begun - NEAR)
        late = (other for other in (event, *earlier) if self.time(other) > begun)
        return any(other.moment is Moment.START and self.calls[other.call].release for other in late)


class _Spans:
    """The times from start to end of some calls, to be found by a time between the two."""

    def __init__(self, events: _EventGraph, calls: Iterable[int]) -> None:
        times = ((events.time(PlanEvent(call, Moment.START)), events.time(PlanEvent(call, Moment.END)), call) for call in calls)
        self._spans = sorted(times)
        self._longest = max((end - start for start, end, _ in self._spans), default=0.0)

    def around(self, time: float) -> Iterator[tuple[int, float]]:
        """Yield the calls that start before the time and do not end before it, each with its end."""
        first, last = (bisect_left(self._spans, (bound,)) for bound in (time - self._longest - NEAR, time))
        return ((call, end) for _, end, call in self._spans[first:last] if end >= time - NEAR)


def _sorted(events: set[PlanEvent]) -> list[PlanEvent]:
    return sorted(events, key=lambda event: (event.call, event.moment.value))


def _reachable(
    event: PlanEvent, neighbours: Mapping[PlanEvent, Iterable[PlanEvent]], goes_on: Callable[[PlanEvent], bool]
) -> set[PlanEvent]:
    """Return the events that are reached from this one, itself left out, through events of which `goes_on` holds alone.

    A time is a bound, for nothing that a plan has later comes before what it has earlier; but of calls under way, which come before
    all others, whatever the time at which they would end.
    """
    reachable: set[PlanEvent] = set()
    waiting = [event]
    while waiting:
        for other in neighbours.get(waiting.pop(), ()):
            if other not in reachable and goes_on(other):
                reachable.add(other)
                waiting.append(other)
    return reachable
