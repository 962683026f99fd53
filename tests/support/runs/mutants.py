"""Machines that are not quite right: each mutant that exploration refutes, the proof block by block has to refute."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from pnm.core.machine.machine import Always, PetriNetMachine, Rule
from pnm.core.machine.verification.part import Unsound
from pnm.core.machine.verification.verify import explore, verify
from pnm.core.net.net import PetriNet


def _without(net: PetriNet, transition: str) -> PetriNet:
    inputs = {name: weights for name, weights in net.inputs.items() if name != transition}
    return PetriNet(net.places, inputs, {name: net.outputs[name] for name in inputs})


def _with_output(net: PetriNet, transition: str, place: str) -> PetriNet:
    outputs = {**net.outputs, transition: {**net.outputs[transition], place: net.outputs[transition].get(place, 0) + 1}}
    return PetriNet(net.places, net.inputs, outputs)


def _with_input(net: PetriNet, transition: str, place: str) -> PetriNet:
    return PetriNet(net.places, {**net.inputs, transition: {**net.inputs[transition], place: 1}}, net.outputs)


def _less_output(net: PetriNet, transition: str, place: str) -> PetriNet:
    kept = {name: weight for name, weight in net.outputs[transition].items() if name != place}
    return PetriNet(net.places, net.inputs, {**net.outputs, transition: kept})


def mutants(machine: PetriNetMachine) -> list[PetriNetMachine]:
    """The machine with one transition lost, one arc more, one arc less, or one guard always open."""
    found = []
    for name in machine.rules:
        rules = {other: rule for other, rule in machine.rules.items() if other != name}
        found.append(replace(machine, net=_without(machine.net, name), rules=rules))
        found += [replace(machine, net=_less_output(machine.net, name, place)) for place in machine.net.outputs[name]]
        found += [
            replace(machine, net=_with_output(machine.net, name, place))
            for place in machine.net.places[:: max(1, len(machine.net.places) // 5)]
        ]
        found.append(replace(machine, rules={**machine.rules, name: Rule(name, Always(), machine.rules[name].call)}))
    return found


def _is_sound(machine: PetriNetMachine, proof: Callable[[PetriNetMachine], object]) -> bool:
    try:
        proof(machine)
    except Unsound:
        return False
    return True


def check_proof_of_mutants(machine: PetriNetMachine) -> None:
    """Whatever mutant the proof block by block accepts, the state space accepts; most mutants, and most that it refutes, are unsound.

    Exploring takes far longer than the proof: of the mutants that the proof refutes, only every fifth is explored.
    """
    refuted: list[PetriNetMachine] = []
    accepted: list[PetriNetMachine] = []
    for mutant in mutants(machine):
        (accepted if _is_sound(mutant, verify) else refuted).append(mutant)
    assert len(refuted) > len(accepted)
    for mutant in accepted:
        explore(mutant)
    explored = refuted[::5]
    assert sum(not _is_sound(mutant, explore) for mutant in explored) > len(explored) / 2
