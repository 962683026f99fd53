"""Forecast of a plan that is being carried out: when it is expected to be done with what it needs, and what it leaves behind then.

With it a planner can weigh waiting for a busy robot: what others need is not there at first, and comes by itself at a time.
Forecasts are for decisions only, never for what is believed: nothing begins before what it needs is there.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from planner_bridge.model.problem import Problem
from planner_bridge.model.progression import NotApplicable, Progression, snapshot
from planner_bridge.ordering.interference import SOON, ReadWriteSets, avoid_interference, read_write_sets
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import TRUE
from pnm.core.logic.effects import TimedChange
from pnm.core.logic.expressions import Fluent, Unknown, Value
from pnm.core.machine.plan_graph import Moment, Ordering, PlanEvent, PlanGraph


@dataclass(frozen=True)
class Forecast:
    """What is expected of a plan that is being carried out.

    Args:
        needed: what the rest of it reads and writes.
        released: for these fluents, the seconds from now after which it is done with them; nothing is known about others.
        values: what it leaves behind in them.
    """

    needed: ReadWriteSets
    released: Mapping[Fluent, float] = field(default_factory=dict)
    values: Mapping[Fluent, Value] = field(default_factory=dict)


def forecast(plan: PlanGraph, events: Sequence[PlanEvent], left: Mapping[int, float], state: KnowledgeBase) -> Forecast:
    """Return what is expected of a plan, each call of which takes its planned duration.

    Args:
        plan: what is being carried out.
        events: those of its events that are still to come, in an order that the plan allows.
        left: for the calls that are under way, the seconds that they are expected to take from now.
        state: of the world, as it is known to be.
    """
    # A call that was under way when its machine was made may have to begin anew since.
    calls = [replace(plan.calls[number], under_way=number in left) for number in dict.fromkeys(event.call for event in events)]
    needed = read_write_sets(calls, plan.goal, state)
    before: dict[PlanEvent, list[Ordering]] = {}
    for ordering in plan.orderings:
        before.setdefault(ordering.after, []).append(ordering)
    simulation = Progression(snapshot(state), {number: plan.calls[number].action for number in left})
    times: dict[PlanEvent, float] = {}
    for event in events:
        action = plan.calls[event.call].action
        time = max((times.get(ordering.before, 0.0) + ordering.delay for ordering in before.get(event, ())), default=0.0)
        if event.moment is Moment.END:
            began = times.get(PlanEvent(event.call, Moment.START), 0.0)
            time = max(time, left[event.call] if event.call in left else began + (action.duration or 0.0))
        times[event] = time
        try:
            simulation.advance([(event, action)])
        except NotApplicable:
            return Forecast(needed)  # the plan will have to be replaced
    released = dict.fromkeys(_read(read_write_sets((), plan.goal, state)), max(times.values(), default=0.0))
    for call in calls:
        used = read_write_sets([call], TRUE, state)
        for fluent in _read(used) | used.writes.keys():
            released[fluent] = max(released.get(fluent, 0.0), times[PlanEvent(call.index, Moment.END)])
    values = {fluent: simulation.state.value(fluent) for fluent in needed.writes}
    known = {fluent: value for fluent, value in values.items() if value is not None and not isinstance(value, Unknown)}
    return Forecast(needed, released, known)


def with_forecasts(problem: Problem, forecasts: Iterable[Forecast]) -> Problem:
    """Return a problem in which what other plans need is not to be had before they are expected to be done with it."""
    changes: list[TimedChange] = []
    for other in forecasts:
        problem = avoid_interference(problem, [other.needed], other.released)
        changes += [TimedChange(max(other.released[fluent], SOON), {fluent: value}) for fluent, value in other.values.items()]
    return replace(problem, timed=tuple(sorted((*problem.timed, *changes), key=lambda change: change.time)))


def awaited(mine: ReadWriteSets, other: Forecast) -> tuple[Fluent, float] | None:
    """Return what a plan has to wait for because another one changes or reads it, and for how many seconds; None for nothing."""
    shared = (_read(mine) & other.needed.writes.keys()) | (_read(other.needed) & mine.writes.keys())
    last = max(shared & other.released.keys(), key=lambda fluent: (other.released[fluent], fluent), default=None)
    return None if last is None else (last, other.released[last])


def _read(sets: ReadWriteSets) -> frozenset[Fluent]:
    return sets.reads | sets.facts.keys()
