"""A machine as it is executed: over integers, made once and shared by its runs.

Blocks of one shape share what is known of their transitions and places; only what a block has for itself, such as the condition of its
call, is worked out for each. Both when it is first asked for, and kept.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Final
from weakref import WeakKeyDictionary

from pnm.core.execution.call_data import ClosedCall, closed_call, reads_of_guard
from pnm.core.logic.conditions import CompiledCondition, compiled
from pnm.core.logic.expressions import Fluent
from pnm.core.logic.rules import Reads, Rules
from pnm.core.machine.blocks import MachineBlocks, PlacedStep, rules_by_number
from pnm.core.machine.guards import (
    Accepts,
    After,
    Always,
    Due,
    Ends,
    Guard,
    Opener,
)
from pnm.core.machine.machine import CallOutcome, OnFailure, PetriNetMachine, Rule
from pnm.core.machine.requests import OutcomeKind, TransitionAction
from pnm.core.machine.step_block import BlockTemplate
from pnm.core.net.block_net import NumberedArcs, Placed, whole
from pnm.core.net.firing_engine import CompiledNet
from pnm.core.net.no_collection import no_collection
from pnm.core.net.when_asked import WhenAsked


@dataclass(frozen=True, slots=True)
class Firing:
    """A transition of a shape, with all that its firing brings about; places by their codes, see `Placed.all_at`."""

    number: int
    """Within the block."""
    rule: Rule
    """Of its kind: the step that it says it is about may be another, and so may be the guard where every block has its own."""
    guard: Guard | None
    """None where every block has its own."""
    limit: float | None
    """The seconds after which it opens, if that is all that its guard asks for."""
    step: int | None
    """The number of its step, where that does not follow from its block."""
    call: int | None
    """The same if the step is a call."""
    inputs: tuple[int, ...]
    decided: tuple[int, ...]
    """The places that it marks and at which something is decided."""
    move: tuple[int, int] | None
    """If it takes one token and puts one, where no transition of the block counts tokens: its places."""
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
    action: TransitionAction | None
    """What its firing does about the request of its call."""
    outcome: CallOutcome | None
    """What it means for the result of its call."""
    tells: bool
    """Whether it says more about its call than that: what hinders it, or that it is not needed or given up."""
    acts: bool
    """Whether it does more than to move tokens and to set the outcome of its call."""
    matters: bool
    """Whether it matters to more than its call: to resources, to whether the run is ending, to those who are told."""


@dataclass(frozen=True)
class Decision:
    """What is decided at a place of a shape."""

    numbers: tuple[int, ...]
    """The transitions that are decided on there, in their order, by number within the block."""
    made: Mapping[int, Firing]
    """All transitions, by number, each made when it is asked for."""
    staying: tuple[Firing, ...]
    """Those that may open although the run is not ending, stopped or paused."""
    passage: Firing | None
    """The only transition, if it only has to be enabled and does nothing but pass on tokens."""
    limit: Firing | None
    """If nothing is waited for there but reports, and those only for some seconds: the transition that opens after them."""
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


class Shape:
    """A shape of blocks: they have the same template, and their ports stand for as many places. What holds of one holds of all.

    The mutable state is what was worked out so far, of one of them.
    """

    def __init__(self, index: MachineIndex, block: Placed, step: int | None) -> None:
        self._index, self._block, self._step = index, block, step
        # worked out so far
        self.firings: Final = WhenAsked(self._firing)
        """The transitions, by number within the block."""
        self.decisions: Final = WhenAsked(self._decision)
        """What is decided at places, by their codes."""
        self.opened: Final = WhenAsked(self._opened)
        """The transitions of the call that the end of its request in a way opens, or its acceptance."""

    def _firing(self, number: int) -> Firing:
        index, arcs, block = self._index, self._index.arcs, self._block
        transition, template = block.transition + number, block.template
        is_alone = not isinstance(block, PlacedStep)
        rule = index.by_number.rule(transition) if is_alone else index.by_number.like(transition)
        taken, given = arcs.inputs(transition), arcs.outputs(transition)
        inputs, outputs = (tuple([code for code, _ in coded[number]]) for coded in (template.inputs, template.outputs))
        into, out_of = ([place for place, _ in some] for some in (taken, given))
        step = rule.call if is_alone else self._step
        is_call = index.is_call(step)
        fails = tuple([code for code in outputs if not index.failures.keys().isdisjoint(block.all_at([code]))])
        takes = not index.resources.isdisjoint(into) and rule.action is not TransitionAction.ADOPT
        gives, turns = not index.resources.isdisjoint(out_of), bool(fails) or not index.restarts.isdisjoint((*into, *out_of))
        tells = rule.cause is not None or rule.gives_up or rule.outcome is CallOutcome.ALREADY_TRUE
        # whether a place behind a port is counted is another matter for every block
        is_move = [weight for _, weight in (*taken, *given)] == [1, 1] and len(taken) == 1
        is_move = is_move and not index.counted[into[0]] and not (outputs[0] >= 0 and index.counted[out_of[0]])
        return Firing(
            number,
            rule,
            guard := rule.guard if is_alone or index.by_number.is_shared(transition) else None,
            guard.seconds if isinstance(guard, After) else None,
            step if is_alone else None,
            step if is_alone and is_call else None,
            inputs,
            tuple([code for code in outputs if index.records.isdisjoint(block.all_at([code]))]),
            (inputs[0], outputs[0]) if is_move else None,
            fails,
            takes=takes,
            gives=gives,
            counts=index.unmarked[transition] > 0,
            guarded=type(rule.guard),
            is_moment=rule.guard.opened_by is Opener.TIME,
            turns=turns,
            action=rule.action,
            outcome=rule.outcome if is_call else None,
            tells=tells,
            acts=bool(takes or gives or turns or tells or rule.action or rule.outcome is CallOutcome.SUCCEEDED),
            matters=takes or gives or turns or tells or rule.action is TransitionAction.ADOPT,
        )

    def _decision(self, code: int) -> Decision:
        like, first = self._index.by_number.like, self._block.transition
        guards = {number: like(first + number).guard for number, _ in self._block.template.consumers[code]}
        by_guard = [one for one, guard in guards.items() if guard.opened_by is not Opener.REPORT]
        knows = any(guards[one].opened_by is Opener.KNOWLEDGE for one in by_guard)
        staying = tuple([self.firings[one] for one in by_guard if guards[one].opened_by is not Opener.ENDING])
        only, count = staying[0] if len(staying) == 1 else None, len(guards)
        passage = only if only and count == 1 and only.guarded is Always and not only.acts else None
        limit = only if only and only.guarded is After and not (only.counts or only.takes) else None
        return Decision(tuple(by_guard), self.firings, staying, passage, limit, len(by_guard) < count, len(staying) < count, knows)

    def _opened(self, kind: OutcomeKind | None) -> tuple[Firing, ...]:
        assert self._step is not None, "only calls have requests"
        reported, first = self._index.by_number.reported(self._step), self._block.transition
        return tuple([self.firings[one - first] for one, rule in reported if _admits(rule, kind)])


@dataclass(frozen=True, slots=True)
class Site(Placed):
    """A block as it is executed."""

    shape: Shape
    step: int | None
    """The number of its step; None for the frame, and for a net that is one block."""
    call: int | None
    """The same if the step is a call."""

    def arcs_of(self, firing: Firing) -> tuple[NumberedArcs, NumberedArcs]:
        """Return what a transition takes from places, and what it gives to places."""
        return self.arcs(self.template.inputs[firing.number]), self.arcs(self.template.outputs[firing.number])

    def step_of(self, firing: Firing) -> int | None:
        """Return the number of the step that a transition belongs to."""
        return firing.step if self.step is None else self.step


class MachineIndex:
    """Places, transitions and calls of a machine.

    The mutable state is what was worked out so far.
    """

    def __init__(self, machine: PetriNetMachine) -> None:
        net, self._calls, self._places = machine.net, machine.plan.calls, machine.net.places
        self.arcs, self.by_number = net.arcs_by_number, rules_by_number(machine)
        self.unmarked, self.counted = machine.compiled.unmarked, machine.compiled.counted
        self.settling = net.numbered(machine.settling_places)
        self.failures = net.numbered(machine.failure_places)
        self.restarts, self.resources = (frozenset(net.numbered(some)) for some in (machine.restart_places, machine.resource_places))
        self.records = self.resources.union(self.failures, self.restarts, net.numbers(machine.budget_places))
        """Places at which nothing is decided."""
        self.alive = tuple(net.numbers(machine.alive_places))
        self.goal, self.failed = (self._places.index(place) for place in (machine.goal_place, machine.failed_place))
        self.on_failure: OnFailure = machine.on_failure
        by_number = self.by_number
        if isinstance(by_number, MachineBlocks) and by_number is self.arcs:
            sites = self._sited(by_number.placed)
            of_calls = {site.call: site for site in sites}
            self.of_calls = [of_calls[call] for call in range(len(self._calls))]
            """The blocks of the calls."""
        else:  # the net is one block, which is seen as that of each call
            block = whole(net)
            sites = self._sited([block])
            self.of_calls = [replace(sites[0], shape=Shape(self, block, call)) for call in range(len(self._calls))]
        self.sites: Final = sites[:1] * len(self._places)
        """For every place, the block that decides there."""
        self.codes: Final = [0] * len(self._places)
        """For every place, its code in that block."""
        self._spread(sites)
        # worked out so far
        self.rules: Final = WhenAsked(self.by_number.rule)
        """The rules of transitions."""
        self.names: Final = WhenAsked(net.transitions.__getitem__)
        """The names of transitions."""
        self.conditions: Final = WhenAsked(self._condition)
        """The conditions that guards of transitions ask for, where they are the same for every run."""
        self.limits: Final = WhenAsked(self._limit)
        """The seconds after which transitions open."""
        self.since: Final = WhenAsked(self._since)
        """The places from whose marking guards of transitions count, and the seconds."""
        self.reads: Final[dict[Rules, WhenAsked[int, Reads]]] = WhenAsked(lambda rules: WhenAsked(partial(self._reads_at, rules)))
        """What knowledge is read to decide at places of a run, by the rules of its world."""
        self.closed: Final = WhenAsked(self._closed)
        """What of calls does not depend on knowledge."""

    def is_call(self, step: int | None) -> bool:
        """Return whether a step is a call."""
        return step is not None and step < len(self._calls)

    def decision(self, place: int) -> Decision:
        """Return what is decided at a place."""
        return self.sites[place].shape.decisions[self.codes[place]]

    def guard(self, site: Site, firing: Firing) -> Guard:
        """Return the guard of a transition."""
        return self.rules[site.transition + firing.number].guard if firing.guard is None else firing.guard

    def _sited(self, blocks: Sequence[Placed]) -> list[Site]:
        shapes: dict[object, Shape] = {}
        sites: list[Site] = []
        for block in blocks:
            key, step = (block.template, *map(len, block.ports)), _step_of(block)
            if (shape := shapes.get(key)) is None:
                shape = shapes[key] = Shape(self, block, step)
            call = step if self.is_call(step) else None
            sites.append(Site(block.template, block.title, block.place, block.transition, block.ports, shape, step, call))
        return sites

    def _spread(self, sites: Sequence[Site]) -> None:
        """Note which site every place belongs to."""
        for site in sites:
            count = len(site.template.places)
            self.sites[site.place : site.place + count] = [site] * count
            self.codes[site.place : site.place + count] = range(count)
        # What is decided at a place between blocks, or at one of the frame, is decided by the one block that takes from there.
        for site in sites:
            for code in site.template.reading:
                for place in site.ports[~code]:
                    self.sites[place], self.codes[place] = site, code

    # --- what each block has for itself -------------------------------------------------------

    def _reads_at(self, rules: Rules, place: int) -> Reads:
        read: set[Fluent | str] = set()
        for firing in self.decision(place).firings:
            reads = self._reads_for(self.sites[place], firing, rules)
            if reads is None:
                return None
            read |= reads
        return frozenset(read)

    def _reads_for(self, site: Site, firing: Firing, rules: Rules) -> Reads:
        """Return what the guard of a transition reads."""
        call = firing.call if site.call is None else site.call
        action = None if call is None else self._calls[call].action
        # Other runs may give back resources without anything being heard of it.
        return None if firing.takes else reads_of_guard(self.guard(site, firing), action, rules)

    def _closed(self, call: int) -> ClosedCall | None:
        return closed_call(self._calls[call])

    def _limit(self, transition: int) -> float:
        _, guard = self.by_number.asks(transition)
        assert isinstance(guard, After), "only a wait has a limit"
        return guard.seconds

    def _since(self, transition: int) -> tuple[tuple[int, float], ...]:
        guard = self.rules[transition].guard
        if not isinstance(guard, Due) or not guard.since:
            return ()
        names = {self._places[place]: place for place, _ in self.arcs.inputs(transition)}  # it counts from places that it takes from
        return tuple((names[place], delay) for place, delay in guard.since)

    def _condition(self, transition: int) -> CompiledCondition | None:
        step, guard = self.by_number.asks(transition)
        is_open = self.is_call(step) and self.closed[step or 0] is None
        return None if is_open or guard.asks is None else compiled(guard.asks)


# An index must not hold the net that it belongs to, or none would ever be forgotten.
_INDICES: Final[WeakKeyDictionary[CompiledNet, MachineIndex]] = WeakKeyDictionary()


def index_of(machine: PetriNetMachine) -> MachineIndex:
    """Return the index of a machine, which is made once."""
    found = _INDICES.get(machine.compiled)
    if found is None:
        found = _INDICES[machine.compiled] = MachineIndex(machine)
    return found


@no_collection()
def prepare(machine: PetriNetMachine) -> None:
    """Work out at once what every call that goes well needs; between firings, call by call, that takes twice as long."""
    index = index_of(machine)
    for call, site in enumerate(index.of_calls):
        index.closed[call]
        if isinstance(site.template, BlockTemplate):
            for number in site.template.checking:
                index.conditions[site.transition + number]
            for number in site.template.limiting:
                index.limits[site.transition + number]


def _step_of(block: Placed) -> int | None:
    return block.step.index if isinstance(block, PlacedStep) and block.step else None


def _admits(rule: Rule, kind: OutcomeKind | None) -> bool:
    """Return whether the end of a request in this way, or its acceptance, opens the guard of a rule of its call."""
    if kind is None:
        return isinstance(rule.guard, Accepts)
    return isinstance(rule.guard, Ends) and kind in rule.guard.kinds
