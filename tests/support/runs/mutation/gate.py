"""The mutation gate: whatever the proof accepts must go well when it is executed, be it a machine or one that was broken."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from random import Random

from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.verification.part import Unsound
from pnm.core.machine.verification.verify import explore, verify
from tests.support.runs.mutation.edits import mutant
from tests.support.runs.mutation.machines import random_machine
from tests.support.runs.mutation.oracle import fault_of


@dataclass
class GateReport:
    """What became of the mutants. All fields change."""

    machines: int = 0
    verdicts: Counter[str] = field(default_factory=Counter)
    false_accepts: list[str] = field(default_factory=list)

    def judge(self, about: str, is_accepted: bool, fault: Callable[[], str]) -> None:
        """Count a verdict; what is accepted must go well."""
        verdict, wrong = ("accepted", fault()) if is_accepted else ("refused", "")
        self.verdicts[f"{verdict} falsely" if wrong else verdict] += 1
        if wrong:
            self.false_accepts.append(f"{about}: {wrong}")


def is_proved(machine: PetriNetMachine, proof: Callable[[PetriNetMachine], object] = verify) -> bool:
    try:
        proof(machine)
    except Unsound:
        return False
    return True


def run_gate(numbers: range, mutants: int = 6, executions: int = 12) -> GateReport:
    """Prove and execute random machines and mutants of them."""
    report = GateReport()
    for number in numbers:
        machine = random_machine(number)
        verify(machine)
        report.machines += 1
        if fault := fault_of(machine, range(executions)):
            report.false_accepts.append(f"machine {number}: {fault}")
        random = Random(number)
        for count in range(mutants):
            name, broken = mutant(machine, random)
            try:
                accepted = is_proved(broken)
            except Exception as error:  # the proof must say what is wrong
                report.false_accepts.append(f"machine {number}, mutant {count} ({name}): the proof raises {error!r}")
                continue
            report.judge(f"machine {number}, mutant {count} ({name})", accepted, partial(fault_of, broken, range(executions)))
    return report


def check_proof_of_mutants(machine: PetriNetMachine, mutants: int = 150) -> None:
    """Whatever mutant the proof block by block accepts, the state space accepts; most of those that it refutes are unsound.

    Exploring takes far longer than the proof: of the mutants that the proof refutes, only every tenth is explored.
    """
    made = [mutant(machine, Random(number)) for number in range(mutants)]
    refuted = [broken for _, broken in made if not is_proved(broken)]
    assert len(refuted) > mutants / 2
    for name, broken in made:
        assert any(broken is one for one in refuted) or is_proved(broken, explore), name
    explored = refuted[::10]
    assert sum(not is_proved(one, explore) for one in explored) > len(explored) / 3
