"""Calls that must lie inside another call: when may the outer one start?

An end that others must come before (a match that must burn until the fuse is mended) is not
ours to delay: it comes when the outer action's time is up. What can be delayed is its start. So
the outer call waits for everything that the calls inside it wait for besides: once it has
started, nothing but its own insides stands between it and the end of the last of them.
"""

from __future__ import annotations

from dataclasses import replace

from pnm.plan_graph import Moment, Ordering, PlanEvent, PlanGraph


def tightened(plan: PlanGraph) -> PlanGraph:
    """Return the plan with the orderings that let every enveloping call start late enough."""
    enveloping = sorted({one.after.call for one in plan.orderings if one.after.moment is Moment.END})
    for call in enveloping:
        plan = replace(plan, orderings=(*plan.orderings, *_delays(plan, call)))
    return plan


def _delays(plan: PlanGraph, call: int) -> list[Ordering]:
    """Return the orderings from what the insides of the call wait for to its start."""
    start, end = PlanEvent(call, Moment.START), PlanEvent(call, Moment.END)
    before, after = _neighbours(plan)
    inside = _reachable(start, after) & _reachable(end, before)
    waiting = {other for event in inside for other in before.get(event, ()) if other not in inside and other.call != call}
    protected = tuple(fact for one in plan.orderings if one.after == end for fact in one.protects)
    known = {one.before for one in plan.orderings if one.after == start}
    return [Ordering(event, start, protected) for event in sorted(waiting - known, key=str)]


def _neighbours(plan: PlanGraph) -> tuple[dict[PlanEvent, list[PlanEvent]], dict[PlanEvent, list[PlanEvent]]]:
    """Return, for every event, those directly before and those directly after it."""
    before: dict[PlanEvent, list[PlanEvent]] = {}
    after: dict[PlanEvent, list[PlanEvent]] = {}
    pairs = [(PlanEvent(call.index, Moment.START), PlanEvent(call.index, Moment.END)) for call in plan.calls]
    for first, second in (*pairs, *((one.before, one.after) for one in plan.orderings)):
        before.setdefault(second, []).append(first)
        after.setdefault(first, []).append(second)
    return before, after


def _reachable(event: PlanEvent, neighbours: dict[PlanEvent, list[PlanEvent]]) -> set[PlanEvent]:
    """Return the events reachable from this one, itself left out."""
    found: set[PlanEvent] = set()
    waiting = [event]
    while waiting:
        for other in neighbours.get(waiting.pop(), ()):
            if other not in found:
                found.add(other)
                waiting.append(other)
    return found
