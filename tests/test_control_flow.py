"""Loops, choices, recoveries and resources: sound machines, and runs that do what the plan says."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pnm.analysis import explore, verify
from pnm.bindings import Binding, Bindings
from pnm.conditions import Condition, Holds
from pnm.generation import generate
from pnm.machine import OnFailure
from pnm.plan_graph import EMPTY, ActionCall, Cause, Choice, Flow, GroundAction, Junction, Loop, PlanGraph, Recovery, Step, Then
from pnm.state_space import Unsound
from tests.machines import ordering
from tests.test_machine import mutants

OK: Condition = Holds(("ok",))
ONCE = Bindings({f"a{index}": Binding(retries=0) for index in range(10)})


def call(index: int, *recoveries: Recovery, resources: tuple[str, ...] = ()) -> ActionCall:
    return ActionCall(index, GroundAction(f"a{index}", resources=resources), recoveries=recoveries)


def flow(*steps: Step, orders: tuple[str, ...] = ()) -> Flow:
    return Flow(steps, tuple(map(ordering, orders)))


def plan(*steps: Step, orders: tuple[str, ...] = ()) -> PlanGraph:
    return PlanGraph(steps, tuple(map(ordering, orders)))


def on(cause: Cause, then: Then, *chain: Step, times: int = 1) -> Recovery:
    return Recovery(frozenset({cause}), then, flow(*chain), times, OK)


SHAPES = {
    "loop": plan(Loop(1, OK, flow(call(0)), 2)),
    "empty loop": plan(Loop(0, OK, EMPTY, 3)),
    "loop in a loop": plan(Loop(0, OK, flow(Loop(1, OK, EMPTY, 1)), 2)),
    "choice": plan(Choice(2, OK, flow(call(0)), flow(call(1)))),
    "choice without else": plan(Choice(1, OK, flow(call(0)), EMPTY)),
    "choice in a loop": plan(Loop(1, OK, flow(Choice(2, OK, flow(call(0)), EMPTY)), 1)),
    "junction": plan(Junction(0), Junction(1), Junction(2), orders=("0e<2s", "1e<2s")),
    "retry": plan(call(0, on(Cause.ABORTED, Then.RETRY, times=2))),
    "skip": plan(call(0, on(Cause.ABORTED, Then.SKIP))),
    "continue": plan(call(0, on(Cause.CANCELED, Then.CONTINUE))),
    "fail": plan(call(0, on(Cause.EFFECTS_MISSING, Then.FAIL))),
    "replan": plan(call(0, on(Cause.ABORTED, Then.REPLAN))),
    "restart": plan(call(0, on(Cause.ABORTED, Then.RESTART_PLAN))),
    "chain and retry": plan(call(0, on(Cause.ABORTED, Then.RETRY, call(1), times=2))),
    "own check before": plan(call(0, on(Cause.BEFORE, Then.SKIP, call(1)))),
    "own check after": plan(call(0, on(Cause.AFTER, Then.RETRY))),
    "resource": plan(call(0, resources=("arm",)), call(1, resources=("arm",))),
}
LARGE = {
    "restart beside another call": plan(call(0, on(Cause.ABORTED, Then.RESTART_PLAN)), call(1)),
    "two restarts": plan(call(0, on(Cause.ABORTED, Then.RESTART_PLAN)), call(1, on(Cause.ABORTED, Then.RESTART_PLAN))),
    "retry in a loop": plan(Loop(2, OK, flow(call(0, on(Cause.ABORTED, Then.RETRY, call(1)))), 2)),
    "loop beside a chain": plan(Loop(3, OK, flow(call(0)), 1), call(1), call(2), orders=("1e<2s",)),
    "many rounds": plan(Loop(1, OK, flow(call(0)), 1000)),
    "chain that needs more": plan(
        call(0, on(Cause.ABORTED, Then.RETRY, call(1, resources=("leg",))), resources=("arm",)),
        call(2, on(Cause.ABORTED, Then.RETRY, call(3, resources=("arm",))), resources=("leg",)),
    ),
}


@pytest.mark.parametrize("on_failure", OnFailure)
@pytest.mark.parametrize("name", SHAPES)
def test_every_answer_of_the_world_leads_to_goal_or_failed(name: str, on_failure: OnFailure) -> None:
    machine = generate(SHAPES[name], ONCE, on_failure=on_failure)
    explore(machine)
    verify(machine)


@pytest.mark.parametrize("name", LARGE)
def test_larger_machines_are_proved_block_by_block(name: str) -> None:
    verify(generate(LARGE[name], ONCE))


@pytest.mark.parametrize("name", ["loop", "choice in a loop", "loop in a loop", "retry", "restart", "resource", "own check before"])
def test_the_block_proof_accepts_no_machine_that_the_state_space_refutes(name: str) -> None:
    refuted = accepted = 0
    for mutant in mutants(generate(SHAPES[name], ONCE)):
        try:
            explore(mutant)
        except Unsound:
            refuted += 1
            with pytest.raises(Unsound):
                verify(mutant)
        else:
            accepted += 1
    assert refuted > accepted
