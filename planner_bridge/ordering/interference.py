"""Interference of plans: what a plan reads and writes, when it is expected to be done with that, and which plans may go on at once.

A plan *reads* the facts that its calls and its goal need, with the values that they must have. Two plans interfere when one may
write another value to a fluent that the other reads (as for actions in PDDL 2.1, section 8). That is conservative: a fact that a
plan makes true for itself counts like any other.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from math import inf
from typing import Final, Generic, TypeVar

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.guards import guarded, unused_name, with_guards
from planner_bridge.model.problem import Problem
from planner_bridge.model.progression import NotApplicable, Progression, snapshot
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import TRUE, Compare, Computed, Condition, Holds, Not, fluents, parts_of
from pnm.core.logic.domain import Declaration
from pnm.core.logic.effects import Effects, ForEach, OneOf, Set, TimedChange, When, possible_assignments, read
from pnm.core.logic.expressions import NOTHING, Constant, Environment, Fluent, State, Unknown, Value, bind, fluent_text
from pnm.core.machine.plan_graph import ActionCall, Moment, Ordering, PlanEvent, PlanGraph

NEVER: Final[Mapping[Fluent, float]] = {}
"""The time at which others are done with their needs, if nothing is known."""
SOON: Final = 0.01
"""Seconds from now at which something changes at the earliest, for planners that know nothing that changes at once."""
_ANYTHING: Final[Fluent] = ("",)
"""Stands for all fluents, where it is not known which are used."""

K = TypeVar("K")


@dataclass(frozen=True)
class ReadWriteSets:
    """The fluents that the rest of a plan reads and writes."""

    facts: Mapping[Fluent, frozenset[bool]] = field(default_factory=dict)
    """Facts that must be true, false, or each at some time."""
    reads: frozenset[Fluent] = frozenset()
    """Other fluents that are read, such as numbers: no other value will do."""
    writes: Mapping[Fluent, frozenset[bool | None]] = field(default_factory=dict)
    """For every fluent, the values that it may get: true, false, or, as None, another value."""

    @cached_property
    def used(self) -> frozenset[Fluent]:
        """All that is read or written."""
        return self.reads.union(self.facts, self.writes)

    @staticmethod
    def of_all(plans: Iterable[ReadWriteSets]) -> ReadWriteSets:
        """Return what several plans read and write together."""
        facts, writes, reads = dict[Fluent, frozenset[bool]](), dict[Fluent, frozenset[bool | None]](), set[Fluent]()
        for plan in plans:
            reads |= plan.reads
            for fluent, values in plan.facts.items():
                facts[fluent] = facts[fluent] | values if fluent in facts else values
            for fluent, given in plan.writes.items():
                writes[fluent] = writes[fluent] | given if fluent in writes else given
        return ReadWriteSets(facts, frozenset(reads), writes)

    def is_clear_of(self, other: ReadWriteSets) -> bool:
        """Return whether neither writes what the other uses: so it is for all parts of the two as well."""
        return self.used.isdisjoint(other.writes) and other.used.isdisjoint(self.writes)

    def disturbed_by(self, other: ReadWriteSets) -> Fluent | None:
        """Return a fluent that this plan reads and to which the other may write another value, if there is one."""
        for fluent, values in other.writes.items():
            if fluent in self.reads:
                return fluent
            if fluent in self.facts and any(value is None or (not value) in self.facts[fluent] for value in values):
                return fluent
        return None


_NOTHING: Final = ReadWriteSets()


class FootprintIndex(Generic[K]):
    """Finds those that may interfere with a plan by the fluents that they use and write, without a look at the others.

    The mutable state is what is noted of each; of some it is not known what they use.
    """

    def __init__(self) -> None:
        self._noted: dict[K, ReadWriteSets | None] = {}
        self._users: dict[Fluent, set[K]] = {}
        self._writers: dict[Fluent, set[K]] = {}

    def note(self, key: K, sets: ReadWriteSets | None) -> None:
        """Note what one uses and writes at most, in place of what was noted before; None if that is not known."""
        if key not in self._noted or self._noted[key] is not sets:
            self.forget(key)
            self._noted[key] = sets
            for users in self._entries(sets):
                users.add(key)

    def forget(self, key: K) -> None:
        """Forget one."""
        for users in self._entries(self._noted.pop(key, _NOTHING)):
            users.discard(key)

    def has_other(self, key: K) -> bool:
        """Return whether another one than this is noted."""
        return len(self._noted) > (key in self._noted)

    def near(self, sets: ReadWriteSets) -> set[K]:
        """Return all that use what these sets write, or write what they use, and those of which that is not known."""
        return self._users.get(_ANYTHING, set()).union(
            *(self._writers[fluent] for fluent in self._writers.keys() & sets.used),
            *(self._users[fluent] for fluent in self._users.keys() & sets.writes.keys()),
        )

    def _entries(self, sets: ReadWriteSets | None) -> Iterator[set[K]]:
        yield from (self._users.setdefault(fluent, set()) for fluent in ((_ANYTHING,) if sets is None else sets.used))
        yield from (self._writers.setdefault(fluent, set()) for fluent in (() if sets is None else sets.writes))


def interference(mine: ReadWriteSets, other: ReadWriteSets) -> str:
    """Return why the two plans cannot be executed concurrently; empty when they can."""
    if disturbed := other.disturbed_by(mine):
        return f"it would change {fluent_text(disturbed)}, which the other needs"
    if disturbed := mine.disturbed_by(other):
        return f"it needs {fluent_text(disturbed)}, which the other is going to change"
    return ""


def read_write_sets(calls: Iterable[ActionCall], goal: Condition, knowledge: KnowledgeBase) -> ReadWriteSets:
    """Return the fluents that these calls, some of which may be running, and the goal read and write."""
    facts: dict[Fluent, set[bool]] = {}
    reads: set[Fluent] = set()
    writes: dict[Fluent, set[bool | None]] = {}
    conditions, derived = [goal], knowledge.rules.derived
    for call in calls:
        action = call.action
        effects: Effects = action.possible_effects
        conditions += [action.invariant, action.end_condition]
        # A call that has begun has checked its precondition and made its start effects: only its end is still to come.
        if not call.under_way:
            conditions.append(action.precondition)
            effects = (*action.start_effects, *effects)
        written = _written(effects, knowledge)
        # An increase reads the fluent that it writes; increases by several plans do not disturb each other.
        reads |= knowledge.rests_on(read(effects, knowledge)) - written.keys()
        for fluent, values in written.items():
            writes.setdefault(fluent, set()).update(values)
    for fluent, needed in chain.from_iterable(_values_needed(condition, True, knowledge) for condition in conditions):
        if needed is None or fluent[0] in derived:  # another plan writes what a derived fact rests on, and never the derived fact itself
            reads |= knowledge.rests_on(frozenset({fluent}))
        else:
            facts.setdefault(fluent, set()).add(needed)
    return ReadWriteSets(
        {fluent: frozenset(values) for fluent, values in facts.items()},
        frozenset(reads),
        {fluent: frozenset(values) for fluent, values in writes.items()},
    )


def _values_needed(condition: Condition, value: bool, state: State, env: Environment = NOTHING) -> Iterator[tuple[Fluent, bool | None]]:
    """Yield the fluents of a condition, each with the truth value that helps to give the condition this value; None when that depends."""
    match condition:
        case Holds(fluent):
            yield bind(fluent, env), value
        case Compare() | Computed():
            yield from ((fluent, None) for fluent in fluents(condition, state, env))
        case _:  # any of several alternatives may be relied on
            for part, inner, truth in parts_of(condition, state, env, value)[0]:
                yield from _values_needed(part, truth, state, inner)


def _written(effects: Effects, state: State) -> dict[Fluent, set[bool | None]]:
    written: dict[Fluent, set[bool | None]] = {}
    for fluent, effect, _ in possible_assignments(effects, state):
        value = effect.value.value if isinstance(effect.value, Constant) else None
        written.setdefault(fluent, set()).add(value if isinstance(value, bool) else None)
    return written


def avoid_interference(problem: Problem, others: Iterable[ReadWriteSets], released: Mapping[Fluent, float] = NEVER) -> Problem:
    """Return a problem whose plans do not interfere with other plans, as far as PDDL can express that.

    Facts that others may change count as changed already, so that no plan relies on them; no action may change the facts
    that others read, before the seconds for which they are said to. Effects under quantifiers are ignored: whether a plan
    interferes has still to be checked.
    """
    for other in others:
        lost = {
            fluent
            for fluent, values in other.writes.items()
            if isinstance(problem.init.get(fluent), str) or (problem.init.get(fluent) is True and values & {False, None})
        }
        kept = {fluent: value for fluent, value in problem.init.items() if fluent not in lost}
        problem = _protect(replace(problem, init=kept), other, released)
    return problem


def optimistic_state(problem: Problem, under_way: Iterable[ActionCall]) -> Problem:
    """Return a problem that begins after these running calls, with every fact that may be true then.

    These are the facts that they make true when they succeed, and those that they had made false when they are undone.
    """
    init, world = dict(problem.init), initial_knowledge(problem)
    for call in under_way:
        begun, ended = (_written(effects, world) for effects in (call.action.start_effects, call.action.end_effects))
        # Numbers and computed values are left as they are: no optimistic value is known for them.
        for fluent in (fluent for fluent, values in (begun | ended).items() if None not in values):
            if_undone = False in begun[fluent] if fluent in begun else problem.init.get(fluent) is True
            init[fluent] = if_undone or True in ended.get(fluent, begun.get(fluent, ()))
    return replace(problem, init=init)


def _protect(problem: Problem, other: ReadWriteSets, released: Mapping[Fluent, float]) -> Problem:
    """Guard every action that gives a fact another value than the other plan reads."""
    domain, init, timed = problem.domain, dict(problem.init), [*problem.timed]
    predicates, actions = dict(domain.predicates), dict(domain.actions)
    for needed in (True, False):
        kept = [
            fluent for fluent, values in other.facts.items() if needed in values and (problem.init.get(fluent, False) is True) == needed
        ]
        for name in sorted({fluent[0] for fluent in kept} & domain.predicates.keys()):
            guard = unused_name(f"kept-{name}-{needed}".lower(), replace(domain, predicates=predicates))
            makers = [
                (action, _arguments_written(name, not needed, (*action.start_effects, *action.end_effects))) for action in actions.values()
            ]
            if any(made for _, made in makers):  # a guard that no action can violate would only make the problem larger
                predicates[guard] = Declaration(guard, domain.predicates[name].parameters)
                guards = {fluent: (guard, *fluent[1:]) for fluent in kept if fluent[0] == name}
                init |= dict.fromkeys(guards.values(), True)
                lifted = ((released[fluent], kept_fact) for fluent, kept_fact in guards.items() if fluent in released)
                timed += [TimedChange(max(time, SOON), {kept_fact: False}) for time, kept_fact in lifted]
            for action, made in makers:
                for arguments in made:
                    actions[action.name] = guarded(actions[action.name], Not(Holds((guard, *arguments))))
    return replace(problem, domain=with_guards(domain, predicates, actions), init=init, timed=tuple(timed))


def _arguments_written(predicate: str, value: bool, effects: Effects) -> list[tuple[str, ...]]:
    """Return the arguments for which effects may give the predicate this value, whatever their conditions."""
    arguments: list[tuple[str, ...]] = []
    for effect in effects:
        match effect:
            case Set(fluent, Constant(new)) if fluent[0] == predicate and new is value:
                arguments.append(fluent[1:])
            case When() | OneOf():
                arguments += _arguments_written(predicate, value, effect.effects)
            case Set() | ForEach():
                pass
    return list(dict.fromkeys(arguments))


# --- forecasts ------------------------------------------------------------------------------------
# Forecast of a plan that is being carried out: when it is expected to be done with what it needs, and what it leaves behind then.
#
# With it a planner can weigh waiting for a busy robot: what others need is not there at first, and comes by itself at a time.
# Forecasts are for decisions only, never for what is believed: nothing begins before what it needs is there.


@dataclass(frozen=True)
class Forecast:
    """The forecast of a plan that is being carried out.

    Args:
        needed: what the rest of it reads and writes.
        released: for these fluents, the time at which it is done with them; nothing is known about others.
        values: what it leaves behind in them.
        until: the time after which it is another one though no call has begun or ended: then a call is late.
    """

    needed: ReadWriteSets
    released: Mapping[Fluent, float] = field(default_factory=dict)
    values: Mapping[Fluent, Value] = field(default_factory=dict)
    until: float = -inf

    @cached_property
    def first(self) -> float:
        """The time at which it is done with something."""
        return min(self.released.values(), default=inf)


def forecast(plan: PlanGraph, events: Sequence[PlanEvent], left: Mapping[int, float], state: KnowledgeBase, now: float = 0.0) -> Forecast:
    """Return the forecast of a plan from its events to come, in an order it allows, and the seconds left of calls under way."""
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
        time = max((times.get(ordering.before, now) + ordering.delay for ordering in before.get(event, ())), default=now)
        if event.moment is Moment.END:
            began = times.get(PlanEvent(event.call, Moment.START), now)
            time = max(time, now + left[event.call] if event.call in left else began + (action.duration or 0.0))
        times[event] = time
        try:
            simulation.advance([(event, action)])
        except NotApplicable:
            return Forecast(needed)  # the plan will have to be replaced
    released = dict.fromkeys(_read(read_write_sets((), plan.goal, state)), max(times.values(), default=now))
    for call in calls:
        used = read_write_sets([call], TRUE, state)
        for fluent in _read(used) | used.writes.keys():
            released[fluent] = max(released.get(fluent, now), times[PlanEvent(call.index, Moment.END)])
    values = {fluent: simulation.state.value(fluent) for fluent in needed.writes}
    known = {fluent: value for fluent, value in values.items() if value is not None and not isinstance(value, Unknown)}
    return Forecast(needed, released, known, now + min(left.values(), default=0.0))


def with_forecasts(problem: Problem, forecasts: Sequence[Forecast], now: float = 0.0) -> Problem:
    """Return a problem in which what other plans need is not to be had before they are expected to be done with it."""
    released, kept, changes = dict[Fluent, float](), set[Fluent](), list[TimedChange]()
    for other in forecasts:
        for fluent in other.needed.facts:
            released[fluent] = max(released.get(fluent, 0.0), other.released.get(fluent, now) - now)
        kept |= other.needed.facts.keys() - other.released.keys()
        changes += [TimedChange(max(other.released[fluent] - now, SOON), {fluent: value}) for fluent, value in other.values.items()]
    problem = avoid_interference(
        problem,
        [ReadWriteSets.of_all(other.needed for other in forecasts)],
        {fluent: time for fluent, time in released.items() if fluent not in kept},
    )
    return replace(problem, timed=tuple(sorted((*problem.timed, *changes), key=lambda change: change.time)))


def awaited(mine: ReadWriteSets, other: Forecast) -> tuple[Fluent, float] | None:
    """Return the fluents that a plan has to wait for because another one changes or reads them, with the time; None for nothing."""
    if mine.is_clear_of(other.needed):
        return None
    shared = (_read(mine) & other.needed.writes.keys()) | (_read(other.needed) & mine.writes.keys())
    last = max(shared & other.released.keys(), key=lambda fluent: (other.released[fluent], fluent), default=None)
    return None if last is None else (last, other.released[last])


def _read(sets: ReadWriteSets) -> frozenset[Fluent]:
    return sets.reads | sets.facts.keys()
