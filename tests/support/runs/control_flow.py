"""Plans with loops, choices and recoveries."""

from __future__ import annotations

from dataclasses import replace

from pnm.core.logic.computed_values import Data, Layer, Literal, Operation, Query, Update
from pnm.core.logic.conditions import Computed, Condition, Holds
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.plan_graph import EMPTY, ActionCall, Choice, Flow, GroundAction, Junction, Loop, Recovery, Step, Then, WaitUntil
from tests.support.runs.plan_graphs import ordering, plan_of_steps

OK: Condition = Holds(("ok",))


def call_with(index: int, *recoveries: Recovery, resources: tuple[str, ...] = ()) -> ActionCall:
    return ActionCall(index, GroundAction(f"a{index}", resources=resources), recoveries=recoveries)


def flow(*steps: Step, orders: tuple[str, ...] = ()) -> Flow:
    return Flow(steps, tuple(map(ordering, orders)))


def on(cause: Cause, then: Then, *chain: Step, times: int = 1) -> Recovery:
    return Recovery(frozenset({cause}), then, flow(*chain), times, OK)


SHAPES = {
    "loop": plan_of_steps(Loop(1, OK, flow(call_with(0)), 2)),
    "empty loop": plan_of_steps(Loop(0, OK, EMPTY, 3)),
    "loop in a loop": plan_of_steps(Loop(0, OK, flow(Loop(1, OK, EMPTY, 1)), 2)),
    "choice": plan_of_steps(Choice(2, OK, flow(call_with(0)), flow(call_with(1)))),
    "choice without else": plan_of_steps(Choice(1, OK, flow(call_with(0)), EMPTY)),
    "choice in a loop": plan_of_steps(Loop(1, OK, flow(Choice(2, OK, flow(call_with(0)), EMPTY)), 1)),
    "wait": plan_of_steps(WaitUntil(0, OK, 5.0)),
    "wait beside a call": plan_of_steps(WaitUntil(1, OK, 5.0), call_with(0)),
    "wait in a loop": plan_of_steps(Loop(1, OK, flow(WaitUntil(0, OK, 5.0)), 2)),
    "wait in a chain": plan_of_steps(call_with(0, on(Cause.ABORTED, Then.RETRY, WaitUntil(1, OK, 5.0)))),
    "junction": plan_of_steps(Junction(0), Junction(1), Junction(2), orders=("0e<2s", "1e<2s")),
    "retry": plan_of_steps(call_with(0, on(Cause.ABORTED, Then.RETRY, times=2))),
    "skip": plan_of_steps(call_with(0, on(Cause.ABORTED, Then.SKIP))),
    "continue": plan_of_steps(call_with(0, on(Cause.CANCELED, Then.CONTINUE))),
    "fail": plan_of_steps(call_with(0, on(Cause.EFFECTS_MISSING, Then.FAIL))),
    "replan": plan_of_steps(call_with(0, on(Cause.ABORTED, Then.REPLAN))),
    "restart": plan_of_steps(call_with(0, on(Cause.ABORTED, Then.RESTART_PLAN))),
    "chain and retry": plan_of_steps(call_with(0, on(Cause.ABORTED, Then.RETRY, call_with(1), times=2))),
    "own check before": plan_of_steps(call_with(0, on(Cause.BEFORE, Then.SKIP, call_with(1)))),
    "own check after": plan_of_steps(call_with(0, on(Cause.AFTER, Then.RETRY))),
    "under way": plan_of_steps(replace(call_with(0, resources=("arm",)), under_way=True)),
    "resource": plan_of_steps(call_with(0, resources=("arm",)), call_with(1, resources=("arm",))),
    "resource and an end that waits": plan_of_steps(call_with(0, resources=("arm",)), call_with(1, resources=("arm",)), orders=("1s<0e",)),
}
LARGE = {
    "restart beside another call": plan_of_steps(call_with(0, on(Cause.ABORTED, Then.RESTART_PLAN)), call_with(1)),
    "two restarts": plan_of_steps(call_with(0, on(Cause.ABORTED, Then.RESTART_PLAN)), call_with(1, on(Cause.ABORTED, Then.RESTART_PLAN))),
    "retry in a loop": plan_of_steps(Loop(2, OK, flow(call_with(0, on(Cause.ABORTED, Then.RETRY, call_with(1)))), 2)),
    "loop beside a chain": plan_of_steps(Loop(3, OK, flow(call_with(0)), 1), call_with(1), call_with(2), orders=("1e<2s",)),
    "many rounds": plan_of_steps(Loop(1, OK, flow(call_with(0)), 1000)),
    "chain that needs more": plan_of_steps(
        call_with(0, on(Cause.ABORTED, Then.RETRY, call_with(1, resources=("leg",))), resources=("arm",)),
        call_with(2, on(Cause.ABORTED, Then.RETRY, call_with(3, resources=("arm",))), resources=("leg",)),
    ),
}


def local(name: str) -> Query:
    return Query(Literal.of(name), Layer.LOCAL)


def store(index: int, name: str, value: Data, layer: Layer = Layer.LOCAL) -> ActionCall:
    return ActionCall(index, GroundAction("store", operation=Update(Literal.of(name), value, layer)))


def ne(name: str, value: object) -> Condition:
    return Computed(Operation("ne", (local(name), Literal.of(value))))
