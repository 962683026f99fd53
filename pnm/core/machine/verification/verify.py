"""Is the machine sound? Proved before it runs, block by block; or by its whole state space.

*Sound* means: whatever its servers and the world answer, and whenever it is stopped, the
machine ends, with exactly one token on its goal place or on its failed place and none elsewhere
but on record places, and with no request alive; the goal is not reached once a step has failed or the run was stopped; nothing is
sent once it is ending, and no second request of a call while one is alive; a call is left only with an outcome that is so, or with
the cause of why it has none; unless the run is ending, it is left only once it is done, or for a cause after which the plan has a
recovery that goes on without it, and a loop or a choice only as its condition says; no place ever holds two tokens, a budget never
more than it began with. A run that is paused goes on when it is resumed, and each pause may have calls begin anew: so it ends if it is
paused finitely often.

`explore` walks through all states: the oracle, for machines of a few calls. `verify` is linear in the number of calls, and trusts
nothing but the net and the rules, and what it has proved before. A machine as it was generated has its blocks from templates: one
block of each kind is looked at as described here, if none of its kind was in this process, and of all others what is their own: what
their ports stand for, and what their rules ask (`check_places`, `kinds_of`). A machine of which any part was exchanged is looked at
block by block. Every block (the transitions of one step) is explored on its own, once per shape, with its inputs supplied at any moment
and what it holds taken as one step that comes to an end; at every place some exit opens in finite time for any answer; every place
between blocks has one writing and one reading block, neighbours or a step and what holds it; and what neighbours wait for has no cycle.
By induction along that
order, and from the innermost steps outwards, each block gets its inputs once and gives its outputs
once whenever it is entered. Counters are explored as all, some or none left, and their moves end because they have one direction.

The net is that of the plan: its regions are the flows, every ordering is a place that its two events keep in order, delays and
releases are waited for, and a step fails only after some rule has found the cause. Every call asks, watches, holds and counts what its
action, its binding and the plan ask of it: the rules are `CallRule`.

A block takes all of its resources at once, while it has none, gives them back whatever happens, and
waits neither for other blocks nor for what it holds as long as it has them. So a call that has resources
comes to an end without the help of others, and a call that waits for some gets them in the end; unless a request that was given up
keeps them, and for that case every wait for resources has another way out.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter
from itertools import chain
from math import isfinite
from typing import Final, NamedTuple, TypeAlias

from pnm.core.machine.blocks import MachineBlocks, PlacedStep
from pnm.core.machine.guards import Adopted, ConditionTrue, Guard, Withheld
from pnm.core.machine.machine import OnFailure, PetriNetMachine
from pnm.core.machine.plan_graph import ActionCall
from pnm.core.machine.verification.call_content import RESOURCES, AskedOf, CallNet, WatchedPlaces, check_content, check_guard
from pnm.core.machine.verification.decompose import Anatomy, Event, Owner, Owners, PlacedBlock, check_roles
from pnm.core.machine.verification.explore import Exploration, NeverFires, explore_part, never_fire
from pnm.core.machine.verification.part import Inside, Part, Unsound, kinds_of, shape_of, step_of
from pnm.core.machine.verification.plan_in_net import check_events, check_flows, check_places
from pnm.core.net.block_net import Remembered
from pnm.core.net.net import Weights
from pnm.core.net.no_collection import no_collection
from pnm.errors import check_kinds, counted

_MALFORMED: Final = (ArithmeticError, AssertionError, AttributeError, LookupError, RecursionError, TypeError, ValueError)
"""The errors of a machine that was tampered with: it may name anything, have anything in the place of anything, and recover in circles."""


_FOUND_GOOD: Final = Remembered[object, Exploration]()
"""The shapes of blocks that were explored, and the kinds of calls that were proved, in any machine."""


@dataclass(frozen=True, slots=True)
class Proof:
    """Proof of a machine: what was proved, and how much work it was."""

    calls: int
    shapes: int
    """Blocks that differ."""
    states: int
    """States explored in all of them."""
    machine: PetriNetMachine = field(repr=False, compare=False)

    @property
    def never(self) -> tuple[NeverFires, ...]:
        """Transitions that can never fire; every other one fires for some answers of servers and of the world."""
        machine = self.machine
        blocks = map(Anatomy(machine).block, dict.fromkeys(rule.call for rule in machine.rules.values()))
        return tuple(never for block in blocks for never in never_fire(block.part, _proved(block.part)))

    def __str__(self) -> str:
        return f"sound: {counted(self.calls, 'call')} of {counted(self.shapes, 'shape')}, {self.states} states explored"


@no_collection()
def verify(machine: PetriNetMachine) -> Proof:
    """Prove the machine sound.

    Raises:
        Unsound: it is not, or not of the form that `pnm.core.machine` makes.
    """
    check_kinds("verify", {"machine": (machine, PetriNetMachine)})
    try:
        return _verified(machine)
    except _MALFORMED as error:
        raise Unsound(f"it is not of the form that a machine has: {error!r}") from error


def _verified(machine: PetriNetMachine) -> Proof:
    proved, kinds = set[Exploration](), dict[Owner, object]()
    if (blocks := machine.generated) is None:
        check_flows(machine)
        anatomy = Anatomy(machine)
    else:  # one block of each kind is looked at, and of all others how they are connected
        check_places(machine.plan, blocks)
        sample = _sample(machine, blocks)
        proved.update(sample.proved)
        kinds = sample.kinds
        anatomy = _anatomy_of(sample, machine, blocks)
    taken = anatomy.machine
    waits, found = dict[Event, set[Event]](), dict[object, Exploration]()
    for owner in anatomy.writers[taken.goal_place]:
        for name in anatomy.transitions[owner]:
            if taken.goal_place in taken.net.outputs[name] and taken.rules[name].guard != ConditionTrue(taken.plan.goal):
                raise Unsound(f"{name} marks the goal place without asking for the goal")
    for name in anatomy.transitions[None]:
        counted_by = [taken.initial[place] for place in taken.net.inputs[name] if place in taken.budget_places]
        if taken.rules[name].restarts and counted_by != [taken.plan.restart_limit]:
            raise Unsound(f"{name} does not count how often the plan begins anew, which is {taken.plan.restart_limit} at most")
    for owner in anatomy.transitions:
        block = anatomy.block(owner)
        if owner is not None and not block.part.ends:
            raise Unsound(f"nothing waits for the end of step {owner}")
        check_events(taken, block, anatomy.transitions[owner])
        anatomy.note_waits(block, waits)
        shape = _proved(block.part)
        proved.add(shape)
        if owner in kinds:
            found[kinds[owner]] = shape
        _check_reached(anatomy, block, shape)
    try:
        # Each block gives its outputs once it has its inputs; without a cycle all get them, by induction.
        TopologicalSorter(waits).prepare()
    except CycleError as error:
        raise Unsound(f"blocks wait for each other: {error.args[1]}") from error
    if blocks is None:
        asked_of = AskedOf(taken)
        for call in taken.plan.calls:
            check_content(net_of(taken, call.index, anatomy.transitions.get(call.index, ())), asked_of(call))
    for kind, shape in found.items():
        _FOUND_GOOD.keep(kind, shape)
    return Proof(len(machine.plan.calls), len(proved), sum(shape.states for shape in proved), machine)


_Watched: TypeAlias = tuple[tuple[int, WatchedPlaces], ...]
"""Guards of a kind of calls that are looked at for each: where they are among those of its own, and what asks for them."""
_KEEPS_ITS_RULES: Final = Remembered[object, _Watched]()
"""The kinds of calls whose content was looked at, in any machine."""


class _Contents:
    """Looks at what the calls of a machine do. The mutable state are the kinds of calls that were looked at."""

    def __init__(self, machine: PetriNetMachine, blocks: MachineBlocks) -> None:
        self._machine, self._resources, self._held, self._asked_of = machine, blocks.resources, blocks.held, AskedOf(machine)
        self._looked_at: dict[object, _Watched] = {}

    def check(self, block: PlacedStep, call: ActionCall, guards: Sequence[tuple[Guard, Weights]]) -> object:
        """Check what is asked of a call: all of it for the first one of its kind, and its guards for the others; return its kind."""
        asked, template = self._asked_of(call), block.template
        kind = template, asked.kind, tuple([bool(region.flow.steps) for region in self._held.get(call.index, ())])
        watched = self._looked_at.get(kind)
        if watched is None:
            watched = _KEEPS_ITS_RULES.get(kind)
            if watched is None:
                places = {*range(block.place, block.place + len(template.places)), *chain.from_iterable(block.ports)}
                part = _part(self._machine, [block], places)
                found = check_content(net_of(part, call.index, part.net.transitions), asked)
                watched = tuple([(position, found[number]) for position, number in enumerate(template.own) if number in found])
            self._looked_at[kind] = _KEEPS_ITS_RULES.keep(kind, watched) if template.is_shared else watched
        for position, watch in watched:
            check_guard(watch, guards[position][0], asked)
        if sorted(self._resources[place] for place in block.ports[RESOURCES]) != sorted(asked.resources):
            raise Unsound(f"{call} does not keep the rule of its resources: its port is not that of {', '.join(asked.resources)}")
        return kind


class _Sample(NamedTuple):
    """The blocks of a machine that are looked at."""

    chosen: list[PlacedStep]
    kinds: dict[Owner, object]
    """The kinds of the calls among them, which other machines may have as well."""
    proved: set[Exploration]
    """The knowledge of the kinds that are left out."""
    left_out: list[PlacedStep]
    """The first block of each of them."""
    borders: set[int]
    """Places between those and the frame, which is looked at."""


def _sample(machine: PetriNetMachine, blocks: MachineBlocks) -> _Sample:
    """Return the frame and one block of each kind that was not proved before.

    Blocks of one template are of one kind if what their own rules ask is alike, as far as the proof looks at it, their ports lead
    somewhere or not alike, and they stand in the same region in the same way. What is proved of a call depends on nothing else of its
    machine than whether it can be entered again, and what becomes of it when another step fails: whatever its recoveries hold comes to an
    end, which is proved of that, and `check_places` looks at how it is connected.
    """
    sample, seen, looked_at = _Sample([], {}, set(), [], set()), set[object](), set[object]()
    surroundings = machine.on_failure, bool(blocks.restarts)
    regions = {step.index: region for region in blocks.regions for step in region.flow.steps}
    contents = _Contents(machine, blocks)
    for block in blocks.placed:
        if (step := block.step) is None:
            sample.chosen.append(block)
            continue
        region, template = regions.get(step.index), block.template
        # the places at which the block is entered, and left, directly from what holds it, by its ports
        first_border = 0 if region is None else region.place + len(region.orderings)
        borders = [[place for place in places if place >= first_border] for places in block.ports[:4]]
        guards = blocks.own_guards(block)
        content = contents.check(block, step, guards) if isinstance(step, ActionCall) else template
        like = (content, tuple(map(bool, block.ports)), *map(bool, borders), kinds_of(guards))
        if (kind := (*like, id(region))) in seen:
            continue
        seen.add(kind)
        if template.is_shared and region is not None:
            anywhere = (*like, surroundings, region.owner is None)
            if (known := _FOUND_GOOD.get(anywhere)) is not None or anywhere in looked_at:
                sample.proved.update([known] if known else [])
                sample.left_out.append(block)
                if region.owner is None:
                    sample.borders.update(*borders)
                continue
            looked_at.add(anywhere)
            sample.kinds[step.index] = anywhere
        sample.chosen.append(block)
    chosen = {block.step.index for block in sample.chosen if block.step}
    for block in sample.chosen:  # the proof goes outwards, so what holds them is looked at as well: it comes to the end of the same list
        holder = block.step and regions[block.step.index].holder
        if holder and holder.index not in chosen:
            chosen.add(holder.index)
            sample.chosen.append(next(one for one in blocks.placed if one.step is holder))
    return sample


def _anatomy_of(sample: _Sample, machine: PetriNetMachine, blocks: MachineBlocks) -> Anatomy:
    """Return the anatomy of a sample, with all that its blocks are connected to."""
    chosen = sample.chosen
    own = sample.borders.union(number for block in chosen for number in range(block.place, block.place + len(block.template.places)))
    own.update(number for block in chosen if block.step is not None for places in block.ports for number in places)
    own.update(region.place for region in blocks.regions if region.owner is None and not region.flow.steps)
    own.update(blocks.restarts)  # the frame takes from them
    left_out = (block.place + number for block in sample.left_out for number in range(len(block.template.places)))
    others = [blocks.place_name(number) for number in left_out if number not in own]
    return Anatomy(_part(machine, chosen, own, others), _beside(blocks, own))


def _part(machine: PetriNetMachine, blocks: Sequence[PlacedStep], places: Collection[int], others: Sequence[str] = ()) -> PetriNetMachine:
    """Return some of the blocks and places of a machine by name; all of them, and other names, must be different."""
    part = machine.part(blocks, places)
    count = len(places) + len(others) + sum(len(block.template.transitions) for block in blocks)
    if len({*part.net.places, *part.net.transitions, *others}) < count:
        raise Unsound("a name is used twice")
    return part


def _beside(blocks: MachineBlocks, own: set[int]) -> tuple[Owners, Owners]:
    """Return which blocks give to the places through ports, and which take from them."""

    def owners(linked: Mapping[int, Sequence[tuple[PlacedStep, int]]]) -> dict[str, set[Owner]]:
        found = ((place, linked[place]) for place in own & linked.keys())
        return {blocks.place_name(place): {block.step.index if block.step else None for block, _ in all_} for place, all_ in found}

    return owners(blocks.writers), owners(blocks.readers)


def _check_reached(anatomy: Anatomy, block: PlacedBlock, explored: Exploration) -> None:
    """Refuse a plan with steps that can never begin."""
    for region in anatomy.regions.get(block.owner, ()) if explored.unfired else ():
        steps = enumerate(block.part.steps)
        entering = [
            number for number, step in steps if not isinstance(step.guard, Inside) and not step.outputs.keys().isdisjoint(region.first)
        ]
        if not set(entering).difference(explored.unfired):
            raise Unsound(f"step {min(region.steps)} of the plan can never begin")


def _proved(part: Part) -> Exploration:
    """Prove a block, unless one of its shape was found good before: a task proves many machines of the same few shapes."""
    shape = shape_of(part)
    proved = _FOUND_GOOD.get(shape)
    if proved is None:
        for number, step in enumerate(part.steps):
            # The exploration assumes that resources come in the end, which is not so if they are withheld: hence this check by form.
            rest = {place: weight for place, weight in step.inputs.items() if place not in part.resources}
            if rest != step.inputs and not isinstance(step.guard, Adopted):
                # Rules are asked in order: only an exit before the transition is asked while that waits for its resources.
                before = part.steps[:number]
                if not any(
                    isinstance(way_out.guard, Withheld) and isfinite(way_out.guard.seconds) and way_out.inputs == rest for way_out in before
                ):
                    raise Unsound(f"{step.name} has no way out for when resources that it needs are withheld")
        proved = _FOUND_GOOD.keep(shape, explore_part(part))
    return proved


def forget_proofs() -> None:
    """Forget which shapes of blocks, and which kinds of calls, were found good."""
    _FOUND_GOOD.forget()
    _KEEPS_ITS_RULES.forget()


def explore(machine: PetriNetMachine) -> int:
    """Walk through every state of a small machine and return their number.

    Raises:
        Unsound: some state is wrong, or there are more than `MAX_STATES`.
    """
    check_roles(machine)
    explored = explore_part(
        Part(
            places=tuple(machine.net.places),
            steps=tuple(step_of(machine, name) for name in machine.rules),
            initial=machine.initial,
            failures=frozenset(machine.failure_places),
            records=machine.record_places,
            counters=machine.counter_places,
            cancels=machine.on_failure is OnFailure.CANCEL,
            finals=frozenset((machine.goal_place, machine.failed_place)),
            goal=machine.goal_place,
            restarts=frozenset(machine.restart_places),
            resources=frozenset(machine.resource_places),
            alive=frozenset(machine.alive_places),
            settling=frozenset(machine.settling_places),
            owed=tuple(step.index for step in machine.plan.steps if isinstance(step, ActionCall)),
        )
    )
    return explored.states


# --- nets of calls ----------------------------------------------------------------------------


def net_of(machine: PetriNetMachine, call: int, transitions: Sequence[str]) -> CallNet:
    """Return the net of a call, given its transitions by name."""
    places = frozenset(place for name in transitions for arcs in (machine.net.inputs, machine.net.outputs) for place in arcs[name])
    return CallNet(
        names=transitions,
        rules=[machine.rules[name] for name in transitions],
        inputs=[machine.net.inputs[name] for name in transitions],
        outputs=[machine.net.outputs[name] for name in transitions],
        failures=places & machine.failure_places.keys(),
        restarts=places & machine.restart_places.keys(),
        counters={place: machine.initial[place] for place in places & machine.budget_places},
        resources={place: name for place, name in machine.resource_places.items() if place in places},
        between=places & (machine.orderings.keys() | machine.border_places),
        alive_places=places & machine.alive_places,
        held=[region for region in machine.regions if region.owner == call],
    )
