"""Causal links: which event of a plan must wait for which, by the reads and writes of every fluent.

For every ground fluent the last writer is remembered, and the readers since; a reader waits for the last
writer (a causal link), a writer for the last writer and for every reader since (else it would threaten their
links). Those that write the same value one after the other, whatever the state, need not wait for each other, nor for
readers of that value: readers wait for the last of them, and the next writer of another value for all. The result is a
deordering of the plan (Bäckström 1998, *Computational Aspects of Reordering Plans*): it may be executed in any order that
keeps these orderings, as soon as they allow. The reader of a derived fact reads whatever that rests on: every fluent that
the plan changes and that can make a difference to it.

An over-all condition is read from just after the start until just before the end. Fluents that
nothing changes, and counters that only a metric reads (`total-cost`), order nothing.

A trajectory constraint depends on the order in which its fluents change, and a network of tasks on the order
of everything. So all events that have to do with one of these keep the order they have in the plan; and their
times, if the constraint depends on times other than a deadline.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from math import inf
from typing import Final, NamedTuple

from planner_bridge.ordering.partial_order import NEAR
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import All, Condition, conjuncts, evaluate, fluents
from pnm.core.logic.effects import TimedChange, changes, is_fixed, read, read_early, written
from pnm.core.logic.expressions import UNKNOWN, Fluent, State, Unknown, Value
from pnm.core.machine.plan_graph import ActionCall, GroundAction, Moment, Ordering, PlanEvent


@dataclass(slots=True)
class _SameWriters:
    """Events that write the same value, and all that each of them comes after; events are added."""

    value: Value
    after: tuple[PlanEvent, ...]
    events: list[PlanEvent]


class _FluentReader(NamedTuple):
    """A reader of a fluent: a point event, or an over-all condition until it closes."""

    call: int
    event: PlanEvent
    until: float


@dataclass(frozen=True, slots=True)
class OrderKept:
    """A part of a plan that must keep its order whatever the causal links: a constraint, or a network of tasks."""

    token: Fluent
    """Stands for a fluent that every such event writes, which gives them an order."""
    fluents: frozenset[Fluent] | None = None
    """Events that write one of these are concerned; None for every event."""
    timed: bool = False
    """Whether it also depends on the times."""


@dataclass
class CausalLinks:
    """Last writers, readers since, and the orderings so far, while the happenings of a plan are added in their order."""

    knowledge: KnowledgeBase
    """Has the objects, and the rules of derived facts."""
    relevant: frozenset[str]
    """The predicates and functions that can order anything."""
    actions: Sequence[GroundAction]
    """Those of the calls, by number."""
    timed: Sequence[TimedChange] = ()
    kept: list[OrderKept] = field(default_factory=list)
    starts: list[PlanEvent] = field(init=False)
    """The events of the calls, by number: they are asked for all the time."""
    ends: list[PlanEvent] = field(init=False)
    writes: dict[PlanEvent, frozenset[Fluent]] = field(init=False)
    """Everything that each event may write and that can order anything, whether or not the conditions of its effects hold."""
    reads: dict[PlanEvent, frozenset[Fluent]] = field(init=False)
    """Everything that each event reads and that can order anything; early conditions of end effects are decided and read at the start."""
    throughout: list[tuple[tuple[Condition, frozenset[Fluent]], ...]] = field(init=False)
    """The parts of what must hold from the start of each call to its end, with what of their fluents can order anything."""
    writer: dict[Fluent, PlanEvent] = field(default_factory=dict)
    """The event that wrote the fluent last."""
    same: dict[Fluent, _SameWriters] = field(default_factory=dict)
    """Of the fluents to which the last writer gives the same value in every state: all that have written it since another was there."""
    changed_at: dict[Fluent, float] = field(default_factory=dict)
    """The time at which the fluent changed by itself since."""
    readers: dict[Fluent, list[_FluentReader]] = field(default_factory=dict)
    open_conditions: list[tuple[int, frozenset[Fluent], float]] = field(default_factory=list)
    """Parts of over-all conditions on several fluents: the call, the fluents, and the time until which they must hold."""
    orderings: dict[tuple[PlanEvent, PlanEvent], list[Fluent]] = field(default_factory=dict)
    releases: dict[int, float] = field(default_factory=dict)
    deadlines: dict[int, float] = field(default_factory=dict)
    latest_starts: dict[int, float] = field(default_factory=dict)
    clocked: set[int] = field(default_factory=set)
    """The calls that must not start before their planned time."""

    def __post_init__(self) -> None:
        knowledge, relevant_of, self.throughout = self.knowledge, self.relevant_of, []
        starts, ends = ([PlanEvent(call, moment) for call in range(len(self.actions))] for moment in (Moment.START, Moment.END))
        self.starts, self.ends = starts, ends
        self.writes = {
            event: relevant_of(written(action.start_effects, knowledge)) for event, action in zip(starts, self.actions, strict=True)
        }
        self.writes |= {
            event: relevant_of(written(action.possible_effects, knowledge)) for event, action in zip(ends, self.actions, strict=True)
        }
        # Facts that stay as they are may be evaluated away, so that a derived fact orders less.
        if knowledge.rules.rules:  # what they read is known only as far as neither the plan nor time may change it
            changing = chain(*self.writes.values(), *(change.changes for change in self.timed))
            knowledge.update(dict.fromkeys(changing, UNKNOWN))
        self.reads = {}
        for start, end, action in zip(starts, ends, self.actions, strict=True):
            early = read_early(action.possible_effects, knowledge)
            self.reads[start] = relevant_of(fluents(action.precondition, knowledge) | read(action.start_effects, knowledge) | early)
            self.reads[end] = relevant_of(fluents(action.end_condition, knowledge) | read(action.possible_effects, knowledge))
            # what an action without duration needs must be there as long as the robot takes for it
            parts = conjuncts(action.precondition if action.duration is None else action.invariant)
            self.throughout.append(tuple([(part, relevant_of(fluents(part, knowledge))) for part in parts]))

    def _is_joint(self, call: int, fluent: Fluent) -> bool:
        """Return whether a part of what must hold all through a call has to do with this fluent and others."""
        return any(len(group) > 1 and fluent in group for _, group in self.throughout[call])

    def relevant_of(self, fluents: frozenset[Fluent]) -> frozenset[Fluent]:
        """Return the bases of the fluents, as far as they can order anything."""
        return frozenset([fluent for fluent in self.knowledge.rests_on(fluents) if fluent[0] in self.relevant]) if fluents else fluents

    def add_timed_change(self, time: float, changed: Mapping[Fluent, Value]) -> None:
        """Add a change of fluents by themselves; calls that end before it and could not have gone on get a deadline.

        Calls that start before it and could not have started then get a latest start.
        """
        tokens = [kept.token for kept in self.kept if kept.fluents is not None and kept.fluents & changed.keys()]
        self.changed_at.update(dict.fromkeys((*changed, *tokens), time))
        for token in tokens:  # the change must not come before the last event that the same constraint is about
            if token in self.writer and self.writer[token].moment is Moment.END:
                self.deadlines.setdefault(self.writer[token].call, time)
        after = _PartialState(self.knowledge, changed)
        for fluent in changed:
            for reader in self.readers.get(fluent, ()):
                action = self.actions[reader.call]
                # Only a condition that the change surely makes false ends before it; one that may survive needs no deadline.
                if action.duration is not None and evaluate(All((action.invariant, action.end_condition)), after) is False:
                    self.deadlines.setdefault(reader.call, time)
                if evaluate(action.precondition, after) is False:
                    self.latest_starts.setdefault(reader.call, time)

    def add_event(self, event: PlanEvent, now: float) -> None:
        """Add what an event reads and writes; an action without duration does both when it starts."""
        if self.actions[event.call].duration is not None:
            self._add_point(event, event, self.reads[event], now)
        elif event.moment is Moment.START:
            end = self.ends[event.call]
            self._add_point(event, end, self.reads[event] | self.reads[end], now)

    def begin_reading(self, call: int, now: float, until: float) -> None:
        """Add that the over-all condition of a call is read from now on."""
        if self.actions[call].duration is None:
            return
        groups = [group for _, group in self.throughout[call] if group]
        for fluent in sorted(frozenset().union(*groups)):
            self._after_writer(fluent, self.starts[call], now)
            self.readers.setdefault(fluent, []).append(_FluentReader(call, self.ends[call], until))
        # A write may leave such a part true thanks to another of its fluents, which a reader of single fluents would not show.
        self.open_conditions += [(call, group, until) for group in groups if len(group) > 1]

    def _add_point(self, waits: PlanEvent, releases: PlanEvent, reads: frozenset[Fluent], now: float) -> None:
        """Add the reads, and what `releases` writes, at one point in time: it waits as `waits`, and later events wait for `releases`."""
        writes = self.writes[releases]
        self.open_conditions = [one for one in self.open_conditions if one[2] > now]
        # A write that leaves an over-all condition true may do so only because of the values of its other fluents.
        relied = [group - writes for call, group, _ in self.open_conditions if call != waits.call and group & writes]
        # Reads before writes: an event that does both waits for others and not for itself.
        for fluent in sorted(reads.union(*relied)):
            self._after_writer(fluent, waits, now)
            self.readers.setdefault(fluent, []).append(_FluentReader(releases.call, releases, now))
        concerned = [kept for kept in self.kept if kept.fluents is None or kept.fluents & writes]
        if any(kept.timed for kept in concerned):
            self.clocked.add(waits.call)
        # A write comes after the last write and after every read of that value since: else it would break a causal link.
        action = self.actions[releases.call]
        effects = action.start_effects if releases.moment is Moment.START else action.end_effects
        fixed = () if action.outcomes else tuple(filter(is_fixed, effects))
        others = written(tuple(one for one in effects if not is_fixed(one)), self.knowledge)
        certain = {fluent: value for fluent, value in changes(fixed, self.knowledge).items() if fluent not in others}
        for fluent in (*sorted(writes), *(kept.token for kept in concerned)):
            value, same = certain.get(fluent), self.same.get(fluent)
            if same and same.value == value and fluent not in self.changed_at:
                after = [
                    *same.after,
                    *(self._release(reader, now) for reader in self.readers[fluent] if self._is_joint(reader.call, fluent)),
                ]
                same.events.append(releases)
            else:
                self._after_writer(fluent, waits, now)
                readers = self.readers.get(fluent, [])
                before = same.events if same else [self.writer[fluent]] if fluent in self.writer else []
                after = [*before, *(self._release(reader, now) for reader in readers)]
                # readers of the old value are served; those with open conditions, which this write leaves true, go on reading the new one
                self.readers[fluent] = [reader for reader in readers if reader.until > now]
                self.same.pop(fluent, None)
                if isinstance(value, bool | str):
                    self.same[fluent] = _SameWriters(value, tuple(after), [releases])
            for event in after:
                self._order(event, waits, fluent)
            self.writer[fluent] = releases
            self.changed_at.pop(fluent, None)  # who reads it from now on reads what this event has written, and no longer the timed change

    def _release(self, reader: _FluentReader, now: float) -> PlanEvent:
        """Return what a writer waits for because of a reader: its end, or its start if it goes on reading."""
        return self.starts[reader.call] if reader.until > now else reader.event

    def _after_writer(self, fluent: Fluent, waits: PlanEvent, now: float) -> None:
        if fluent in self.writer:
            same = self.same.get(fluent)
            for event in same.events if same and self._is_joint(waits.call, fluent) else [self.writer[fluent]]:
                self._order(event, waits, fluent)
        if fluent in self.changed_at:
            release = self.changed_at[fluent]
            if waits.moment is Moment.END:  # it comes when its time is up, so its start must be late enough, but no later than planned
                duration = self.actions[waits.call].duration or 0.0
                release = min(release - duration * (1.0 - SLACK), max(release, now) - duration)
            self.releases[waits.call] = max(release, self.releases.get(waits.call, 0.0))

    def _order(self, before: PlanEvent, after: PlanEvent, fluent: Fluent) -> None:
        if before.call != after.call:
            protected = self.orderings.setdefault((before, after), [])
            if fluent not in protected:
                protected.append(fluent)

    def timed_calls(self, calls: Sequence[ActionCall]) -> Sequence[ActionCall]:
        """Return the calls with the times that they must keep."""
        bound = self.clocked.union(self.releases, self.deadlines, self.latest_starts)
        return [
            replace(
                call,
                release=max(call.release, self.releases.get(call.index, 0.0), call.planned if call.index in self.clocked else 0.0),
                latest_start=min(call.latest_start, self.latest_starts.get(call.index, inf)),
                deadline=min(call.deadline, self.deadlines.get(call.index, inf)),
            )
            if call.index in bound
            else call
            for call in calls
        ]

    def due(self, goal: Condition) -> float:
        """Return when time itself has done its part for the goal, which must not be looked at before."""
        return max((self.changed_at.get(fluent, 0.0) for fluent in self.relevant_of(fluents(goal, self.knowledge))), default=0.0)

    def strongest(self) -> list[Ordering]:
        """Return the orderings, of those between the same calls the strongest.

        `start of a < x` is merged into `end of a < x`, and `x < end of b` into `x < start of b`.
        """
        orderings, merged = self.orderings, dict[tuple[PlanEvent, PlanEvent], list[Fluent]]()
        for (before, after), protected in sorted(orderings.items(), key=_by_call):
            for stronger in (  # an ordering implied by a stronger one would cost a place of its own, and order nothing
                (self.ends[before.call], self.starts[after.call]),
                (self.ends[before.call], after),
                (before, self.starts[after.call]),
            ):
                if stronger in orderings:
                    merged.setdefault(stronger, []).extend(protected)
                    break
            else:
                merged.setdefault((before, after), []).extend(protected)
        found = sorted(merged.items(), key=_by_call)
        return [Ordering(before, after, tuple(dict.fromkeys(protected))) for (before, after), protected in found]


@dataclass(frozen=True, slots=True)
class _PartialState:
    """A state with only some values known; a condition that is not false in it may still be true."""

    whole: State
    known: Mapping[Fluent, Value]

    def value(self, fluent: Fluent, /) -> Value | Unknown | None:
        return self.known.get(fluent, UNKNOWN)

    def objects(self, types: tuple[str, ...], /) -> tuple[str, ...]:
        return self.whole.objects(types)


def _by_call(item: tuple[tuple[PlanEvent, PlanEvent], object]) -> tuple[int, int, bool, bool]:
    (before, after), _ = item
    return before.call, after.call, before.moment is Moment.START, after.moment is Moment.START


# --- enclosing actions ----------------------------------------------------------------------------
# Enclosing actions: when may an action start that must not end before others have (required concurrency)?
#
# An end that other events must precede (a match that must burn until the fuse is mended) cannot be
# delayed: it comes when the duration of its action is up. Only the start can be timed. The plan had it
# start so late that everything inside fits. So the start is delayed: it waits for every predecessor of the
# enclosed events, with the plan's distance from it. A predecessor that the plan had before the start, it
# waits for directly; for a later one, it waits for the last events that lead to that one, plus the planned
# offset from them, plus 1 % slack, unless it has to end inside another such action itself: a plan may leave
# no slack at all, and real robots are never quite on time.
# (Cushing et al. 2007, *When is Temporal Planning Really Temporal?*, on required concurrency.)


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
    enclosing = [(call, events.time(PlanEvent(call, Moment.START)), events.time(PlanEvent(call, Moment.END))) for call in protected]
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

    def is_enclosed(self, call: int, others: Iterable[tuple[int, float, float]]) -> bool:
        """Whether the call must end before one of the others does, each with its start and its end, that is under way then."""
        end = PlanEvent(call, Moment.END)
        time = self.time(end)
        around = {PlanEvent(other, Moment.END): ends for other, starts, ends in others if starts < time <= ends + NEAR and other != call}
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
