"""Edits that break machines: of the net, its rules, its first marking, and what it says of its places."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from math import inf
from random import Random
from typing import Final

from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.guards import After, Always, Due, Ends, Withheld
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.plan_graph import Moment
from pnm.core.machine.requests import CallOutcome, OutcomeKind, TransitionAction
from pnm.core.net.net import Marking, PetriNet, Weights
from tests.support.runs.mutation.changes import with_inputs, with_outputs, with_rule, without_place, without_transition

Edit = Callable[[PetriNetMachine, Random], PetriNetMachine]


def arcs(machine: PetriNetMachine, random: Random) -> PetriNetMachine:
    """Let an arc be lost, added, moved, or weigh more."""
    net, name = machine.net, random.choice(machine.net.transitions)
    changed, of = random.choice([(with_inputs, net.inputs), (with_outputs, net.outputs)])
    weights = dict(of[name])
    place, other = random.choice([*weights]), random.choice(net.places)
    match random.randrange(4):
        case 0:
            del weights[place]
        case 1:
            weights[other] = 1
        case 2:
            del weights[place]
            weights[other] = 1
        case _:
            weights[place] += random.choice([1, 1, 2])
    return changed(machine, name, weights)


def transition_lost(machine: PetriNetMachine, random: Random) -> PetriNetMachine:
    return without_transition(machine, random.choice(machine.net.transitions))


def guard_open(machine: PetriNetMachine, random: Random) -> PetriNetMachine:
    return with_rule(machine, random.choice(machine.net.transitions), guard=Always())


def guards_swapped(machine: PetriNetMachine, random: Random) -> PetriNetMachine:
    names = random.sample(machine.net.transitions, 2)
    one, other = (machine.rules[name] for name in names)
    if one.call != other.call:
        return machine
    changed = {names[0]: one._replace(guard=other.guard), names[1]: other._replace(guard=one.guard)}
    return replace(machine, rules={**machine.rules, **changed})


def kinds(machine: PetriNetMachine, random: Random) -> PetriNetMachine:
    name, guard = random.choice([(name, rule.guard) for name, rule in machine.rules.items() if isinstance(rule.guard, Ends)])
    return with_rule(machine, name, guard=Ends(guard.call, guard.kinds ^ {random.choice([*OutcomeKind])}))


def deed(machine: PetriNetMachine, random: Random) -> PetriNetMachine:
    name = random.choice([name for name, rule in machine.rules.items() if rule.call is not None])
    return with_rule(machine, name, action=random.choice([None, *TransitionAction]))


def marking(machine: PetriNetMachine, random: Random) -> PetriNetMachine:
    place = random.choice(machine.net.places)
    tokens = dict(machine.initial)
    tokens[place] = tokens.get(place, 0) + random.choice([1, -1]) if tokens.get(place) else 1
    return replace(machine, initial=Marking({one: count for one, count in tokens.items() if count}))


def roles(machine: PetriNetMachine, random: Random) -> PetriNetMachine:
    place = random.choice(machine.net.places)
    match random.randrange(6):
        case 0:
            return replace(machine, failure_places={one: call for one, call in machine.failure_places.items() if random.random() < 0.5})
        case 1:
            return replace(machine, budget_places=machine.budget_places ^ {place})
        case 2:
            return replace(machine, alive_places=machine.alive_places ^ {place})
        case 3:
            return replace(machine, goal_place=machine.failed_place, failed_place=machine.goal_place)
        case 4:
            return replace(machine, goal_place=place)
        case _:
            return replace(machine, failure_places={**machine.failure_places, place: 0})


def ordering_lost(machine: PetriNetMachine, random: Random) -> PetriNetMachine:
    return without_place(machine, random.choice([*machine.orderings]))


def ordering_turned(machine: PetriNetMachine, random: Random) -> PetriNetMachine:
    place = random.choice([*machine.orderings])
    one = machine.orderings[place]
    moment = Moment.START if one.after.moment is Moment.END else Moment.END
    other = replace(one, after=one.after._replace(moment=moment))
    return replace(machine, orderings={**machine.orderings, place: other})


def rules_reordered(machine: PetriNetMachine, random: Random) -> PetriNetMachine:
    names = [*machine.net.transitions]
    first, second = random.sample(range(len(names)), 2)
    names[first], names[second] = names[second], names[first]
    net = PetriNet(machine.net.places, {one: machine.net.inputs[one] for one in names}, {one: machine.net.outputs[one] for one in names})
    return replace(machine, net=net, rules={one: machine.rules[one] for one in names})


def places_merged(machine: PetriNetMachine, random: Random) -> PetriNetMachine:
    one, other = random.sample(machine.net.places, 2)

    def merged(arcs: Mapping[str, Weights]) -> Mapping[str, Weights]:
        return {
            name: {place: weights.get(place, 0) + (weights.get(other, 0) if place == one else 0) for place in _renamed(weights, other, one)}
            for name, weights in arcs.items()
        }

    net = PetriNet(tuple(place for place in machine.net.places if place != other), merged(machine.net.inputs), merged(machine.net.outputs))
    tokens = dict(machine.initial)
    tokens[one] = tokens.get(one, 0) + tokens.pop(other, 0)
    return replace(machine, net=net, initial=Marking({place: count for place, count in tokens.items() if count}))


def _renamed(places: Iterable[str], old: str, new: str) -> list[str]:
    return [*dict.fromkeys(new if place == old else place for place in places)]


def twin(machine: PetriNetMachine, random: Random) -> PetriNetMachine:
    """Let two steps of the net do the same, the second perhaps elsewhere in the order, or from elsewhere."""
    name = random.choice(machine.net.transitions)
    net, copy = machine.net, f"{name} again"
    inputs = net.inputs[name] if random.random() < 0.5 else {random.choice(net.places): 1}
    names = [*net.transitions]
    names.insert(random.randrange(len(names) + 1), copy)
    arcs = {**net.inputs, copy: inputs}, {**net.outputs, copy: net.outputs[name]}
    ordered = PetriNet(net.places, *({one: every[one] for one in names} for every in arcs))
    rules = {**machine.rules, copy: machine.rules[name]}
    return replace(machine, net=ordered, rules={one: rules[one] for one in names})


def owner(machine: PetriNetMachine, random: Random) -> PetriNetMachine:
    numbers = [None, *(step.index for step in machine.plan.every_step)]
    return with_rule(machine, random.choice(machine.net.transitions), call=random.choice(numbers))


def guard_moved(machine: PetriNetMachine, random: Random) -> PetriNetMachine:
    """Give a step of the net the guard of another, made to fit."""
    name, other = random.sample(machine.net.transitions, 2)
    guard, call = machine.rules[other].guard, machine.rules[name].call
    fits = replace(guard, call=call) if getattr(guard, "call", None) is not None and call is not None else guard
    return with_rule(machine, name, guard=fits)


def remark(machine: PetriNetMachine, random: Random) -> PetriNetMachine:
    """Change what a rule says besides its guard and its action."""
    name = random.choice(machine.net.transitions)
    rule = machine.rules[name]
    changes: tuple[dict[str, object], ...] = (
        {"gives_up": not rule.gives_up},
        {"cause": random.choice([None, *Cause])},
        {"outcome": random.choice([None, *CallOutcome])},
    )
    return with_rule(machine, name, **random.choice(changes))


def region(machine: PetriNetMachine, random: Random) -> PetriNetMachine:
    number = random.randrange(len(machine.regions))
    changed, place = machine.regions[number], random.choice(machine.net.places)
    match random.randrange(4):
        case 0:
            changed = replace(changed, first=(*changed.first[1:], place))
        case 1:
            changed = replace(changed, last=(*changed.last[1:], place))
        case 2:
            changed = replace(changed, steps=frozenset([*changed.steps][1:]))
        case _:
            changed = replace(changed, owner=random.choice([None, *(step.index for step in machine.plan.every_step)]))
    return replace(machine, regions=(*machine.regions[:number], changed, *machine.regions[number + 1 :]))


def limit_lost(machine: PetriNetMachine, random: Random) -> PetriNetMachine:
    """Let a limit be infinite."""
    timed = [(name, rule.guard) for name, rule in machine.rules.items() if isinstance(rule.guard, After | Due | Withheld)]
    name, guard = random.choice(timed)
    return with_rule(machine, name, guard=replace(guard, seconds=inf))


EDITS: Final[tuple[Edit, ...]] = (
    *(arcs, arcs, arcs, arcs, transition_lost, guard_open, guards_swapped, kinds, deed, marking, roles),
    *(ordering_lost, ordering_turned, rules_reordered, places_merged, twin, owner, guard_moved, remark, region, limit_lost),
)


def mutant(machine: PetriNetMachine, random: Random) -> tuple[str, PetriNetMachine]:
    """Return the machine with an edit, or two now and then, and what was done."""
    done: list[str] = []
    wanted = 2 if random.random() < 0.2 else 1
    while len(done) < wanted:
        edit = random.choice(EDITS)
        try:
            machine = edit(machine, random)
        except IndexError:  # there is nothing of that to be changed
            continue
        done.append(edit.__name__)
    return " + ".join(done), machine
