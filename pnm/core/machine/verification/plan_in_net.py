"""Is the net that of its plan? The regions are its flows, and every ordering is kept: by a place between its events, or by others."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from typing import Final

from pnm.core.machine.blocks import START, MachineBlocks, PlacedRegion, PlacedStep
from pnm.core.machine.guards import Due, Ending, Rule
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.plan_graph import ActionCall, Flow, Moment, Ordering, PlanEvent, PlanGraph, flows, in_order
from pnm.core.machine.requests import TransitionAction
from pnm.core.machine.step_block import PORTS, Port
from pnm.core.machine.verification.decompose import PlacedBlock
from pnm.core.machine.verification.part import Unsound
from pnm.core.net.block_net import Segment
from pnm.core.net.orders import closure

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
