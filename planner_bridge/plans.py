"""Plan → PlanGraph: which event must wait for which, and for the sake of which facts.

The happenings of the plan are walked through in time. For every ground fluent we remember who
wrote it last and who has read it since; a reader waits for the last writer, a writer waits for
the last writer and for every reader since. That keeps exactly the orders that matter: the plan
may be executed in any order that keeps them, as soon as they allow.

An over-all condition is read from just after the start until just before the end. Fluents that
nothing changes, and counters that only a metric reads (`total-cost`), order nothing.

A constraint over the course of states is kept by the order in which its fluents change, and a
network of tasks by the order of everything. So all that has to do with one of these keeps the
order it has in the plan; and its time, if the constraint says more of times than how late is too late.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from math import inf
from typing import Final

from planner_bridge.envelopes import tightened
from planner_bridge.grounding import ground_action
from planner_bridge.model import Problem
from planner_bridge.plan import Plan, PlanStep
from planner_bridge.state import dynamic_names, initial_knowledge
from pnm.conditions import All, Condition, conjuncts, evaluate, fluents, names
from pnm.effects import Effects, ForEach, Set, When, read, written
from pnm.expressions import UNKNOWN, Fluent, State, Unknown, Value, expression_fluents
from pnm.plan_graph import ActionCall, GroundAction, Moment, Ordering, PlanEvent, PlanGraph
from pnm.trajectory import instances, names_in

_DIGITS: Final = 5
"""Times are compared at this many decimals: planners separate events by 0.001 and compute in floats."""

_TIMED, _END, _START, _INSTANT_END, _OPEN = range(5)
"""The order of what happens at one time."""

_NETWORK: Final[Fluent] = ("order of tasks",)
"""Stands for a fluent that everything changes."""


def plan_graph(problem: Problem, plan: Plan) -> PlanGraph:
    """Return the calls of the plan with the orderings that its causes demand."""
    causes = _causes(problem)
    calls = [ActionCall(index, ground_step(problem, plan, step), step.start) for index, step in enumerate(plan.steps)]
    for time, _, index, kind in sorted(_happenings(problem, plan)):
        if kind == _TIMED:
            causes.timed(time, problem.timed[index].changes)
        else:
            causes.happen(kind, calls[index], round(plan.steps[index].start + plan.steps[index].duration, _DIGITS), time)
    return tightened(causes.graph(calls, problem.goal))


def in_causal_order(problem: Problem, calls: tuple[ActionCall, ...], order: Iterable[PlanEvent]) -> PlanGraph:
    """Return the calls with the orderings that their causes demand, given one order of their events that works."""
    positions = {event: float(position) for position, event in enumerate(order)}
    causes = _causes(problem)
    for event, now in positions.items():
        call = calls[event.call]
        end = positions[PlanEvent(event.call, Moment.END)]
        if event.moment is Moment.START:
            causes.happen(_START, call, end, now)
            causes.happen(_OPEN, call, end, now)
        else:
            causes.happen(_END, call, end, now)
    return tightened(causes.graph(calls, problem.goal))


def ground_step(problem: Problem, plan: Plan, step: PlanStep) -> GroundAction:
    """Return the ground action of a step."""
    return ground_action(problem.domain.actions[step.action], step.arguments, step.duration if plan.temporal else None)


def _happenings(problem: Problem, plan: Plan) -> list[tuple[float, int, int, int]]:
    """Return (time, rank, index, kind) for everything that happens."""
    found = [(round(change.time, _DIGITS), _TIMED, index, _TIMED) for index, change in enumerate(problem.timed)]
    for index, step in enumerate(plan.steps):
        start = round(step.start if plan.temporal else float(index), _DIGITS)
        found.append((start, _START, index, _START))
        if problem.domain.actions[step.action].duration is None:
            continue
        end = round(step.start + step.duration, _DIGITS)
        found.append((end, _END if end > start else _INSTANT_END, index, _END))
        found.append((start, _OPEN if end > start else _START, index, _OPEN))
    return found


def _causes(problem: Problem) -> _Causes:
    state, relevant = initial_knowledge(problem), _relevant(problem)
    kept = [_Kept(_NETWORK)] if problem.network else []
    for constraint in (*problem.domain.constraints, *problem.constraints):
        for one in instances(constraint, state):
            mentioned = frozenset().union(*(fluents(condition, state) for condition in one.conditions))
            changing = frozenset(fluent for fluent in state.rests_on(mentioned) if fluent[0] in relevant)
            kept.append(_Kept((str(one)[1:-1],), changing, problem.is_timed and bool(one.times) and one.operator != "within"))
    return _Causes(state, relevant, tuple(kept))


def _relevant(problem: Problem) -> frozenset[str]:
    """Return the names that can change and that something besides the metric reads."""
    asked = set(names(problem.goal)) | {fluent[0] for change in problem.timed for fluent in change.changes}
    asked = asked.union(*map(names_in, (*problem.domain.constraints, *problem.constraints)))
    for schema in problem.domain.actions.values():
        for condition in (schema.precondition, schema.invariant, schema.end_condition):
            asked |= names(condition)
        for constraint in schema.duration or ():
            asked |= {fluent[0] for fluent in expression_fluents(constraint.bound)}
        asked |= set(_asked((*schema.start_effects, *schema.end_effects)))
    predicates = frozenset(problem.domain.predicates)
    return dynamic_names(problem) & (predicates | asked)


def _asked(effects: Effects) -> list[str]:
    """Return the names that effects read, a number's own increase left out."""
    found: list[str] = []
    for effect in effects:
        match effect:
            case Set(fluent, value, operation):
                found += [one[0] for one in expression_fluents(value)]
                if operation not in ("increase", "decrease"):
                    found.append(fluent[0])
            case When(condition, inner):
                found += [*names(condition), *_asked(inner)]
            case ForEach(_, inner):
                found += _asked(inner)
    return found


@dataclass(frozen=True, slots=True)
class _Reader:
    """Who has read a fluent: a point event, or an over-all condition until it closes."""

    call: int
    event: PlanEvent
    until: float


@dataclass(frozen=True, slots=True)
class _Kept:
    """What besides its causes depends on the order of a plan: a constraint, or a network of tasks."""

    stand_in: Fluent
    """Stands for a fluent that changes with each of the others, which gives them an order."""
    changing: frozenset[Fluent] | None = None
    """None for whatever happens."""
    timed: bool = False
    """It also depends on the times."""


@dataclass
class _Causes:
    """Last writers, readers since, and the orderings found so far."""

    state: State
    relevant: frozenset[str]
    kept: tuple[_Kept, ...] = ()
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
        self.changed_at.update(dict.fromkeys(changed, time))
        after = _Only(self.state, changed)
        for fluent in changed:
            for reader in self.readers.get(fluent, ()):
                action = self.actions[reader.call]
                if action.duration is not None and evaluate(All((action.invariant, action.end_condition)), after) is False:
                    self.deadlines.setdefault(reader.call, time)

    def happen(self, kind: int, called: ActionCall, end: float, now: float) -> None:
        """Note what one happening reads and writes."""
        call, action = called.index, called.action
        self.actions[call] = action
        start_event, end_event = PlanEvent(call, Moment.START), PlanEvent(call, Moment.END)
        match kind:
            case _ if action.duration is None:
                if kind != _START:
                    return
                reads = fluents(action.precondition, self.state) | read(action.end_effects, self.state)
                self._point(start_event, end_event, reads, written(action.end_effects, self.state), now)
            case k if k == _START:
                reads = fluents(action.precondition, self.state) | read(action.start_effects, self.state)
                self._point(start_event, start_event, reads, written(action.start_effects, self.state), now)
            case k if k == _OPEN:
                for fluent in self._only(fluents(action.invariant, self.state)):
                    self._after_writer(fluent, start_event)
                    self.readers.setdefault(fluent, []).append(_Reader(call, end_event, end))
                for part in conjuncts(action.invariant):
                    group = frozenset(self._only(fluents(part, self.state)))
                    if len(group) > 1:
                        self.watched.append((call, group, end))
            case k if k == _END:
                mine = (fluent for fluent in written(action.start_effects, self.state) if self.writer.get(fluent) == start_event)
                self.lasting[call] = frozenset(mine)
                reads = fluents(action.end_condition, self.state) | read(action.end_effects, self.state)
                self._point(end_event, end_event, reads, written(action.end_effects, self.state), now)

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
        return PlanGraph(told, tuple(_strongest(self.orderings)), goal)


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
