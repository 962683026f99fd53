"""Machines on simulated robots: every way a call can go wrong ends in the goal or in a named failure."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pnm.actions.faults import FaultKind
from pnm.core.logic.conditions import All, Condition, Holds, evaluate
from pnm.core.logic.effects import Set
from pnm.core.logic.expressions import Constant
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.machine import OnFailure
from pnm.core.machine.plan_graph import ActionCall, GroundAction, PlanGraph
from tests.support.runs.plan_graphs import ordering, plan_of
from tests.support.runs.simulated import SimulatedRun, fault, hidden, move, simulate

AT_START = {("at", "r1", "hall"): True, ("at", "r2", "hall"): True}


GOAL = Holds(("at", "r1", "kitchen"))
TO_KITCHEN = plan_of(move("r1", "hall", "door"), move("r1", "door", "kitchen"), orders=("0e<1s",), goal=GOAL)


def assert_true_to_the_world(simulation: SimulatedRun, goal: Condition = GOAL) -> None:
    assert simulation.result.goal == (evaluate(goal, simulation.truth) is True)


@pytest.mark.parametrize(
    ("kind", "cause"),
    [
        (FaultKind.ABORT, "aborted"),
        (FaultKind.REJECT, "rejected"),
        (FaultKind.HANG, "timed_out"),
        (FaultKind.NO_EFFECT, "effects_missing"),
        (FaultKind.SLOW, "timed_out"),
        (FaultKind.LOSE_SERVER, "unavailable"),
    ],
)
def test_a_lasting_fault_is_retried_and_then_named(kind: FaultKind, cause: str) -> None:
    done = simulate(TO_KITCHEN, AT_START, fault("move(r1, door, kitchen)", kind))
    assert not done.result.goal
    assert_true_to_the_world(done)
    assert done.causes() == [cause]
    assert done.attempts() == [1, 2]
    assert not done.log.orphans


@pytest.mark.parametrize("kind", [kind for kind in FaultKind if kind is not FaultKind.LOSE_SERVER])
def test_a_passing_fault_is_overcome_by_a_retry(kind: FaultKind) -> None:
    done = simulate(TO_KITCHEN, AT_START, fault("move(r1, door, kitchen)", kind, times=1))
    assert done.result.goal
    assert_true_to_the_world(done)
    assert done.attempts() == [1, 2]
    assert done.outcomes() == ["succeeded", "succeeded"]


def test_a_fault_may_come_late() -> None:
    done = simulate(TO_KITCHEN, AT_START, fault("move", FaultKind.ABORT, after=1, times=1))
    assert done.result.goal
    assert done.attempts() == [1, 2]


@pytest.mark.parametrize("retries", [0, 1, 3])
def test_the_budget_is_the_number_of_retries(retries: int) -> None:
    bindings = Bindings({"move": Binding(retries=retries)})
    done = simulate(TO_KITCHEN, AT_START, fault("move(r1, hall, door)", FaultKind.ABORT), bindings=bindings)
    assert done.attempts() == [1 + retries, 0]
    assert done.outcomes() == ["aborted", "skipped"]


def test_a_server_that_ignores_its_cancellation_is_not_asked_again() -> None:
    bindings = Bindings({"move": Binding(timeout=6.0, cancel=2.0, retries=5)})
    done = simulate(TO_KITCHEN, AT_START, fault("move(r1, hall, door)", FaultKind.HANG, ignores_cancel=True), bindings=bindings)
    assert done.log.times("unconfirmed") == [8.0]
    assert done.attempts() == [1, 0]
    assert done.causes() == ["timed_out"]


def test_a_false_precondition_is_found_before_anything_moves() -> None:
    done = simulate(TO_KITCHEN, {("at", "r1", "cellar"): True})
    assert done.causes() == ["precondition_false"]
    assert done.result.failures[0].expected == "(at r1 hall)"
    assert done.result.failures[0].observed == "(at r1 hall) is false"
    assert done.attempts() == [0, 0]


def test_effects_that_hold_already_are_skipped() -> None:
    done = simulate(plan_of(move("r1", "hall", "door"), goal=Holds(("at", "r1", "door"))), {("at", "r1", "door"): True})
    assert done.result.goal
    assert done.outcomes() == ["already true"]
    assert done.attempts() == [0]


def test_effects_that_something_still_to_come_will_undo_are_not_skipped() -> None:
    leave = replace(move("r1", "door", "yard", 7.0), start_effects=(), end_effects=(Set(("at", "r1", "door"), Constant(False)),))
    back = replace(move("r1", "hall", "door", 8.0), precondition=All(), start_effects=())
    done = simulate(plan_of(leave, back, orders=("0e<1e",), goal=Holds(("at", "r1", "door"))), {("at", "r1", "door"): True})
    assert done.outcomes() == ["succeeded", "succeeded"]
    assert done.result.goal


HOLD = GroundAction(
    "hold", ("r1",), ("robot",), invariant=Holds(("ok",)), end_effects=(Set(("at", "r1", "kitchen"), Constant(True)),), duration=9.0
)


def test_an_over_all_condition_that_nobody_watches_fails_in_the_world() -> None:
    bindings = Bindings({"hold": Binding(retries=0)})
    done = simulate(plan_of(HOLD, goal=GOAL), {("ok",): True}, hidden({("ok",): False}, at=3.0), watched=False, bindings=bindings)
    assert done.causes() == ["aborted"]
    assert_true_to_the_world(done)


def test_stopping_a_run_cancels_what_runs_and_reports_no_success() -> None:
    done = simulate(TO_KITCHEN, AT_START, stop_at=2.0)
    assert not done.result.goal
    assert done.result.stopped
    assert done.result.reason == "cancelled"
    assert done.outcomes() == ["canceled", "skipped"]
    assert done.truth.value(("at", "r1", "hall")) is True


@pytest.mark.parametrize(("on_failure", "outcome", "end"), [(OnFailure.DRAIN, "succeeded", "door"), (OnFailure.CANCEL, "canceled", "hall")])
def test_siblings_are_treated_by_the_policy_when_a_call_has_failed(on_failure: OnFailure, outcome: str, end: str) -> None:
    plan = plan_of(move("r1", "hall", "door", 4.0), move("r2", "hall", "door", 20.0), move("r2", "door", "yard"), orders=("1e<2s",))
    done = simulate(plan, AT_START, fault("move(r1, hall, door)", FaultKind.ABORT), on_failure=on_failure)
    assert done.outcomes() == ["aborted", outcome, "skipped"]
    assert done.truth.value(("at", "r2", end)) is True


def moves(*seconds: float, orders: tuple[str, ...] = ()) -> PlanGraph:
    """Moves of as many robots, which take so long."""
    return plan_of(*(move(f"r{number}", "hall", "door", each) for number, each in enumerate(seconds, 1)), orders=orders)


@pytest.mark.parametrize(
    ("plan", "times"),
    [
        (moves(4.0, 6.0), [(0.0, 4.0), (0.0, 6.0)]),
        (moves(10.0, 4.0, orders=("0s<1s",)), [(0.0, 10.0), (0.0, 4.0)]),
        (moves(2.0, 8.0, orders=("1e<0e",)), [(0.0, 8.0), (0.0, 8.0)]),
        (replace(moves(20.0, 20.0), orderings=(replace(ordering("0s<1s"), delay=7.0),)), [(0.0, 20.0), (7.0, 27.0)]),
        (PlanGraph((ActionCall(0, move("r1", "hall", "door"), release=30.0),)), [(30.0, 34.0)]),
    ],
)
def test_calls_start_and_end_when_the_plan_has_them(plan: PlanGraph, times: list[tuple[float, float]]) -> None:
    assert [(call.started, call.ended) for call in simulate(plan, AT_START).result.calls] == times


def test_a_rejected_start_is_not_announced() -> None:
    done = simulate(moves(10.0, 4.0, orders=("0s<1s",)), AT_START, fault("move(r1, hall, door)", FaultKind.REJECT))
    assert done.outcomes() == ["rejected", "skipped"]


def test_a_delay_is_overtaken_when_the_run_ends() -> None:
    later = replace(moves(2.0, 2.0), orderings=(replace(ordering("0e<1s"), delay=100.0),))
    done = simulate(later, AT_START, fault("move(r1, hall, door)", FaultKind.ABORT))
    assert done.outcomes() == ["aborted", "skipped"]
    assert done.log.fired_at[-1][0] < 10.0


def test_a_call_that_is_not_over_by_its_deadline_is_cancelled() -> None:
    done = simulate(PlanGraph((ActionCall(0, move("r1", "hall", "door", 20.0), deadline=15.0),)), AT_START)
    assert done.causes() == ["deadline_missed"]
    assert done.log.times("deadline_missed") == [15.0]
    assert done.result.failures[0].expected == "an end within 15 s of the plan's start"
    assert_true_to_the_world(done)


def test_a_call_is_not_started_after_its_deadline() -> None:
    calls = ActionCall(0, move("r1", "hall", "door", 20.0)), ActionCall(1, move("r2", "hall", "door"), deadline=15.0)
    done = simulate(PlanGraph(calls, (ordering("0e<1s"),)), AT_START)
    assert done.causes() == ["too_late"]
    assert done.attempts() == [1, 0]


def test_unwatched_effects_are_assumed_and_that_is_said() -> None:
    done = simulate(TO_KITCHEN, AT_START, watched=False)
    assert done.result.goal
    assert all(call.assumed for call in done.result.calls)
    assert done.beliefs.value(("at", "r1", "kitchen")) is True


def test_every_call_done_is_not_yet_the_goal() -> None:
    elsewhere = hidden({("at", "r1", "kitchen"): False}, at=9.0)
    last = move("r2", "hall", "door", 20.0)
    plan = plan_of(move("r1", "hall", "door"), move("r1", "door", "kitchen"), last, orders=("0e<1s",), goal=GOAL)
    done = simulate(plan, AT_START, elsewhere)
    assert not done.result.goal
    assert done.result.failures == ()
    assert (
        done.result.reason == "every call is done but the goal does not hold: expected (at r1 kitchen); observed (at r1 kitchen) is false"
    )


def test_an_empty_plan_reaches_a_goal_that_holds() -> None:
    assert simulate(plan_of(goal=Holds(("at", "r1", "hall"))), AT_START).result.goal
    assert not simulate(plan_of(goal=GOAL), AT_START).result.goal
