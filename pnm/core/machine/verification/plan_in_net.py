"""Is the net that of its plan? The regions are its flows, and every ordering is a place that its two events keep in that order."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection

from pnm.core.machine.machine import Due, Ending, PetriNetMachine, TransitionAction
from pnm.core.machine.plan_graph import Flow, Moment, flows
from pnm.core.machine.verification.decompose import Block
from pnm.core.machine.verification.part import Unsound

_BEGINNINGS = (TransitionAction.BEGIN, TransitionAction.ADOPT)


def check_flows(machine: PetriNetMachine) -> None:
    """Check that the machine has a region for every flow of the plan, and a place for every ordering.

    Raises:
        Unsound: it lacks one, or has one that the plan has not.
    """
    owned: list[tuple[int | None, Flow]] = [(None, machine.plan.flow)]
    owned += ((step.index, flow) for step in machine.plan.every_step for flow in flows(step))
    steps = Counter((owner, frozenset(step.index for step in flow.steps)) for owner, flow in owned if flow.steps)
    regions = Counter((region.owner, region.steps) for region in machine.regions if region.steps)
    for owner, members in (steps - regions) + (regions - steps):
        raise Unsound(f"the steps {sorted(members)} of {'the plan' if owner is None else f'step {owner}'} are not those of a region")
    wanted = Counter(ordering for _, flow in owned for ordering in flow.orderings)
    kept = Counter(machine.orderings.values())
    for ordering in wanted - kept:
        raise Unsound(f"no place keeps {ordering}")
    for ordering in kept - wanted:
        raise Unsound(f"the plan does not ask for {ordering}")


def check_events(machine: PetriNetMachine, block: Block, transitions: Collection[str]) -> None:
    """Check that the orderings of a step are kept where its start and its end are.

    What its start waits for is taken before anything else happens, what its end waits for before it is left. That its end marks
    nothing before it has come is explored; its start marks what waits for it when the request begins, or when none will be sent.

    Raises:
        Unsound: an ordering is not kept so, or a delay or a release time is not waited for.
    """
    orderings, net, rules = machine.orderings, machine.net, machine.rules
    for places, moment in ((block.first, Moment.START), (block.rest, Moment.END)):
        for place in places:
            if place in orderings and orderings[place].after.moment is not moment:
                raise Unsound(f"the {moment.value} of step {block.owner} waits for {place}, which stands for {orderings[place]}")
    calls, owner = machine.plan.calls, block.owner
    release = calls[owner].release if owner is not None and owner < len(calls) and not calls[owner].under_way else 0.0
    delays = {place: orderings[place].delay if place in orderings else 0.0 for place in block.first}
    part = block.part
    last = part.outputs | part.finals | part.records
    for name in transitions:
        guard, outputs = rules[name].guard, net.outputs[name].keys()
        if entered := [place for place in net.inputs[name] if place in delays]:
            seconds, since = (guard.seconds, dict(guard.since)) if isinstance(guard, Due) else (0.0, {})
            is_early = seconds < release or any(since.get(place, 0.0) < delays[place] for place in entered)
            if is_early and not isinstance(guard, Ending):
                raise Unsound(f"{name} does not wait for the times that the plan gives")
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
