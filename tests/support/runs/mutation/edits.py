"""Edits that break machines: of the net, its rules, its first marking, and what it says of its places."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from random import Random
from typing import Final

from pnm.core.machine.machine import Always, Ends, PetriNetMachine, TransitionAction
from pnm.core.machine.plan_graph import Moment
from pnm.core.machine.requests import OutcomeKind
from pnm.core.net.net import Marking, PetriNet, Weights
from tests.support.runs.mutation.changes import with_rule, without_place, without_transition

Edit = Callable[[PetriNetMachine, Random], PetriNetMachine]
Arcs = Mapping[str, Weights]


def _net(machine: PetriNetMachine, inputs: Arcs | None = None, outputs: Arcs | None = None) -> PetriNetMachine:
    net = machine.net
    return replace(machine, net=PetriNet(net.places, inputs or net.inputs, outputs or net.outputs))


def _arcs(machine: PetriNetMachine, random: Random, change: Callable[[dict[str, int]], None]) -> PetriNetMachine:
    """Change the inputs or the outputs of a transition."""
    name = random.choice(machine.net.transitions)
    if random.random() < 0.5:
        arcs = dict(machine.net.inputs[name])
        change(arcs)
        return _net(machine, inputs={**machine.net.inputs, name: arcs})
    arcs = dict(machine.net.outputs[name])
    change(arcs)
    return _net(machine, outputs={**machine.net.outputs, name: arcs})


def arc_lost(machine: PetriNetMachine, random: Random) -> PetriNetMachine:
    def change(arcs: dict[str, int]) -> None:
        if arcs:
            arcs.pop(random.choice([*arcs]))

    return _arcs(machine, random, change)


def arc_more(machine: PetriNetMachine, random: Random) -> PetriNetMachine:
    return _arcs(machine, random, lambda arcs: arcs.update({random.choice(machine.net.places): 1}))


def arc_moved(machine: PetriNetMachine, random: Random) -> PetriNetMachine:
    def change(arcs: dict[str, int]) -> None:
        if arcs:
            arcs.pop(random.choice([*arcs]))
            arcs[random.choice(machine.net.places)] = 1

    return _arcs(machine, random, change)


def weight(machine: PetriNetMachine, random: Random) -> PetriNetMachine:
    def change(arcs: dict[str, int]) -> None:
        if arcs:
            arcs[random.choice([*arcs])] += random.choice([1, 1, 2])

    return _arcs(machine, random, change)


def transition_lost(machine: PetriNetMachine, random: Random) -> PetriNetMachine:
    return without_transition(machine, random.choice(machine.net.transitions))


def guard_open(machine: PetriNetMachine, random: Random) -> PetriNetMachine:
    name = random.choice(machine.net.transitions)
    return with_rule(machine, name, guard=Always())


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
    if not machine.orderings:
        return machine
    return without_place(machine, random.choice([*machine.orderings]))


def ordering_turned(machine: PetriNetMachine, random: Random) -> PetriNetMachine:
    if not machine.orderings:
        return machine
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


EDITS: Final[tuple[Edit, ...]] = (
    *(arc_lost, arc_more, arc_moved, weight, transition_lost, guard_open, guards_swapped, kinds, deed, marking, roles),
    *(ordering_lost, ordering_turned, rules_reordered),
)


def mutant(machine: PetriNetMachine, random: Random) -> tuple[str, PetriNetMachine]:
    """Return the machine with an edit, or two now and then, and what was done."""
    chosen = random.choices(EDITS, k=2 if random.random() < 0.2 else 1)
    for edit in chosen:
        machine = edit(machine, random)
    return " + ".join(edit.__name__ for edit in chosen), machine
