"""Petri Net Machines: PNM = (Σ, PN, m₀, δ̂, P_g) of the 2019 paper.

Σ are the reports, knowledge changes and moments in time of `pnm.core.execution.events`; PN and m₀ are the net
and its initial marking; P_g are the goal places. δ̂ is written down as one *rule* per
transition: a guard, asked besides the preset, and the action, outcome and cause that its firing brings about.
`pnm.core.execution.run` evaluates the rules; nothing here has a clock or does I/O.

At a place with several consumers the rules are asked in the order of the net's transitions,
and the first open one fires.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self, TypeVar

from pnm.core import notebook
from pnm.core.machine.bindings import Bindings, is_open
from pnm.core.machine.guards import Due, Guard, Rule
from pnm.core.machine.plan_graph import Flow, Moment, Ordering, PlanEvent, PlanGraph, Step, necessary
from pnm.core.machine.step_block import BlockTemplate, Terms
from pnm.core.net.block_net import BlockNet, Placed
from pnm.core.net.net import Marking, PetriNet, TimeOrder, Weights, time_order

V = TypeVar("V")


class OnFailure(Enum):
    """Policy for running calls once a failure place is marked."""

    DRAIN = "drain"
    CANCEL = "cancel"
    CONTINUE_OTHERS = "continue_others"
    """As drain; but the task does not wait for the end of the run before it goes on in another way."""


@dataclass(frozen=True, slots=True)
class Region:
    """Steps that are entered and left as a whole: all of the plan, the body of a loop, a branch, a chain of recovery."""

    owner: int | None
    """The number of the step that holds it; None for all of the plan."""
    steps: frozenset[int]
    first: Sequence[str]
    """Places that the owner marks, all at once."""
    last: Sequence[str]
    """Places that are marked when all steps are done, and that the owner takes all at once."""


@dataclass(frozen=True, eq=False)
class PetriNetMachine:
    """A net with roles, rules, and what it was made from: a plan and bindings.

    A machine as it was generated is its placed blocks. What it has by name is a view of them, made when any of it is asked for.
    One of which a part was replaced is what its names say, and one block to those who need numbers.
    """

    plan: PlanGraph
    bindings: Bindings
    """Limits and resources of its calls."""
    net: PetriNet
    initial: Marking
    rules: Mapping[str, Rule]
    """For every transition, what δ̂ asks and what its firing brings about."""
    goal_place: str
    failed_place: str
    failure_places: Mapping[str, int]
    """For every place that marks the failure of a step, the number of the step."""
    restart_places: Mapping[str, int]
    """For every place that asks for the plan to begin anew, the call that marks it."""
    budget_places: Set[str]
    """Places that count retries, recoveries and rounds left, and those spent."""
    resource_places: Mapping[str, str]
    """For every place whose tokens calls have for themselves as long as they are under way, the name of the resource."""
    settling_places: Mapping[str, int]
    """For every place at which a call has succeeded and its effects are still to be looked for, the number of the call."""
    alive_places: Set[str]
    """Places of calls that are under way: a request may be alive, or its effects are looked for."""
    blocks: Mapping[int, tuple[str, ...]]
    """For every step, the places of its block."""
    orderings: Mapping[str, Ordering]
    """For every place that stands for an ordering of the plan, that ordering."""
    regions: tuple[Region, ...]
    """The plan itself first."""
    on_failure: OnFailure = OnFailure.DRAIN
    generated: MachineBlocks | None = field(default=None, init=False, repr=False)
    """The blocks that it was generated as; None if it was made in another way, or a part of it was replaced."""

    # --- placed blocks and names ------------------------------------------------------------------

    @classmethod
    def of_blocks(cls, plan: PlanGraph, bindings: Bindings, blocks: MachineBlocks, on_failure: OnFailure) -> Self:
        """Return the machine of a plan whose blocks are placed."""
        machine = cls.__new__(cls)
        vars(machine).update(plan=plan, bindings=bindings, generated=blocks, on_failure=on_failure)
        return machine

    if not TYPE_CHECKING:  # the fields are all there is

        def __getattr__(self, name: str) -> object:
            if self.generated is None or name not in _BY_NAME:
                raise AttributeError(f"a machine has no {name!r}", name=name, obj=self)
            vars(self).update(_named(self.generated, self.generated.placed, range(self.generated.count_places)))
            return vars(self)[name]

    def part(self, chosen: Iterable[PlacedStep], places: Collection[int]) -> PetriNetMachine:
        """Return some of the blocks and places that it was generated as, by name."""
        assert self.generated is not None, "it has blocks"
        named = _named(self.generated, chosen, places)
        return PetriNetMachine(plan=self.plan, bindings=self.bindings, on_failure=self.on_failure, **named)  # type: ignore[arg-type]

    @cached_property
    def placed(self) -> MachineBlocks:
        """Its blocks, all by number."""
        return self.generated or _one_block(self)

    @property
    def capacities(self) -> Mapping[str, int]:
        """The number of calls that may share each resource, as far as its name is known before its calls start."""
        placed = self.placed
        return {name: placed.initial.get(place, 0) for place, name in placed.resources.items() if not is_open(name)}

    # --- roles of places --------------------------------------------------------------------------

    @cached_property
    def start_place(self) -> str:
        """The place of the only token that is no counter and no resource."""
        (start,) = (place for place in self.initial if place not in self.record_places)
        return start

    @property
    def goal_places(self) -> frozenset[str]:
        """P_g: the run has reached its goal when one of these is marked."""
        return frozenset({self.goal_place})

    @cached_property
    def record_places(self) -> frozenset[str]:
        """Places that may stay marked at the end: counters and resources."""
        return self.counter_places | frozenset(self.resource_places)

    @cached_property
    def counter_places(self) -> frozenset[str]:
        """Failures, restarts asked for, and budgets: nothing starts from them, they are looked at from other places."""
        return frozenset(self.failure_places) | frozenset(self.restart_places).union(self.budget_places)

    @cached_property
    def border_places(self) -> frozenset[str]:
        """Places between steps and what holds them."""
        return frozenset(place for region in self.regions for place in (*region.first, *region.last))

    def role(self, place: str) -> str:
        """Return ``goal``, ``failure``, ``restart``, ``budget``, ``resource``, ``ordering`` or, for all other places, nothing."""
        if place == self.goal_place:
            return "goal"
        if place in self.failure_places or place == self.failed_place:
            return "failure"
        if place in self.restart_places:
            return "restart"
        if place in self.budget_places:
            return "budget"
        if place in self.resource_places:
            return "resource"
        return "ordering" if place in self.orderings else ""

    @cached_property
    def time_order(self) -> TimeOrder:
        """The order of time of its places, in which pictures have them."""
        # Tokens that ends wait for come into the middle of a block, which begins elsewhere.
        awaited = {place for place, ordering in self.orderings.items() if ordering.after.moment is Moment.END}
        return time_order(self.net, self.start_place, self.record_places | awaited)

    def _repr_svg_(self) -> str | None:
        return notebook.MACHINE.draw(self)

    def __repr__(self) -> str:
        placed = self.placed
        return f"<PetriNetMachine {len(self.plan.calls)} calls, {placed.count_places} places, {placed.count_transitions} transitions>"


_BY_NAME = PetriNetMachine.__dataclass_fields__.keys() - {"plan", "bindings", "on_failure", "generated"}


def _named(blocks: MachineBlocks, chosen: Iterable[PlacedStep], places: Iterable[int]) -> dict[str, object]:
    """Return all that there is of some blocks and places, by name."""
    names = {place: blocks.place_name(place) for place in sorted(places)}
    inputs, outputs, rules, own = dict[str, Weights](), dict[str, Weights](), dict[str, Rule](), dict[int, tuple[str, ...]]()
    for block in chosen:
        template = block.template
        for number in range(len(template.transitions)):
            name = block.transition_name(number)
            rules[name] = block.rule(number)
            inputs[name] = {names[place]: weight for place, weight in block.arcs(template.inputs[number]) if place in names}
            outputs[name] = {names[place]: weight for place, weight in block.arcs(template.outputs[number]) if place in names}
        if block.step is not None:
            own[block.step.index] = tuple([names[place] for place in range(block.place, block.place + len(template.places))])
    orderings, regions = dict[str, Ordering](), dict[PlacedRegion, tuple[list[str], list[str]]]()
    for place, name in names.items():
        if isinstance(region := blocks.segment_of(place), PlacedRegion):
            meant, (first, last) = region.stands_for(place), regions.setdefault(region, ([], []))
            if isinstance(meant, Ordering):
                orderings[name] = meant
                continue
            first += [name] if meant is None or meant.moment is Moment.START else []
            last += [name] if meant is None or meant.moment is Moment.END else []

    def of(found: Mapping[int, V]) -> dict[str, V]:
        return {name: found[place] for place, name in names.items() if place in found}

    return {
        "net": PetriNet(tuple(names.values()), inputs, outputs),
        "initial": Marking(of(blocks.initial)),
        "rules": rules,
        "goal_place": blocks.place_name(blocks.goal),
        "failed_place": blocks.place_name(blocks.failed),
        "failure_places": of(blocks.failures),
        "restart_places": of(blocks.restarts),
        "budget_places": frozenset(name for place, name in names.items() if place in blocks.budgets),
        "resource_places": of(blocks.resources),
        "settling_places": of(blocks.settling),
        "alive_places": frozenset(of(blocks.alive)),
        "blocks": own,
        "orderings": orderings,
        "regions": tuple(Region(one.owner, frozenset(one.steps), *bordering) for one, bordering in regions.items()),
    }


def _one_block(machine: PetriNetMachine) -> MachineBlocks:
    """Return a machine that is known by its names as one block, which belongs to no step."""
    net, number, blocks = machine.net, machine.net.place_numbers, MachineBlocks()
    rules = tuple([machine.rules[name] for name in net.transitions])
    blocks.place(PlacedStep(BlockTemplate.of(net, rules=rules, kinds=rules), None, 0, 0, ()))

    def of(found: Mapping[str, V]) -> dict[int, V]:
        return {number[place]: value for place, value in found.items()}

    blocks.resources, blocks.initial = of(machine.resource_places), of(machine.initial)
    blocks.failures, blocks.restarts, blocks.settling = of(machine.failure_places), of(machine.restart_places), of(machine.settling_places)
    blocks.alive, blocks.budgets = of(dict.fromkeys(machine.alive_places, -1)), frozenset(of(dict.fromkeys(machine.budget_places)))
    blocks.goal, blocks.failed = number[machine.goal_place], number[machine.failed_place]
    return blocks


# --- blocks: where each of them is placed, the regions between them, and what that makes of places ---


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
