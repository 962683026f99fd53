"""Machines that are edited: a transition, a place, an arc or a rule is lost, added or changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from pnm.core.machine.machine import PetriNetMachine
from pnm.core.net.net import PetriNet, Weights

Arcs = Mapping[str, Weights]


def with_net(
    machine: PetriNetMachine, *, places: Sequence[str] | None = None, inputs: Arcs | None = None, outputs: Arcs | None = None
) -> PetriNetMachine:
    net = machine.net
    return replace(machine, net=PetriNet(tuple(places or net.places), inputs or net.inputs, outputs or net.outputs))


def with_place(machine: PetriNetMachine, place: str) -> PetriNetMachine:
    return with_net(machine, places=(*machine.net.places, place))


def without_place(machine: PetriNetMachine, place: str) -> PetriNetMachine:
    """The machine without a place and its arcs, and without the ordering that it stands for."""

    def cut(arcs: Arcs) -> Arcs:
        return {name: {other: weight for other, weight in weights.items() if other != place} for name, weights in arcs.items()}

    net = machine.net
    kept = {other: ordering for other, ordering in machine.orderings.items() if other != place}
    places = [other for other in net.places if other != place]
    return replace(with_net(machine, places=places, inputs=cut(net.inputs), outputs=cut(net.outputs)), orderings=kept)


def without_transition(machine: PetriNetMachine, name: str) -> PetriNetMachine:
    def cut(arcs: Arcs) -> Arcs:
        return {other: weights for other, weights in arcs.items() if other != name}

    rules = {other: rule for other, rule in machine.rules.items() if other != name}
    return replace(with_net(machine, inputs=cut(machine.net.inputs), outputs=cut(machine.net.outputs)), rules=rules)


def with_inputs(machine: PetriNetMachine, name: str, inputs: Weights) -> PetriNetMachine:
    return with_net(machine, inputs={**machine.net.inputs, name: inputs})


def with_outputs(machine: PetriNetMachine, name: str, outputs: Weights) -> PetriNetMachine:
    return with_net(machine, outputs={**machine.net.outputs, name: outputs})


def with_input(machine: PetriNetMachine, name: str, place: str) -> PetriNetMachine:
    inputs = machine.net.inputs[name]
    return with_inputs(machine, name, {**inputs, place: inputs.get(place, 0) + 1})


def with_output(machine: PetriNetMachine, name: str, place: str) -> PetriNetMachine:
    outputs = machine.net.outputs[name]
    return with_outputs(machine, name, {**outputs, place: outputs.get(place, 0) + 1})


def without_output(machine: PetriNetMachine, name: str, place: str) -> PetriNetMachine:
    return with_outputs(machine, name, {other: weight for other, weight in machine.net.outputs[name].items() if other != place})


def with_rule(machine: PetriNetMachine, name: str, **changes: object) -> PetriNetMachine:
    return replace(machine, rules={**machine.rules, name: machine.rules[name]._replace(**changes)})  # type: ignore[arg-type]
