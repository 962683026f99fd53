"""Small changes of machines: a transition or a place that is gone, an arc more, another rule."""

from __future__ import annotations

from dataclasses import replace

from pnm.core.machine.machine import PetriNetMachine
from pnm.core.net.net import PetriNet, Weights


def without_transition(machine: PetriNetMachine, gone: str) -> PetriNetMachine:
    rules = {name: rule for name, rule in machine.rules.items() if name != gone}
    inputs, outputs = ({name: arcs[name] for name in rules} for arcs in (machine.net.inputs, machine.net.outputs))
    return replace(machine, net=PetriNet(machine.net.places, inputs, outputs), rules=rules)


def without_place(machine: PetriNetMachine, gone: str) -> PetriNetMachine:
    """The machine without a place, and without the ordering that it stands for."""

    def cut(arcs: Weights) -> Weights:
        return {place: weight for place, weight in arcs.items() if place != gone}

    inputs, outputs = ({name: cut(arcs) for name, arcs in every.items()} for every in (machine.net.inputs, machine.net.outputs))
    orderings = {place: ordering for place, ordering in machine.orderings.items() if place != gone}
    places = tuple(place for place in machine.net.places if place != gone)
    return replace(machine, net=PetriNet(places, inputs, outputs), orderings=orderings)


def with_inputs(machine: PetriNetMachine, transition: str, inputs: Weights) -> PetriNetMachine:
    net = machine.net
    return replace(machine, net=PetriNet(net.places, {**net.inputs, transition: inputs}, net.outputs))


def with_outputs(machine: PetriNetMachine, transition: str, outputs: Weights) -> PetriNetMachine:
    net = machine.net
    return replace(machine, net=PetriNet(net.places, net.inputs, {**net.outputs, transition: outputs}))


def with_input(machine: PetriNetMachine, transition: str, place: str) -> PetriNetMachine:
    return with_inputs(machine, transition, {**machine.net.inputs[transition], place: 1})


def with_output(machine: PetriNetMachine, transition: str, place: str) -> PetriNetMachine:
    before = machine.net.outputs[transition]
    return with_outputs(machine, transition, {**before, place: before.get(place, 0) + 1})


def without_output(machine: PetriNetMachine, transition: str, gone: str) -> PetriNetMachine:
    return with_outputs(machine, transition, {place: weight for place, weight in machine.net.outputs[transition].items() if place != gone})


def with_rule(machine: PetriNetMachine, transition: str, **changes: object) -> PetriNetMachine:
    rule = machine.rules[transition]._replace(**changes)  # type: ignore[arg-type]
    return replace(machine, rules={**machine.rules, transition: rule})
