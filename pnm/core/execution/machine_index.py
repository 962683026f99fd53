"""A machine as it is executed: over integers, made once and shared by its runs.

Whatever a run asks about a place, a transition or a call is worked out when it is first asked for, and kept.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final
from weakref import WeakKeyDictionary

from pnm.core.execution.closed_call import ClosedCall, closed_call
from pnm.core.logic.compiled_condition import TruthIn, compiled
from pnm.core.logic.conditions import All, data_in
from pnm.core.logic.effects import Set, every_effect
from pnm.core.logic.expressions import Fluent
from pnm.core.logic.rules import NO_RULES, Reads, read_by, reads_of
from pnm.core.machine.blocks import rules_by_number
from pnm.core.machine.machine import (
    Accepts,
    After,
    AlreadyTrue,
    Always,
    CallOutcome,
    CancelAsked,
    ConditionFalse,
    ConditionTrue,
    ConditionUnknown,
    DataMissing,
    Due,
    EffectsMissing,
    EffectsSeen,
    Ending,
    Ends,
    Failing,
    InvariantFalse,
    OnFailure,
    PauseAsked,
    PetriNetMachine,
    Rule,
    TransitionAction,
    Withheld,
)
from pnm.core.machine.requests import OutcomeKind
from pnm.core.net.firing_engine import CompiledNet
from pnm.core.net.when_asked import WhenAsked

_KNOWING: Final = (ConditionTrue, ConditionFalse, ConditionUnknown, InvariantFalse, AlreadyTrue, DataMissing, EffectsSeen, EffectsMissing)
"""Guards whose answer may change when facts change."""
_LEAVING: Final = (Ending, Failing, CancelAsked, PauseAsked)
"""Guards that open only when a run is ending, stopped or paused."""
_MOMENTS: Final = (After, Due)


@dataclass(frozen=True, slots=True)
class CompiledCondition:
    """A condition that is the same for every run, as a function."""

    truth: TruthIn
    reads_variables: bool
    """Whether it reads anything but facts and numbers."""


@dataclass(frozen=True, slots=True)
class Firing:
    """A transition, with all that its firing brings about."""

    number: int
    name: str
    rule: Rule
    call: int | None
    """The number of its call; None for one of the frame, or of a step that is no call."""
    inputs: tuple[int, ...]
    outputs: tuple[int, ...]
    decided: tuple[int, ...]
    """The places that it marks and at which something is decided."""
    step: tuple[int, int] | None
    """If it takes one token and puts one, where nobody counts tokens: its places."""
    fails: tuple[int, ...]
    """The failure places that it marks."""
    takes: bool
    """Whether it takes resources; what is taken over has its own."""
    gives: bool
    """Whether it gives resources back."""
    counts: bool
    """Whether it takes more than one token, and is therefore enabled only if the engine misses none."""
    guarded: type
    """The kind of its guard."""
    is_moment: bool
    """Whether time alone opens it."""
    turns: bool
    """Whether the run may be ending after it, or not be ending any more."""
    outcome: CallOutcome | None
    """What it means for the result of its call."""
    tells: bool
    """Whether it says more about its call than that: what hinders it, or that it is not needed or given up."""
    acts: bool
    """Whether it does more than to move tokens and to set the outcome of its call."""
    matters: bool
    """Whether it matters to more than its call: to resources, to whether the run is ending, to those who are told."""
    condition: CompiledCondition | None
    """The condition of its guard, where that is the same for every run."""
    since: tuple[tuple[int, float], ...]
    """The places from whose marking its guard counts, and the seconds."""


@dataclass(frozen=True)
class Decision:
    """What is decided at a place."""

    numbers: tuple[int, ...]
    """The transitions that are decided on there, in their order, by number."""
    made: Mapping[int, Firing]
    """All transitions, by number, each made when it is asked for."""
    staying: tuple[Firing, ...]
    """Those that may open although the run is not ending, stopped or paused."""
    passage: Firing | None
    """The only transition, if it only has to be enabled and does nothing but pass on tokens."""
    limit: float | None
    """If nothing is waited for there but reports, and those only for some seconds: how many."""
    awaits: bool
    """Whether a report is waited for there."""
    stays: bool
    """Whether a report is waited for there, or the end of the run."""
    listens: bool
    """Whether the decision may change when facts change."""

    @cached_property
    def firings(self) -> tuple[Firing, ...]:
        """The transitions that are decided on there; most are of no use before a run comes to its end."""
        return tuple([self.made[number] for number in self.numbers])


class MachineIndex:
    """Places, transitions and calls of a machine.

    The mutable state is what was worked out so far.
    """

    def __init__(self, machine: PetriNetMachine) -> None:
        net, self._rules = machine.compiled, rules_by_number(machine)
        self._inputs, self._outputs, self._consumers, self._names = net.inputs, net.outputs, net.consumers, net.transitions
        self._changes = net.changes
        self._places = net.net.places
        self._calls = calls = machine.plan.calls
        numbered = net.net.numbered
        self.settling = numbered(machine.settling_places)
        self.failures = numbered(machine.failure_places)
        self.restarts, self.resources = frozenset(numbered(machine.restart_places)), frozenset(numbered(machine.resource_places))
        self.records = self.resources.union(self.failures, self.restarts, net.net.numbers(machine.budget_places))
        """Places at which nothing is decided."""
        self.alive = tuple(net.net.numbers(machine.alive_places))
        self.goal, self.failed = (self._places.index(place) for place in (machine.goal_place, machine.failed_place))
        self.on_failure: OnFailure = machine.on_failure
        self.rules_of_facts = machine.plan.rules
        """What derives the facts that its conditions mention."""
        # worked out so far
        self.firings: Final = WhenAsked(self._firing)
        """The transitions."""
        self.places: Final = WhenAsked(self._decision)
        """What is decided at places."""
        self.reads: Final = WhenAsked(self._reads_at)
        """What knowledge is read to decide at places."""
        self.opened: Final = WhenAsked(self._opened)
        """The transitions of a call that are opened by the end of its request in a way, or by its acceptance, each with its place."""
        self.closed: Final[WhenAsked[int, ClosedCall | None]] = WhenAsked(lambda call: closed_call(calls[call]))
        """What of calls does not depend on knowledge."""

    def _decision(self, place: int) -> Decision:
        guards = {one: self._rules.like(one).guard for one, _ in self._consumers[place]}
        by_guard = [one for one, guard in guards.items() if not isinstance(guard, Accepts | Ends)]
        knows = any(isinstance(guards[one], _KNOWING) for one in by_guard)
        staying = tuple([self.firings[one] for one in by_guard if not isinstance(guards[one], _LEAVING)])
        is_passage = len(self._consumers[place]) == len(staying) == 1 and staying[0].guarded is Always and not staying[0].acts
        passage, count = staying[0] if is_passage else None, len(self._consumers[place])
        guard = staying[0].rule.guard if len(staying) == 1 and not (staying[0].counts or staying[0].takes) else None
        limit = guard.seconds if isinstance(guard, After) else None
        return Decision(tuple(by_guard), self.firings, staying, passage, limit, len(by_guard) < count, len(staying) < count, knows)

    def _reads_at(self, place: int) -> Reads:
        read: set[Fluent | str] = set()
        for firing in self.places[place].firings:
            reads = self._reads_for(firing)
            if reads is None:
                return None
            read |= reads
        return frozenset(read)

    def _reads_for(self, firing: Firing) -> Reads:
        """Return what the guard of a transition reads."""
        action = None if firing.call is None else self._calls[firing.call].action
        # Other runs may give back resources, and servers say which goal fields they have, without anything being heard of it; and
        # what the parameters are of a call that is not closed depends on anything.
        if firing.takes or (firing.call is not None and self.closed[firing.call] is None):
            return None
        match firing.rule.guard:
            case ConditionTrue(condition) | ConditionFalse(condition) | ConditionUnknown(condition) | InvariantFalse(condition):
                return read_by(condition, self.rules_of_facts)
            case AlreadyTrue() | DataMissing() | Withheld():
                return None
            case EffectsSeen() | EffectsMissing() if action is not None:
                checked = read_by(All((action.end_condition, action.expected)), self.rules_of_facts)
                fluents = [one.fluent for one in every_effect((*action.start_effects, *action.end_effects)) if isinstance(one, Set)]
                return None if checked is None else checked.union(*(reads_of(fluent, NO_RULES) for fluent in fluents))
            case _:
                return frozenset()

    def _opened(self, key: tuple[int, OutcomeKind | None]) -> tuple[tuple[int, int], ...]:
        call, kind = key
        return tuple([(one, self._inputs[one][0][0]) for one, rule in self._rules.reported(call) if _admits(rule, kind)])

    def _firing(self, transition: int) -> Firing:
        rule, taken = self._rules.rule(transition), self._inputs[transition]
        inputs = tuple([place for place, _ in taken])
        outputs = tuple([place for place, _ in self._outputs[transition]])
        fails = tuple([place for place in outputs if place in self.failures])
        is_call = rule.call is not None and rule.call < len(self._calls)
        takes = not self.resources.isdisjoint(inputs) and rule.action is not TransitionAction.ADOPT
        gives, turns = not self.resources.isdisjoint(outputs), bool(fails) or not self.restarts.isdisjoint((*inputs, *outputs))
        moved, counted = self._changes[transition]
        is_step = not counted and [change for _, change in moved] == [-1, 1]
        tells = rule.cause is not None or rule.gives_up or rule.outcome is CallOutcome.ALREADY_TRUE
        return Firing(
            transition,
            self._names[transition],
            rule,
            rule.call if is_call else None,
            inputs,
            outputs,
            tuple([place for place in outputs if place not in self.records]),
            (inputs[0], outputs[0]) if is_step else None,
            fails,
            takes=takes,
            gives=gives,
            counts=len(taken) != 1 or taken[0][1] != 1,
            guarded=type(rule.guard),
            is_moment=isinstance(rule.guard, _MOMENTS),
            turns=turns,
            outcome=rule.outcome if is_call else None,
            tells=tells,
            acts=bool(takes or gives or turns or tells or rule.action or rule.outcome is CallOutcome.SUCCEEDED),
            matters=takes or gives or turns or tells or rule.action is TransitionAction.ADOPT,
            condition=self._condition(rule, is_call=is_call),
            since=self._since(rule.guard, inputs) if isinstance(rule.guard, Due) else (),
        )

    def _since(self, guard: Due, inputs: tuple[int, ...]) -> tuple[tuple[int, float], ...]:
        names = {self._places[place]: place for place in inputs} if guard.since else {}  # it counts from places that it takes from
        return tuple((names[place], delay) for place, delay in guard.since)

    def _condition(self, rule: Rule, *, is_call: bool) -> CompiledCondition | None:
        if not isinstance(rule.guard, ConditionTrue | ConditionFalse) or (is_call and self.closed[rule.call or 0] is None):
            return None
        return CompiledCondition(compiled(rule.guard.condition), any(True for _ in data_in(rule.guard.condition)))


# An index must not hold the net that it belongs to, or none would ever be forgotten.
_INDICES: Final[WeakKeyDictionary[CompiledNet, MachineIndex]] = WeakKeyDictionary()


def index_of(machine: PetriNetMachine) -> MachineIndex:
    """Return the index of a machine, which is made once."""
    found = _INDICES.get(machine.compiled)
    if found is None:
        found = _INDICES[machine.compiled] = MachineIndex(machine)
    return found


def _admits(rule: Rule, kind: OutcomeKind | None) -> bool:
    """Return whether the end of a request in this way, or its acceptance, opens the guard of a rule of its call."""
    if kind is None:
        return isinstance(rule.guard, Accepts)
    return isinstance(rule.guard, Ends) and kind in rule.guard.kinds
