"""The blocks of a machine: where each of them is placed, the regions between them, and what that makes of places, all by number."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from pnm.core.machine.guards import Due, Guard, Rule
from pnm.core.machine.plan_graph import Flow, Moment, Ordering, PlanEvent, Step, necessary
from pnm.core.machine.step_block import BlockTemplate, Terms
from pnm.core.net.block_net import BlockNet, Placed
from pnm.core.net.net import Weights

START, END, GOAL, FAILED = range(4)
"""The first places of the frame."""


@dataclass(frozen=True, slots=True)
class PlacedStep(Placed):
    """The block of a step, or a part of the frame around all of them."""

    template: BlockTemplate
    terms: Terms[Any] | None = None
    """Those of its step; None for the frame."""

    @property
    def step(self) -> Step | None:
        """Its step; None for the frame."""
        return None if self.terms is None else self.terms.step

    def step_of(self, number: int) -> int | None:
        """Return the number of the step that one of its transitions belongs to; of a net that is one block, its rules say it."""
        return self.template.kinds[number].call if self.terms is None else self.terms.step.index

    def rule(self, number: int) -> Rule:
        """Return the rule of one of its transitions, which are numbered from 0 here."""
        rule = self.template.rules[number]
        made = rule if isinstance(rule, Rule) else rule.made_for(self.terms)
        if (step := self.step) is None:
            return made
        return Rule._make((made.name, made.guard.about(step.index), step.index, *made[3:]))  # `_replace` takes longer

    def guard(self, number: int) -> Guard:
        """Return the guard of one of its transitions; what that says of its call may be that of another."""
        rule = self.template.rules[number]
        return rule.guard if isinstance(rule, Rule) else rule.guard_for(self.terms)


class PlacedRegion:
    """The places between the steps of a flow, and those between what holds it and its first and last steps."""

    def __init__(self, flow: Flow, holder: Step | None, what: str, place: int) -> None:
        self.flow, self.holder, self.what, self.place = flow, holder, what, place
        self.orderings = necessary(flow)
        self.owner = None if holder is None else holder.index
        self.borders: list[PlanEvent | None] = []
        """The meanings of the places after those of the orderings; None for the place of a flow without steps."""

    def border(self, event: PlanEvent | None) -> int:
        """Add a place between the owner and an event."""
        self.borders.append(event)
        return self.place + self.count - 1

    def stands_for(self, place: int) -> Ordering | PlanEvent | None:
        """Return the meaning of one of its places: an ordering, or a step that is entered or left by the owner."""
        number = place - self.place - len(self.orderings)
        return self.borders[number] if number >= 0 else self.orderings[number]

    @property
    def count(self) -> int:
        """The number of places."""
        return len(self.orderings) + len(self.borders)

    def bordering(self, moment: Moment) -> tuple[int, ...]:
        """Return the places that the owner marks, at the start of its steps, or those that it takes from, at their ends."""
        places = enumerate(self.borders, self.place + len(self.orderings))
        return tuple([place for place, event in places if event is None or event.moment is moment])

    @cached_property
    def steps(self) -> Mapping[int, Step]:
        """Its steps by their numbers."""
        return {step.index: step for step in self.flow.steps}

    def place_name(self, number: int) -> str:
        """Return the name of one of its places."""
        orderings, around = self.orderings, f"{self.holder} {self.what}"
        begin, end = ("begin", "finish") if self.holder is None else (f"{around} begins", f"{around} ends")
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


class MachineBlocks(BlockNet[PlacedStep]):
    """The net of a machine by number, with the rules of its transitions and the roles of its places. Builders add to it."""

    def __init__(self) -> None:
        super().__init__()
        self.regions: list[PlacedRegion] = []
        self.resources: Mapping[int, str] = {}
        """The places of resources, and their names."""
        self.marked: Mapping[int, int] = {}
        """The tokens at first, besides those of blocks."""
        self.goal, self.failed = GOAL, FAILED

    def rule(self, transition: int) -> Rule:
        """Return the rule of a transition."""
        block = self.block_of(transition)
        return block.rule(transition - block.transition)

    def own_guards(self, block: PlacedStep) -> list[tuple[Guard, Weights]]:
        """Return the guards that are made for the block alone, each with what its transition takes, if its times count from there.

        With them come all others that ask for conditions: it matters to the proof which conditions are the same.
        """
        found = list[tuple[Guard, Weights]]()
        for number in block.template.own:
            guard = block.guard(number)
            counts = isinstance(guard, Due) and guard.since
            inputs = block.arcs(block.template.inputs[number]) if counts else ()
            found.append((guard, {self.place_name(place): weight for place, weight in inputs}))
        return found

    @property
    def held(self) -> Mapping[int | None, list[PlacedRegion]]:
        """The regions of each step that holds others, and of the frame, in the order of their ports."""
        found: dict[int | None, list[PlacedRegion]] = {}
        for region in self.regions:
            found.setdefault(region.owner, []).append(region)
        return found

    # --- roles of places --------------------------------------------------------------------------

    @cached_property
    def initial(self) -> Mapping[int, int]:
        """The tokens at first."""
        return {**self.marked, **{block.place + number: count for block in self.placed for number, count in block.template.initial.items()}}

    @cached_property
    def failures(self) -> Mapping[int, int]:
        """The places that mark the failure of a step, and the step."""
        return dict(self._of_steps(lambda template: template.failures))

    @cached_property
    def restarts(self) -> Mapping[int, int]:
        """The places that ask for the plan to begin anew, and the call."""
        return dict(self._of_steps(lambda template: template.restarts))

    @cached_property
    def settling(self) -> Mapping[int, int]:
        """The places at which a call has succeeded and its effects are still to be looked for, and the call."""
        return dict(self._of_steps(lambda template: template.settling))

    @cached_property
    def alive(self) -> Mapping[int, int]:
        """The places of calls that are under way, and the call."""
        return dict(self._of_steps(lambda template: template.alive))

    @cached_property
    def budgets(self) -> Collection[int]:
        """The places that count."""
        return frozenset(block.place + number for block in self.placed for number in block.template.budgets)

    def _of_steps(self, role: Callable[[BlockTemplate], Collection[int]]) -> Iterator[tuple[int, int]]:
        for block in self.placed:
            if (step := block.step) is not None:
                for number in role(block.template):
                    yield block.place + number, step.index
