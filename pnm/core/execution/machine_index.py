"""A machine as it is executed: over integers, made once and shared by its runs.

Blocks of one shape share what is known of their transitions and places; only what a block has for itself, such as the condition of its
call, is worked out for each. Both when it is first asked for, and kept.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Final
from weakref import WeakKeyDictionary, proxy

from pnm.core.execution.call_data import ClosedCall, closed_call, reads_of_guard
from pnm.core.logic.compiled import CompiledCondition, compiled
from pnm.core.logic.expressions import Fluent
from pnm.core.logic.rules import Reads, Rules
from pnm.core.machine.guards import Accepts, After, Always, Due, Ends, Guard, Opener, Rule
from pnm.core.machine.machine import MachineBlocks, OnFailure, PetriNetMachine, PlacedStep
from pnm.core.machine.requests import CallOutcome, OutcomeKind, TransitionAction
from pnm.core.machine.step_block import OWN, BlockTemplate
from pnm.core.net.block_net import NumberedArcs, Placed, WhenAsked
from pnm.core.net.no_collection import no_collection


@dataclass(frozen=True, slots=True)
class Firing:
    """A transition of a shape, with all that its firing brings about; places by their codes, see `Placed.all_at`."""

    number: int
    """Within the block."""
    rule: Rule
    """Of its kind: the step that it says it is about may be another, and so may be the guard where every block has its own."""
    guard: Guard | None
    """None where every block has its own."""
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
    turns: bool
    """Whether the run may be ending after it, or not be ending any more."""
    action: TransitionAction | None
    """The effect of its firing on the request of its call."""
    outcome: CallOutcome | None
    """Its meaning for the result of its call."""
    tells: bool
    """Whether it says more about its call than that: what hinders it, or that it is not needed or given up."""
    acts: bool
    """Whether it does more than to move tokens and to set the outcome of its call."""
    matters: bool
    """Whether it matters to more than its call: to resources, to whether the run is ending, to those who are told."""


@dataclass(frozen=True)
class Decision:
    """The decisions at a place of a shape."""

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

    def __init__(self, index: MachineIndex, block: PlacedStep, call: int) -> None:
        self._index: MachineIndex = proxy(index)  # which has this shape
        self._block, self._call = block, call
        # worked out so far
        self.firings: Final = WhenAsked(self, Shape._firing)
        """The transitions, by number within the block."""
        self.decisions: Final = WhenAsked(self, Shape._decision)
        """The decisions at places, by their codes."""
        self.opened: Final = WhenAsked(self, Shape._opened)
        """The transitions of the call that the end of its request in a way opens, or its acceptance."""

    def _firing(self, number: int) -> Firing:
        index, block, template = self._index, self._block, self._block.template
        rule, is_own = template.kinds[number], block.step is None
        taken, given = block.arcs(template.inputs[number]), block.arcs(template.outputs[number])
        inputs, outputs = (tuple([code for code, _ in coded[number]]) for coded in (template.inputs, template.outputs))
        into, out_of = ([place for place, _ in some] for some in (taken, given))
        step = block.step_of(number)
        is_call = index.is_call(step)
        fails = tuple([code for code in outputs if not index.failures.keys().isdisjoint(block.all_at([code]))])
        takes = not index.resources.keys().isdisjoint(into) and rule.action is not TransitionAction.ADOPT
        gives = not index.resources.keys().isdisjoint(out_of)
        turns = bool(fails) or not index.restarts.keys().isdisjoint((*into, *out_of))
        tells = rule.cause is not None or rule.gives_up or rule.outcome is CallOutcome.ALREADY_TRUE
        # whether a place behind a port is counted is another matter for every block
        is_move = [weight for _, weight in (*taken, *given)] == [1, 1] and len(taken) == 1
        is_move = is_move and not index.blocks.counted[into[0]] and not (outputs[0] >= 0 and index.blocks.counted[out_of[0]])
        return Firing(
            number,
            rule,
            rule.guard if isinstance(template.rules[number], Rule) else None,
            step if is_own else None,
            step if is_own and is_call else None,
            inputs,
            tuple([code for code in outputs if index.records.isdisjoint(block.all_at([code]))]),
            (inputs[0], outputs[0]) if is_move else None,
            fails,
            takes=takes,
            gives=gives,
            counts=index.blocks.unmarked[block.transition + number] > 0,
            guarded=type(rule.guard),
            turns=turns,
            action=rule.action,
            outcome=rule.outcome if is_call else None,
            tells=tells,
            acts=bool(takes or gives or turns or tells or rule.action or rule.outcome is CallOutcome.SUCCEEDED),
            matters=takes or gives or turns or tells or rule.action is TransitionAction.ADOPT,
        )

    def _decision(self, code: int) -> Decision:
        template = self._block.template
        guards = {number: template.kinds[number].guard for number, _ in template.consumers[code]}
        by_guard = [one for one, guard in guards.items() if guard.opened_by is not Opener.REPORT]
        knows = any(guards[one].opened_by is Opener.KNOWLEDGE for one in by_guard)
        staying = tuple([self.firings[one] for one in by_guard if guards[one].opened_by is not Opener.ENDING])
        only, count = staying[0] if len(staying) == 1 else None, len(guards)
        passage = only if only and count == 1 and only.guarded is Always and not only.acts else None
        limit = only if only and only.guarded is After and not (only.counts or only.takes) else None
        return Decision(tuple(by_guard), self.firings, staying, passage, limit, len(by_guard) < count, len(staying) < count, knows)

    def _opened(self, kind: OutcomeKind | None) -> tuple[Firing, ...]:
        template, call = self._block.template, self._call

        def is_opened(guard: Guard) -> bool:
            return guard == Accepts(call) if kind is None else isinstance(guard, Ends) and guard.call == call and kind in guard.kinds

        return tuple([self.firings[number] for number in template.reported if is_opened(template.kinds[number].guard)])


@dataclass(frozen=True, slots=True)
class Site(Placed):
    """A block as it is executed."""

    template: BlockTemplate
    shape: Shape
    step: int | None
    """The number of its step; None for the frame, and for a net that is one block."""
    call: int | None
    """The same if the step is a call."""

    def arcs_of(self, firing: Firing) -> tuple[NumberedArcs, NumberedArcs]:
        """Return the tokens that a transition takes from places, and those that it gives to places."""
        return self.arcs(self.template.inputs[firing.number]), self.arcs(self.template.outputs[firing.number])

    def step_of(self, firing: Firing) -> int | None:
        """Return the number of the step that a transition belongs to."""
        return firing.step if self.step is None else self.step


class MachineIndex:
    """Places, transitions and calls of a machine.

    The mutable state is what was worked out so far.
    """

    def __init__(self, machine: PetriNetMachine) -> None:
        self._calls, self.blocks = machine.plan.calls, (blocks := machine.placed)
        self.settling, self.failures, self.restarts, self.resources = blocks.settling, blocks.failures, blocks.restarts, blocks.resources
        self.records = frozenset((*self.resources, *self.failures, *self.restarts, *blocks.budgets))
        """Places at which nothing is decided."""
        self.alive, self.goal, self.failed = tuple(blocks.alive), blocks.goal, blocks.failed
        self.on_failure: OnFailure = machine.on_failure
        shapes, sites = dict[object, Shape](), list[Site]()
        for block in blocks.placed:
            key = (block.template, *map(len, block.ports))
            if (shape := shapes.get(key)) is None:
                shape = shapes[key] = Shape(self, block, OWN)
            sites.append(self._site(block, shape))
        of_calls, first = {site.call: site for site in sites}, blocks.placed[0]
        self.of_calls = [of_calls.get(call) or self._site(first, Shape(self, first, call)) for call in range(len(self._calls))]
        """The blocks of the calls; a net that is one block is that of each call."""
        self.sites: Final = sites[:1] * blocks.count_places
        """For every place, the block that decides there."""
        self.codes: Final = [0] * blocks.count_places
        """For every place, its code in that block."""
        for site in sites:
            count = len(site.template.places)
            self.sites[site.place : site.place + count] = [site] * count
            self.codes[site.place : site.place + count] = range(count)
        # What is decided at a place between blocks, or at one of the frame, is decided by the one block that takes from there.
        for site in sites:
            for code in site.template.reading:
                for place in site.ports[~code]:
                    self.sites[place], self.codes[place] = site, code
        # worked out so far
        self.rules: Final = WhenAsked(blocks, MachineBlocks.rule)
        """The rules of transitions."""
        self.conditions: Final = WhenAsked(self, MachineIndex._condition)
        """The conditions that guards of transitions ask for, where they are the same for every run."""
        self.guards: Final[WhenAsked[int, Guard]] = WhenAsked(self, MachineIndex._guard)
        """The guards of transitions."""
        self.since: Final = WhenAsked(self, MachineIndex._since)
        """The places from whose marking guards of transitions count, and the seconds."""
        self.reads: Final[dict[Rules, WhenAsked[int, Reads]]] = WhenAsked(
            self, lambda index, rules: WhenAsked(index, partial(MachineIndex._reads_at, rules=rules))
        )
        """The knowledge that decisions at places of a run read, by the rules of its world."""
        self.closed: Final[WhenAsked[int, ClosedCall | None]] = WhenAsked(self, lambda index, call: closed_call(index._calls[call]))
        """The parts of calls that do not depend on knowledge."""

    def is_call(self, step: int | None) -> bool:
        """Return whether a step is a call."""
        return step is not None and step < len(self._calls)

    def decision(self, place: int) -> Decision:
        """Return the decisions at a place."""
        return self.sites[place].shape.decisions[self.codes[place]]

    def guard(self, site: Site, firing: Firing) -> Guard:
        """Return the guard of a transition."""
        return self.guards[site.transition + firing.number] if firing.guard is None else firing.guard

    def _site(self, block: PlacedStep, shape: Shape) -> Site:
        step = None if block.step is None else block.step.index
        call = step if self.is_call(step) else None
        return Site(block.template, block.title, block.place, block.transition, block.ports, shape, step, call)

    # --- what each block has for itself -------------------------------------------------------

    def _reads_at(self, place: int, rules: Rules) -> Reads:
        site, read = self.sites[place], set[Fluent | str]()
        for firing in self.decision(place).firings:
            call = firing.call if site.call is None else site.call
            action = None if call is None else self._calls[call].action
            # Other runs may give back resources without anything being heard of it.
            reads = None if firing.takes else reads_of_guard(self.guard(site, firing), action, rules)
            if reads is None:
                return None
            read |= reads
        return frozenset(read)

    def _guard(self, transition: int) -> Guard:
        block = self.blocks.block_of(transition)
        return block.guard(transition - block.transition)

    def _since(self, transition: int) -> tuple[tuple[int, float], ...]:
        guard, blocks = self.guards[transition], self.blocks
        if not isinstance(guard, Due) or not guard.since:
            return ()
        names = {blocks.place_name(place): place for place, _ in blocks.inputs[transition]}  # it counts from places that it takes from
        return tuple((names[place], delay) for place, delay in guard.since)

    def _condition(self, transition: int) -> CompiledCondition | None:
        block, guard = self.blocks.block_of(transition), self.guards[transition]
        step = block.step_of(transition - block.transition)
        is_open = self.is_call(step) and self.closed[step or 0] is None
        return None if is_open or guard.asks is None else compiled(guard.asks)


# An index must not hold its machine, or none would ever be forgotten.
_INDICES: Final[WeakKeyDictionary[PetriNetMachine, MachineIndex]] = WeakKeyDictionary()


def index_of(machine: PetriNetMachine) -> MachineIndex:
    """Return the index of a machine, which is made once."""
    found = _INDICES.get(machine)
    if found is None:
        with no_collection():
            found = _INDICES[machine] = MachineIndex(machine)
    return found


@no_collection()
def prepare(machine: PetriNetMachine) -> None:
    """Work out at once what every call that goes well needs; between firings, call by call, that takes twice as long."""
    index = index_of(machine)
    for call, site in enumerate(index.of_calls):
        index.closed[call]
        if site.call is not None:
            for number in site.template.usual:
                index.conditions[site.transition + number]
