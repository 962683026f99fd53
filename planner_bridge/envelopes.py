"""Calls that must lie inside another call: when may the outer one start?

An end that others must come before (a match that must burn until the fuse is mended) is not
ours to delay: it comes when the outer action's time is up. What can be delayed is its start. So
the outer call waits for everything that its end, and the calls inside it, wait for besides: once
it has started, nothing but its own insides stands between it and the end of the last of them.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from pnm.expressions import Fluent
from pnm.plan_graph import Moment, Ordering, PlanEvent, PlanGraph


def tightened(plan: PlanGraph) -> PlanGraph:
    """Return the plan with the orderings that let every enveloping call start late enough."""
    ends: dict[int, list[Fluent]] = {}
    for one in plan.orderings:
        if one.after.moment is Moment.END:
            ends.setdefault(one.after.call, []).extend(one.protects)
    if not ends:
        return plan
    events = _Events()
    for call in plan.calls:
        events.order(PlanEvent(call.index, Moment.START), PlanEvent(call.index, Moment.END))
    for one in plan.orderings:
        events.order(one.before, one.after)
    added: list[Ordering] = []
    for index in sorted(ends):
        start = PlanEvent(index, Moment.START)
        for event in events.outside(index):
            events.order(event, start)
            added.append(Ordering(event, start, tuple(dict.fromkeys(ends[index]))))
    return replace(plan, orderings=(*plan.orderings, *added))


@dataclass
class _Events:
    """For every event, those directly before it and those directly after it."""

    before: dict[PlanEvent, set[PlanEvent]] = field(default_factory=dict)
    after: dict[PlanEvent, set[PlanEvent]] = field(default_factory=dict)

    def order(self, first: PlanEvent, second: PlanEvent) -> None:
        self.before.setdefault(second, set()).add(first)
        self.after.setdefault(first, set()).add(second)

    def outside(self, call: int) -> list[PlanEvent]:
        """Return what the end of the call and the events inside it wait for, that its start does not wait for yet."""
        start, end = PlanEvent(call, Moment.START), PlanEvent(call, Moment.END)
        inside = _reachable(start, self.after) & (_reachable(end, self.before) | {end})
        waiting = {other for event in inside for other in self.before.get(event, ()) if other not in inside and other != start}
        return sorted(waiting - self.before.get(start, set()), key=lambda event: (event.call, event.moment.value))


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
