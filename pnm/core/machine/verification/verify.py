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

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter
from itertools import chain
from math import isfinite
from typing import Final, NamedTuple, TypeAlias

from pnm.core.machine.guards import Adopted, ConditionTrue, Due, Ending, Guard, Rule, Withheld
from pnm.core.machine.machine import START, MachineBlocks, OnFailure, PetriNetMachine, PlacedRegion, PlacedStep
from pnm.core.machine.plan_graph import ActionCall, Flow, Moment, Ordering, PlanEvent, PlanGraph, flows, in_order
from pnm.core.machine.requests import TransitionAction
from pnm.core.machine.step_block import PORTS, Port
from pnm.core.machine.verification.call_content import RESOURCES, AskedOf, CallNet, WatchedPlaces, check_content, check_guard
from pnm.core.machine.verification.decompose import Anatomy, Event, Owner, Owners, PlacedBlock, check_roles
from pnm.core.machine.verification.explore import Exploration, NeverFires, explore_part, never_fire
from pnm.core.machine.verification.part import Inside, Part, Unsound, kinds_of, shape_of, step_of
from pnm.core.net.block_net import Remembered, Segment
from pnm.core.net.net import Weights, closure
from pnm.core.net.no_collection import no_collection
from pnm.errors import check_kinds, counted

# --- plan in net ----------------------------------------------------------------------------------
# Is the net that of its plan? The regions are its flows, and every ordering is kept: by a place between its events, or by others.


_BEGINNINGS = (TransitionAction.BEGIN, TransitionAction.ADOPT)


def check_flows(machine: PetriNetMachine) -> None:
    """Check that the machine has a region for every flow of the plan, a place for every ordering that does not follow, and no others."""
    owned = _flows(machine.plan)
    steps = Counter((owner, frozenset(step.index for step in flow.steps)) for owner, flow in owned if flow.steps)
    regions = Counter((region.owner, region.steps) for region in machine.regions if region.steps)
    for owner, members in (steps - regions) + (regions - steps):
        raise Unsound(f"the steps {sorted(members)} of {'the plan' if owner is None else f'step {owner}'} are not those of a region")
    wanted = Counter(ordering for _, flow in owned for ordering in flow.orderings)
    kept = Counter(machine.orderings.values())
    for ordering in kept - wanted:
        raise Unsound(f"the plan does not ask for {ordering}")
    for _, flow in owned:
        position = {event: number for number, event in enumerate(in_order(flow))}
        before: list[list[int]] = [[] for _ in position]
        own = ((PlanEvent(step.index, Moment.START), PlanEvent(step.index, Moment.END)) for step in flow.steps)
        for first, second in (*own, *((ordering.before, ordering.after) for ordering in flow.orderings if ordering in kept)):
            before[position[second]].append(position[first])
        earlier = closure(before)
        for ordering in flow.orderings:
            follows = not ordering.delay and earlier[position[ordering.after]] >> position[ordering.before] & 1
            if ordering not in kept and not follows:
                raise Unsound(f"no place keeps {ordering}")


def _flows(plan: PlanGraph) -> list[tuple[int | None, Flow]]:
    """Return all flows of a plan, each with the step that holds it."""
    return [(None, plan.flow), *((step.index, flow) for step in plan.every_step for flow in flows(step))]


def check_places(plan: PlanGraph, blocks: MachineBlocks) -> None:
    """Check what no block shows by itself.

    The blocks are those of the steps of the plan, begin as their templates do, and are connected as the plan has it: by places between
    them, in an order without a cycle. Delays and release times are waited for.
    """
    _check_order(plan, blocks)
    resources, restarts, held = blocks.resources, blocks.restarts, blocks.held
    _check_marking(blocks)
    steps = {step.index: step for region in blocks.regions for step in region.flow.steps}
    connected = bytearray(blocks.count_places)  # for every place between blocks, 1 if one takes from it, 2 if one gives to it, 3 if both
    places = transitions = 0
    for block in blocks.placed:
        if block.transition != transitions or block.place < places:
            raise Unsound(f"the block of {block.title} overlaps another")
        if block.step is not None and steps.get(block.step.index) is not block.step:
            raise Unsound(f"the block of {block.title} is that of no step of the plan")
        places, transitions = block.place + len(block.template.places), transitions + len(block.template.transitions)
        delays: dict[str, float] = {}
        for number, found in enumerate(block.ports):
            port = None if block.step is None or number >= len(PORTS) else PORTS[number]
            takes = bool(block.template.consumers[~number])  # an end that looks at places gives them back: it still is who takes from them
            for place in found if takes or ~number in block.template.giving else ():
                if isinstance(region := blocks.segment_of(place), PlacedRegion):
                    meant = region.stands_for(place)
                    is_good = not connected[place] & (1 if takes else 2) and _connects(block, port, region.owner, meant, takes=takes)
                    connected[place] |= 1 if takes else 2
                    if port is Port.STARTS_AFTER and isinstance(meant, Ordering) and meant.delay:
                        delays[blocks.place_name(place)] = meant.delay
                elif block.step is None:  # the places of the frame are looked at with its blocks
                    is_good = _is_of_frame(region) or place in restarts
                else:
                    is_good = port is Port.RESOURCES and place in resources
                if not is_good:
                    raise Unsound(f"{blocks.place_name(place)} makes a forbidden connection")
        around = [places for region in held.get(block.step.index, ()) for places in map(region.bordering, Moment)] if block.step else []
        if block.step and [*block.ports[len(PORTS) :]] != around:
            raise Unsound(f"the block of {block.title} is not around the steps that it holds")
        release = block.step.earliest if isinstance(block.step, ActionCall) else 0.0
        for transition, _ in block.template.consumers[~PORTS.index(Port.STARTS_AFTER)] if release or delays else ():
            number = block.transition + transition
            inputs = [blocks.place_name(place) for place, _ in blocks.inputs[number]]
            _check_times(blocks.transition_name(number), blocks.rule(number), inputs, release, delays)
    for region in blocks.regions:
        for place in range(region.place, region.place + region.count):
            if connected[place] != 3:
                raise Unsound(f"{blocks.place_name(place)} does not connect two blocks")


def _check_marking(blocks: MachineBlocks) -> None:
    """Check that at first the start is marked, what blocks begin with, and resources, which belong to the frame."""
    marked = dict(blocks.initial)
    for place, name in blocks.resources.items():
        if marked.pop(place, 0) < 1 or not _is_of_frame(blocks.segment_of(place)):
            raise Unsound(f"there is nothing of the resource {name}")
    own = {block.place + number: count for block in blocks.placed for number, count in block.template.initial.items()}
    if marked != {START: 1, **own}:
        raise Unsound("other places are marked at first than the start and those that blocks begin with")


def _is_of_frame(segment: Segment) -> bool:
    return isinstance(segment, PlacedStep) and segment.step is None


_EVENTS: Final = {Port.STARTS_AFTER: Moment.START, Port.ENDS_AFTER: Moment.END, Port.ANNOUNCES: Moment.START, Port.LEADS_TO: Moment.END}


def _check_order(plan: PlanGraph, blocks: MachineBlocks) -> None:
    """Check that the regions are the flows of the plan, and that every flow has an order of its events."""
    wanted = sorted((one for one in _flows(plan) if one[1].steps), key=_owner)
    if wanted != sorted(((region.owner, region.flow) for region in blocks.regions if region.flow.steps), key=_owner):
        raise Unsound("the steps of the plan are not those of the regions")
    for owner, flow in wanted:
        position = {event: number for number, event in enumerate(plan.order if owner is None else in_order(flow))}
        steps = ((PlanEvent(step.index, Moment.START), PlanEvent(step.index, Moment.END)) for step in flow.steps)
        for before, after in (*((ordering.before, ordering.after) for ordering in flow.orderings), *steps):
            if position[before] >= position[after]:
                raise Unsound(f"blocks wait for each other: {before} < {after}")


def _owner(found: tuple[int | None, Flow]) -> int:
    return -1 if found[0] is None else found[0]


def _connects(block: PlacedStep, port: Port | None, owner: int | None, meant: Ordering | PlanEvent | None, *, takes: bool) -> bool:
    """Return whether a place is connected to a port as what it stands for: that of an event, or one around steps that the block holds."""
    step = None if block.step is None else block.step.index
    if port is None or step is None:  # around the steps that it holds: it gives to the first places, and takes from the last
        return owner == step and (meant is None or (isinstance(meant, PlanEvent) and takes is (meant.moment is Moment.END)))
    if port not in _EVENTS:
        return False
    event = PlanEvent(step, _EVENTS[port])
    if isinstance(meant, Ordering):
        return event == (meant.after if takes else meant.before)
    return event == meant and takes is (event.moment is Moment.START)


def _check_times(name: str, rule: Rule, inputs: Iterable[str], release: float, delays: Mapping[str, float]) -> None:
    """Check that a transition which takes from what the start waits for waits for the times as well, and no longer."""
    seconds, since = (rule.guard.seconds, dict(rule.guard.since)) if isinstance(rule.guard, Due) else (0.0, {})
    wanted = {place: delays[place] for place in inputs if delays.get(place)}
    if (seconds, since) != (release, wanted) and not isinstance(rule.guard, Ending):
        raise Unsound(f"{name} does not wait for the times that the plan gives")


def check_events(machine: PetriNetMachine, block: PlacedBlock, transitions: Collection[str]) -> None:
    """Check that the orderings of a step are kept where its start and its end are.

    What its start waits for is taken before anything else happens, what its end waits for before it is left. That its end marks
    nothing before it has come is explored; its start marks what waits for it when the request begins, or when none will be sent. Delays
    and release times are waited for.
    """
    orderings, net, rules = machine.orderings, machine.net, machine.rules
    for places, moment in ((block.first, Moment.START), (block.rest, Moment.END)):
        for place in places:
            if place in orderings and orderings[place].after.moment is not moment:
                raise Unsound(f"the {moment.value} of step {block.owner} waits for {place}, which stands for {orderings[place]}")
    calls, owner = machine.plan.calls, block.owner
    release = calls[owner].earliest if owner is not None and owner < len(calls) else 0.0
    delays = {place: orderings[place].delay if place in orderings else 0.0 for place in block.first}
    part = block.part
    last = part.outputs | part.finals | part.records
    for name in transitions:
        outputs = net.outputs[name].keys()
        if not delays.keys().isdisjoint(net.inputs[name]):
            _check_times(name, rules[name], net.inputs[name], release, delays)
        if not outputs.isdisjoint(part.ends) and not outputs <= last:
            raise Unsound(f"{name} marks what waits for the end of step {owner}, and goes on")
    if block.early:
        sending = leading_to_a_request(machine, transitions)
        for name in transitions:
            if block.early & net.outputs[name].keys() and rules[name].action not in _BEGINNINGS and sending & net.outputs[name].keys():
                raise Unsound(f"{name} marks what waits for the start of step {owner}, whose request is still to be sent")


def leading_to_a_request(machine: PetriNetMachine, transitions: Collection[str]) -> set[str]:
    """Return the places from which these transitions may lead to a request that is sent."""
    leading: set[str] = set()
    left = [*transitions]
    while now := [one for one in left if machine.rules[one].action is TransitionAction.SEND or leading & machine.net.outputs[one].keys()]:
        leading = leading.union(*(machine.net.inputs[one].keys() - machine.record_places for one in now))
        left = [one for one in left if one not in now]
    return leading


# --- verify ---------------------------------------------------------------------------------------


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
