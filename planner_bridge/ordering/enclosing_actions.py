"""Calls that must lie inside another call: when may the outer one start?

An end that others must come before (a match that must burn until the fuse is mended) is not
ours to delay: it comes when the outer action's time is up. What can be timed is its start. The
plan had it start so late that everything inside fits. So its start keeps the plan's distance
from whatever the end, and the calls inside, wait for besides: what the plan had happen before
that start, it waits for; of what the plan had happen later, it waits for what that follows from,
and then for as many seconds as the plan did, and a little more: a plan may leave no slack at all,
and real robots are never quite on time.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Final

from pnm.core.logic.expressions import Fluent
from pnm.core.machine.plan_graph import Moment, Ordering, PlanEvent, PlanGraph

SLACK: Final = 0.01
"""How much later than planned an enveloping call starts that is not itself inside another, as a share of its duration."""


def tightened(plan: PlanGraph) -> PlanGraph:
    """Return the plan with the orderings that let every enveloping call start late enough."""
    ends: dict[int, list[Fluent]] = {}
    for one in plan.orderings:
        if one.after.moment is Moment.END and not plan.calls[one.after.call].under_way:
            ends.setdefault(one.after.call, []).extend(one.protects)
    if not ends:
        return plan
    events = _Events(plan)
    added: list[Ordering] = []
    releases: dict[int, float] = {}
    for index in sorted(ends):
        start = PlanEvent(index, Moment.START)
        slack = 0.0 if events.is_enclosed(index, ends) else SLACK
        starts_at = events.time(start) + slack * (plan.calls[index].action.duration or 0.0)
        inside = events.inside(index)
        outside = events.outside(index, inside)
        if any(events.is_released(event, start) for event in (*inside, *outside)):
            releases[index] = starts_at
        for event in outside:
            for anchor in events.known_by(event, start):
                events.order(anchor, start)
                delay = 0.0 if anchor == event else starts_at - events.time(anchor)
                added.append(Ordering(anchor, start, tuple(dict.fromkeys(ends[index])), delay))
    calls = tuple(replace(call, release=max(call.release, releases.get(call.index, 0.0))) for call in plan.calls)
    return replace(plan, steps=calls, orderings=(*plan.orderings, *added))


@dataclass
class _Events:
    """For every event, when the plan had it, those directly before it and those directly after it."""

    plan: PlanGraph
    before: dict[PlanEvent, set[PlanEvent]] = field(default_factory=dict)
    after: dict[PlanEvent, set[PlanEvent]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for call in self.plan.calls:
            self.order(PlanEvent(call.index, Moment.START), PlanEvent(call.index, Moment.END))
        for one in self.plan.orderings:
            self.order(one.before, one.after)

    def order(self, first: PlanEvent, second: PlanEvent) -> None:
        self.before.setdefault(second, set()).add(first)
        self.after.setdefault(first, set()).add(second)

    def time(self, event: PlanEvent) -> float:
        call = self.plan.calls[event.call]
        return call.planned + (0.0 if event.moment is Moment.START else call.action.duration or 0.0)

    def is_enclosed(self, call: int, others: Iterable[int]) -> bool:
        """Tell whether the call must end before another enveloping one does, which does not wait for it."""
        later = _reachable(PlanEvent(call, Moment.END), self.after)
        return any(PlanEvent(other, Moment.END) in later and PlanEvent(other, Moment.START) not in later for other in others)

    def inside(self, call: int) -> set[PlanEvent]:
        """Return the events between the start and the end of the call, and the end."""
        start, end = PlanEvent(call, Moment.START), PlanEvent(call, Moment.END)
        return _reachable(start, self.after) & (_reachable(end, self.before) | {end})

    def outside(self, call: int, inside: set[PlanEvent]) -> list[PlanEvent]:
        """Return what the events inside wait for besides, that the start of the call does not wait for yet."""
        start = PlanEvent(call, Moment.START)
        waiting = {other for event in inside for other in self.before.get(event, ()) if other not in inside and other != start}
        return _sorted(waiting - self.before.get(start, set()))

    def known_by(self, event: PlanEvent, start: PlanEvent) -> list[PlanEvent]:
        """Return the last events that lead to this one and that the plan had before the start."""
        found: set[PlanEvent] = set()
        seen = {event}
        waiting = [event]
        while waiting:
            one = waiting.pop()
            if self.time(one) <= self.time(start):
                found.add(one)
            else:
                earlier = self.before.get(one, set()) - seen
                seen |= earlier
                waiting.extend(earlier)
        return _sorted(found)

    def is_released(self, event: PlanEvent, start: PlanEvent) -> bool:
        """Tell whether the event comes later than the start because something that leads to it must not be earlier."""
        late = {one for one in (event, *_reachable(event, self.before)) if self.time(one) > self.time(start)}
        return any(one.moment is Moment.START and self.plan.calls[one.call].release for one in late)


def _sorted(events: set[PlanEvent]) -> list[PlanEvent]:
    return sorted(events, key=lambda event: (event.call, event.moment.value))


def _reachable(event: PlanEvent, neighbours: dict[PlanEvent, set[PlanEvent]]) -> set[PlanEvent]:
    """Return the events reachable from this one, itself left out."""
    found: set[PlanEvent] = set()
    waiting = [event]
    while waiting:
        for other in neighbours.get(waiting.pop(), ()):
            if other not in found:
                found.add(other)
                waiting.append(other)
    return found
