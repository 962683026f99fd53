"""Counters in the proof: its work grows with the recoveries of a call, not with their combinations, and nothing that hangs gets through."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import pytest

from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.generate import generate
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.plan_graph import ActionCall, Flow, GroundAction, PlanGraph, Recovery, Then
from pnm.core.machine.verification.part import Unsound
from pnm.core.machine.verification.verify import explore, forget_proofs, verify
from pnm.core.net.net import PetriNet
from tests.support.runs.mutation.changes import without_transition

CAUSES = (
    *(Cause.ABORTED, Cause.CANCELED, Cause.REJECTED, Cause.UNAVAILABLE, Cause.TIMED_OUT, Cause.LOST),
    *(Cause.DATA_MISSING, Cause.PRECONDITION_FALSE, Cause.EFFECTS_MISSING, Cause.BEFORE, Cause.AFTER),
)


def recovering(count: int, times: int = 3) -> PetriNetMachine:
    chains = [Flow((ActionCall(index + 1, GroundAction("wait")),)) for index in range(count)]
    recoveries = tuple(Recovery(frozenset({cause}), Then.RETRY, chain, times) for cause, chain in zip(CAUSES, chains, strict=False))
    return generate(PlanGraph((ActionCall(0, GroundAction("a"), recoveries=recoveries),)))


def states(machine: PetriNetMachine) -> int:
    forget_proofs()
    return verify(machine).states


def test_every_recovery_costs_the_proof_about_the_same() -> None:
    found = [states(recovering(count)) for count in range(1, len(CAUSES) + 1)]
    steps = [after - before for before, after in pairwise(found)]
    assert max(steps) <= 5 * min(steps)
    assert found[-1] < 1_000


def test_how_often_makes_no_difference() -> None:
    assert states(recovering(2, 2)) == states(recovering(2, 50))


@pytest.mark.parametrize("times", [1, 2, 3])
@pytest.mark.parametrize("gone", ["a()#0 give_up 0", "a()#0 recover 0"])
def test_a_counter_that_runs_out_needs_another_way(times: int, gone: str) -> None:
    broken = without_transition(recovering(1, times), gone)
    with pytest.raises(Unsound):
        explore(broken)
    with pytest.raises(Unsound):
        verify(broken)


@pytest.mark.parametrize("prove", [verify, explore])
def test_what_is_counted_back_while_it_is_counted_is_refused(prove: Callable[[PetriNetMachine], object]) -> None:
    machine = recovering(1)
    net, name, more = machine.net, "a()#0 retry 0", "a()#0 retry for ever"
    inputs = {more: {**net.inputs[name], "a()#0 uses spent 0": 1}, **net.inputs}
    outputs = {more: {**net.outputs[name], "a()#0 uses left 0": 1}, **net.outputs}
    endless = replace(machine, net=PetriNet(net.places, inputs, outputs), rules={more: machine.rules[name], **machine.rules})
    with pytest.raises(Unsound, match="for ever"):
        prove(endless)
