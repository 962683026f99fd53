"""The blocks of a machine: where each of them is placed, and the regions between them.

What the machine says of its net by name is worked out from the blocks when it is asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Protocol

from pnm.core.machine.bindings import Bindings
from pnm.core.machine.call_block import CallTerms
from pnm.core.machine.guards import (
    Due,
    Guard,
    OfCall,
    Opener,
)
from pnm.core.machine.machine import OnFailure, PetriNetMachine, Region, Rule
from pnm.core.machine.plan_graph import ActionCall, Moment, Ordering, PlanEvent, PlanGraph, Step
from pnm.core.machine.step_block import BlockTemplate, Context, Inner
from pnm.core.net.block_net import BlockArcs, Placed
from pnm.core.net.net import ArcsByName, NumberedMarking, PetriNet, Weights
from pnm.core.net.when_asked import ByName, Made, Names, NamesOf


class RulesByNumber(Protocol):
    """The rules of a machine by the numbers of its transitions."""

    def rule(self, transition: int) -> Rule:
        """Return the rule of a transition."""

    def asks(self, transition: int) -> tuple[int | None, Guard]:
        """Return the step that a transition belongs to, and its guard; what that says of its call may be that of another."""

    def like(self, transition: int) -> Rule:
        """Return a rule of the same kind; what it says of its call may be that of another."""

    def is_shared(self, transition: int) -> bool:
        """Return whether the rule is that of all blocks with the same template, but for the step that it says it is about."""

    def reported(self, call: int) -> Sequence[tuple[int, Rule]]:
        """Return the transitions of the call that reports open, each with a rule of the same kind."""


class RulesByName(ByName[Rule]):
    """The rules of a machine that knows them by number."""

    def __init__(self, source: RulesByNumber, transitions: Names) -> None:
        super().__init__(transitions, lambda: Made(range(len(transitions)), source.rule))
        self.source = source


class _NamedRules:
    """Rules by number of a machine that has them by name."""

    def __init__(self, rules: Iterable[Rule]) -> None:
        self._rules, self._reported = [*rules], dict[int, list[tuple[int, Rule]]]()
        for transition, rule in enumerate(self._rules):
            if isinstance(rule.guard, OfCall) and rule.guard.opened_by is Opener.REPORT:
                self._reported.setdefault(rule.guard.call, []).append((transition, rule))

    def rule(self, transition: int) -> Rule:
        return self._rules[transition]

    def asks(self, transition: int) -> tuple[int | None, Guard]:
        rule = self._rules[transition]
        return rule.call, rule.guard

    like = rule

    def is_shared(self, transition: int) -> bool:
        return True

    def reported(self, call: int) -> Sequence[tuple[int, Rule]]:
        return self._reported[call]


def rules_by_number(machine: PetriNetMachine) -> RulesByNumber:
    """Return the rules of a machine by the numbers of its transitions."""
    rules, transitions = machine.rules, machine.net.transitions
    if isinstance(rules, RulesByName) and rules.names is transitions:
        return rules.source
    return _NamedRules(rules[name] for name in transitions)


@dataclass(frozen=True, slots=True)
class PlacedStep(Placed):
    """The block of a step, or a part of the frame around all of them."""

    template: BlockTemplate
    step: Step | None
    context: Context
    delays: tuple[tuple[int, float], ...] = ()
    """Places that the start waits for, and how long it must come after they were marked."""


class PlacedRegion:
    """The places between the steps of a flow, and those between what holds it and its first and last steps."""

    def __init__(self, inner: Inner, owner: int | None, place: int) -> None:
        self.inner, self.owner, self.place = inner, owner, place
        self.borders: list[PlanEvent | None] = []
        """What the places after those of the orderings stand for; None for the place of a flow without steps."""
        self.first: list[int] = []
        """The places that the owner marks."""
        self.last: list[int] = []
        """The places that it takes from."""

    def border(self, event: PlanEvent | None) -> int:
        """Add a place between the owner and an event."""
        self.borders.append(event)
        return self.place + self.count - 1

    def stands_for(self, place: int) -> Ordering | PlanEvent | None:
        """Return what one of its places stands for: an ordering, or a step that is entered or left by the owner."""
        number = place - self.place - len(self.inner.flow.orderings)
        return self.borders[number] if number >= 0 else self.inner.flow.orderings[number]

    @property
    def count(self) -> int:
        """How many places there are."""
        return len(self.inner.flow.orderings) + len(self.borders)

    @cached_property
    def steps(self) -> Mapping[int, Step]:
        """Its steps by their numbers."""
        return {step.index: step for step in self.inner.flow.steps}

    def place_name(self, number: int) -> str:
        """Return the name of one of its places."""
        orderings, begin, end = self.inner.flow.orderings, self.inner.begin, self.inner.end
        if number < len(orderings):
            before, after = orderings[number].before, orderings[number].after
            return f"{before.moment.value} {self.steps[before.call]} < {after.moment.value} {self.steps[after.call]} ({number})"
        match self.borders[number - len(orderings)]:
            case None:
                return f"{begin} < {end}"
            case PlanEvent(step, Moment.START):
                return f"{begin} < {self.steps[step]}"
            case PlanEvent(step):
                return f"{self.steps[step]} < {end}"


class MachineBlocks(BlockArcs[PlacedStep]):
    """The blocks of a machine and the regions between them, and the rules of their transitions. Builders add to it."""

    def __init__(self, plan: PlanGraph, bindings: Bindings) -> None:
        super().__init__()
        self.plan, self.bindings = plan, bindings
        self.regions: list[PlacedRegion] = []
        self.parts: Sequence[object] = ()
        """What the machine was made of."""
        # the last ones that were made are kept: those of one block are asked for together
        self._terms: tuple[PlacedStep, CallTerms] | None = None
        self._titled: tuple[PlacedStep | None, str] = None, ""

    def place_name(self, place: int) -> str:
        """Return the name of a place."""
        segment = self.segment_of(place)
        return segment.place_name(place - segment.place)

    def transition_name(self, transition: int) -> str:
        """Return the name of a transition."""
        block = self.placed[self.index_of(transition)]
        if self._titled[0] is not block:
            self._titled = block, str(block.title)
        name = block.template.transitions[transition - block.transition]
        return name if block.title is None else f"{self._titled[1]} {name}"

    # --- rules --------------------------------------------------------------------------------

    def rule(self, transition: int) -> Rule:
        """Return the rule of a transition."""
        block = self.placed[self.index_of(transition)]
        rule = block.template.rules[transition - block.transition]
        made = rule if isinstance(rule, Rule) else rule.made_for(self._terms_of(block))
        if (step := block.step) is None:
            return made
        return Rule._make((made.name, made.guard.about(step.index), step.index, *made[3:]))  # `_replace` takes longer

    def asks(self, transition: int) -> tuple[int | None, Guard]:
        """Return the step that a transition belongs to, and its guard; what that says of its call may be that of another."""
        block = self.placed[self.index_of(transition)]
        return None if block.step is None else block.step.index, self._guard(block, transition - block.transition)

    def like(self, transition: int) -> Rule:
        """Return a rule of the same kind, with the same arcs; what it says of its call may be that of another."""
        block = self.placed[self.index_of(transition)]
        return block.template.kinds[transition - block.transition]

    def is_shared(self, transition: int) -> bool:
        """Return whether the rule is that of all blocks with the same template, but for the step that it says it is about."""
        block = self.placed[self.index_of(transition)]
        return isinstance(block.template.rules[transition - block.transition], Rule)

    def own_guards(self, block: PlacedStep) -> list[tuple[Guard, Weights]]:
        """Return the guards that are made for the block alone, each with what its transition takes, if its times count from there.

        With them come all others that ask for conditions: it matters to the proof which conditions are the same.
        """
        found = list[tuple[Guard, Weights]]()
        for number in block.template.own:
            guard = self._guard(block, number)
            counts = isinstance(guard, Due) and guard.since
            inputs = block.arcs(block.template.inputs[number]) if counts else ()
            found.append((guard, {self.place_name(place): weight for place, weight in inputs}))
        return found

    def ordering(self, place: int) -> Ordering | None:
        """Return the ordering that a place stands for."""
        region = self.segment_of(place)
        found = region.stands_for(place) if isinstance(region, PlacedRegion) else None
        return found if isinstance(found, Ordering) else None

    def reported(self, call: int) -> Sequence[tuple[int, Rule]]:
        """Return the transitions of the call that reports open, each with a rule of the same kind."""
        block = self.placed[self._block_of[call]]
        return [(block.transition + number, block.template.kinds[number]) for number in block.template.reported]

    @cached_property
    def _block_of(self) -> Mapping[int | None, int]:
        return {block.step.index if block.step else None: index for index, block in enumerate(self.placed)}

    def _guard(self, block: PlacedStep, number: int) -> Guard:
        """Return the guard of a transition of a block; what it says of its call may be that of another."""
        rule = block.template.rules[number]
        return rule.guard if isinstance(rule, Rule) else rule.guard_for(self._terms_of(block))

    def _terms_of(self, block: PlacedStep) -> CallTerms:
        """Return the terms of the call of a block."""
        found = self._terms
        if found is None or found[0] is not block:
            assert isinstance(block.step, ActionCall), "only rules of calls are made for each"
            delays = tuple([(self.place_name(place), delay) for place, delay in block.delays])
            found = self._terms = block, CallTerms(block.context, block.step, delays)
        return found[1]

    # --- the machine --------------------------------------------------------------------------

    def machine(self, resources: Mapping[int, str], initial: Mapping[int, int], on_failure: OnFailure) -> PetriNetMachine:
        """Return the machine of the blocks.

        Args:
            resources: the places of resources.
            initial: the tokens besides those of blocks.
            on_failure: what happens to running calls once a step has failed.
        """
        places, transitions = Names(self.count_places, self.place_name), Names(self.count_transitions, self.transition_name)

        def of_steps(role: Callable[[BlockTemplate], Collection[int]]) -> ByName[int]:
            return ByName(places, lambda: dict(self._roles(role)))

        def names(role: Callable[[BlockTemplate], Collection[int]]) -> NamesOf:
            return NamesOf(places, lambda: [place for place, _ in self._roles(role)])

        def marked() -> dict[int, int]:
            counted = {block.place + number: count for block in self.placed for number, count in block.template.initial.items()}
            return {**initial, **counted}

        def orderings() -> dict[int, Ordering]:
            return {number: one for region in self.regions for number, one in enumerate(region.inner.flow.orderings, region.place)}

        def own_places(step: int) -> tuple[str, ...]:
            block = self.placed[self._block_of[step]]
            return places[block.place : block.place + len(block.template.places)]

        machine = PetriNetMachine(
            plan=self.plan,
            bindings=self.bindings,
            net=PetriNet(places, ArcsByName(self, transitions, places, self.inputs), ArcsByName(self, transitions, places, self.outputs)),
            initial=NumberedMarking(ByName(places, marked)),
            rules=RulesByName(self, transitions),
            goal_place=places[GOAL],
            failed_place=places[FAILED],
            failure_places=of_steps(lambda template: template.failures),
            restart_places=of_steps(lambda template: template.restarts),
            budget_places=NamesOf(places, lambda: [one.place + number for one in self.placed for number in one.template.budgets]),
            resource_places=ByName(places, lambda: resources),
            settling_places=of_steps(lambda template: template.settling),
            alive_places=names(lambda template: template.alive),
            blocks=Made([block.step.index for block in self.placed if block.step], own_places),
            orderings=ByName(places, orderings),
            regions=tuple(
                Region(
                    one.owner, frozenset(step.index for step in one.inner.flow.steps), _chosen(places, one.first), _chosen(places, one.last)
                )
                for one in self.regions
            ),
            on_failure=on_failure,
        )
        self.parts = parts_of(machine)
        return machine

    def _roles(self, role: Callable[[BlockTemplate], Collection[int]]) -> Iterator[tuple[int, int]]:
        for block in self.placed:
            if block.step is not None:
                for number in role(block.template):
                    yield block.place + number, block.step.index


START, END, GOAL, FAILED = range(4)
"""The first places of the frame."""


def built_from(machine: PetriNetMachine) -> MachineBlocks | None:
    """Return the blocks that the machine was built from; None if it was made in another way, or some part of it has been exchanged."""
    blocks = rules_by_number(machine)
    if not isinstance(blocks, MachineBlocks) or any(one is not other for one, other in zip(parts_of(machine), blocks.parts, strict=True)):
        return None
    return blocks if all(template.is_as_made for template in {block.template for block in blocks.placed}) else None


def parts_of(machine: PetriNetMachine) -> list[object]:
    """Return all that a machine consists of."""
    return [getattr(machine, field.name) for field in fields(machine)]


def _chosen(places: Names, numbers: Sequence[int]) -> Names:
    return Names(len(numbers), lambda number: places[numbers[number]])
