"""Machines that are not quite right: each mutant that exploration refutes, the proof block by block has to refute."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from pnm.core.machine.guards import Always, Rule
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.verification.part import Unsound
from pnm.core.machine.verification.verify import explore, verify
from tests.support.runs.mutation.changes import with_output, without_output, without_transition


def mutants(machine: PetriNetMachine) -> list[PetriNetMachine]:
    """The machine with one transition lost, one arc more, one arc less, or one guard always open."""
    found = []
    for name in machine.rules:
        found.append(without_transition(machine, name))
        found += [without_output(machine, name, place) for place in machine.net.outputs[name]]
        found += [with_output(machine, name, place) for place in machine.net.places[:: max(1, len(machine.net.places) // 5)]]
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

    Exploring takes far longer than the proof: of the mutants that the proof refutes, only every tenth is explored.
    """
    refuted: list[PetriNetMachine] = []
    accepted: list[PetriNetMachine] = []
    for mutant in mutants(machine):
        (accepted if _is_sound(mutant, verify) else refuted).append(mutant)
    assert len(refuted) > len(accepted)
    for mutant in accepted:
        explore(mutant)
    explored = refuted[::10]
    assert sum(not _is_sound(mutant, explore) for mutant in explored) > len(explored) / 2
