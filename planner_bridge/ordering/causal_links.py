"""Who must wait for whom: the last writers and the readers of every fluent, as events come in the order of a plan.

For every ground fluent we remember who wrote it last and who has read it since; a reader waits
for the last writer, a writer waits for the last writer and for every reader since. That keeps
exactly the orders that matter: the plan may be executed in any order that keeps them, as soon as
they allow. Who reads a derived fact reads what it rests on: whatever the plan changes that can
make a difference to it.

An over-all condition is read from just after the start until just before the end. Fluents that
nothing changes, and counters that only a metric reads (`total-cost`), order nothing.

A constraint over the course of states is kept by the order in which its fluents change, and a
network of tasks by the order of everything. So all that has to do with one of these keeps the
order it has in the plan; and its time, if the constraint says more of times than how late is too late.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum
from math import inf

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import All, Condition, conjuncts, fluents
from pnm.core.logic.effects import Effects, read, read_early, written
from pnm.core.logic.evaluation import evaluate
from pnm.core.logic.expressions import UNKNOWN, Fluent, State, Unknown, Value
from pnm.core.machine.plan_graph import ActionCall, GroundAction, Moment, Ordering, PlanEvent, PlanGraph


class Kind(IntEnum):
    """What can happen; at one time, in this order."""

    TIMED = 0
    """Facts change by themselves."""
    END = 1
    START = 2
    INSTANT_END = 3
    """The rank of an end of what lasts no time."""
    OPEN = 4
    """An over-all condition begins to be read."""


@dataclass(frozen=True, slots=True)
class _Reader:
    """Who has read a fluent: a point event, or an over-all condition until it closes."""

    call: int
    event: PlanEvent
    until: float


@dataclass(frozen=True, slots=True)
class Kept:
    """What besides its causes depends on the order of a plan: a constraint, or a network of tasks."""

    stand_in: Fluent
    """Stands for a fluent that changes with each of the others, which gives them an order."""
    changing: frozenset[Fluent] | None = None
    """None for whatever happens."""
    timed: bool = False
    """It also depends on the times."""


@dataclass
class Causes:
    """Last writers, readers since, and the orderings found so far."""

    knowledge: KnowledgeBase
    """Tells objects, and what derived facts rest on."""
    relevant: frozenset[str]
    kept: tuple[Kept, ...] = ()
    writer: dict[Fluent, PlanEvent] = field(default_factory=dict)
    """The event that wrote the fluent last."""
    changed_at: dict[Fluent, float] = field(default_factory=dict)
    """When the fluent changed by itself since."""
    readers: dict[Fluent, list[_Reader]] = field(default_factory=dict)
    watched: list[tuple[int, frozenset[Fluent], float]] = field(default_factory=list)
    """The parts of over-all conditions on several fluents: whose, on which, and until when."""
    orderings: dict[tuple[PlanEvent, PlanEvent], list[Fluent]] = field(default_factory=dict)
    releases: dict[int, float] = field(default_factory=dict)
    deadlines: dict[int, float] = field(default_factory=dict)
    actions: dict[int, GroundAction] = field(default_factory=dict)
    lasting: dict[int, frozenset[Fluent]] = field(default_factory=dict)
    by_the_clock: set[int] = field(default_factory=set)
    """The calls that must not start before their planned time."""

    def timed(self, time: float, changed: Mapping[Fluent, Value]) -> None:
        """Note that fluents change by themselves, and which calls that were over by then could not have gone on."""
        concerned = [one.stand_in for one in self.kept if one.changing is not None and one.changing & changed.keys()]
        self.changed_at.update(dict.fromkeys((*changed, *concerned), time))
        for stand_in in concerned:
            if stand_in in self.writer and self.writer[stand_in].moment is Moment.END:
                self.deadlines.setdefault(self.writer[stand_in].call, time)
        after = _Only(self.knowledge, changed)
        for fluent in changed:
            for reader in self.readers.get(fluent, ()):
                action = self.actions[reader.call]
                if action.duration is not None and evaluate(All((action.invariant, action.end_condition)), after) is False:
                    self.deadlines.setdefault(reader.call, time)

    def happen(self, kind: Kind, called: ActionCall, end: float, now: float) -> None:
        """Note what one happening reads and writes."""
        call, action = called.index, called.action
        self.actions[call] = action
        start_event, end_event = PlanEvent(call, Moment.START), PlanEvent(call, Moment.END)
        start, ending = action.start_effects, action.end_effects
        match kind:
            case _ if action.duration is None:
                if kind is not Kind.START:
                    return
                self._point(start_event, end_event, self._reads(action.precondition, ending), self._writes(ending), now)
            case Kind.START:
                reads = self._reads(action.precondition, start) | self.knowledge.rests_on(read_early(ending, self.knowledge))
                self._point(start_event, start_event, reads, self._writes(start), now)
            case Kind.OPEN:
                for fluent in self._only(self._reads(action.invariant)):
                    self._after_writer(fluent, start_event)
                    self.readers.setdefault(fluent, []).append(_Reader(call, end_event, end))
                for part in conjuncts(action.invariant):
                    group = frozenset(self._only(self._reads(part)))
                    if len(group) > 1:
                        self.watched.append((call, group, end))
            case Kind.END:
                mine = (fluent for fluent in self._writes(start) if self.writer.get(fluent) == start_event)
                self.lasting[call] = frozenset(mine)
                self._point(end_event, end_event, self._reads(action.end_condition, ending), self._writes(ending), now)

    def _reads(self, condition: Condition, effects: Effects = ()) -> frozenset[Fluent]:
        return self.knowledge.rests_on(fluents(condition, self.knowledge) | read(effects, self.knowledge))

    def _writes(self, effects: Effects) -> frozenset[Fluent]:
        return written(effects, self.knowledge)

    def _only(self, found: frozenset[Fluent]) -> list[Fluent]:
        return sorted(fluent for fluent in found if fluent[0] in self.relevant)

    def _touched(self, call: int, writes: frozenset[Fluent]) -> list[Fluent]:
        """Return what stands for the constraints that are concerned."""
        touched = [one for one in self.kept if one.changing is None or one.changing & writes]
        if any(one.timed for one in touched):
            self.by_the_clock.add(call)
        return [one.stand_in for one in touched]

    def _point(self, waits: PlanEvent, releases: PlanEvent, reads: frozenset[Fluent], writes: frozenset[Fluent], now: float) -> None:
        # A write that leaves an over-all condition true may do so only because of what its other fluents are.
        relied = [group - writes for call, group, until in self.watched if until > now and call != waits.call and group & writes]
        for fluent in self._only(reads.union(*relied)):
            self._after_writer(fluent, waits)
            self.readers.setdefault(fluent, []).append(_Reader(releases.call, releases, now))
        for fluent in (*self._only(writes), *self._touched(waits.call, writes)):
            self._after_writer(fluent, waits)
            still = []
            for reader in self.readers.get(fluent, ()):
                if reader.until > now:  # an over-all condition that this write leaves true
                    still.append(reader)
                    self._order(PlanEvent(reader.call, Moment.START), waits, fluent)
                else:
                    self._order(reader.event, waits, fluent)
            self.readers[fluent] = still
            self.writer[fluent] = releases
            self.changed_at.pop(fluent, None)

    def _after_writer(self, fluent: Fluent, waits: PlanEvent) -> None:
        if fluent in self.writer:
            self._order(self.writer[fluent], waits, fluent)
        if fluent in self.changed_at:  # an end comes when its time is up, so its start must not be too early
            lead = self.actions[waits.call].duration or 0.0 if waits.moment is Moment.END else 0.0
            self.releases[waits.call] = max(self.changed_at[fluent] - lead, self.releases.get(waits.call, 0.0))

    def _order(self, before: PlanEvent, after: PlanEvent, fluent: Fluent) -> None:
        if before.call != after.call:
            protected = self.orderings.setdefault((before, after), [])
            if fluent not in protected:
                protected.append(fluent)

    def graph(self, calls: Iterable[ActionCall], goal: Condition) -> PlanGraph:
        """Return the plan graph; of two orderings between the same calls only the stronger is kept."""
        told = tuple(
            replace(
                call,
                release=max(call.release, self.releases.get(call.index, 0.0), call.planned if call.index in self.by_the_clock else 0.0),
                deadline=min(call.deadline, self.deadlines.get(call.index, inf)),
                lasting=self.lasting.get(call.index, frozenset()),
            )
            for call in calls
        )
        due = max((self.changed_at.get(fluent, 0.0) for fluent in self._reads(goal)), default=0.0)
        return PlanGraph(told, tuple(_strongest(self.orderings)), goal, self.knowledge.rules, due)


@dataclass(frozen=True, slots=True)
class _Only:
    """A state of which only some values are known; what is not false in it may still be true."""

    whole: State
    known: Mapping[Fluent, Value]

    def value(self, fluent: Fluent, /) -> Value | Unknown | None:
        return self.known.get(fluent, UNKNOWN)

    def objects(self, types: tuple[str, ...], /) -> tuple[str, ...]:
        return self.whole.objects(types)


def _strongest(found: dict[tuple[PlanEvent, PlanEvent], list[Fluent]]) -> list[Ordering]:
    """Merge `start of a < x` into `end of a < x`, and `x < end of b` into `x < start of b`."""
    merged: dict[tuple[PlanEvent, PlanEvent], list[Fluent]] = {}
    for (before, after), protected in sorted(found.items(), key=_by_call):
        for stronger in (
            (PlanEvent(before.call, Moment.END), PlanEvent(after.call, Moment.START)),
            (PlanEvent(before.call, Moment.END), after),
            (before, PlanEvent(after.call, Moment.START)),
        ):
            if stronger in found:
                merged.setdefault(stronger, []).extend(protected)
                break
        else:
            merged.setdefault((before, after), []).extend(protected)
    return [Ordering(before, after, tuple(dict.fromkeys(protected))) for (before, after), protected in sorted(merged.items(), key=_by_call)]


def _by_call(item: tuple[tuple[PlanEvent, PlanEvent], list[Fluent]]) -> tuple[int, int, str, str]:
    (before, after), _ = item
    return before.call, after.call, before.moment.value, after.moment.value
