"""Machines on simulated robots: every way a call can go wrong ends in the goal or in a named failure; late successes are successes."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pnm.actions.faults import FaultKind
from pnm.core.execution.events import Ask, Pause, Stop, Tick
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.computed_values import Layer, Literal, Operation, Query
from pnm.core.logic.conditions import All, Computed, Condition, Holds, evaluate
from pnm.core.logic.effects import Set
from pnm.core.logic.expressions import Constant
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.machine import OnFailure
from pnm.core.machine.plan_graph import ActionCall, GroundAction, PlanGraph
from pnm.core.machine.requests import Ended
from tests.support.runs.commands import begun, report, sent
from tests.support.runs.handover import SUCCEEDED, going
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


@pytest.mark.parametrize("retries", [0, 1, 3])
def test_the_budget_is_the_number_of_retries(retries: int) -> None:
    bindings = Bindings({"move": Binding(retries=retries)})
    done = simulate(TO_KITCHEN, AT_START, fault("move(r1, hall, door)", FaultKind.ABORT), bindings=bindings)
    assert done.attempts() == [1 + retries, 0]
    assert done.outcomes() == ["aborted", "skipped"]


def test_effects_that_something_still_to_come_will_undo_are_not_skipped() -> None:
    leave = replace(move("r1", "door", "yard", 7.0), start_effects=(), end_effects=(Set(("at", "r1", "door"), Constant(False)),))
    back = replace(move("r1", "hall", "door", 8.0), precondition=All(), start_effects=())
    done = simulate(plan_of(leave, back, orders=("0e<1e",), goal=Holds(("at", "r1", "door"))), {("at", "r1", "door"): True})
    assert done.outcomes() == ["succeeded", "succeeded"]
    assert done.result.goal


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


# --- calls that succeed although they are being cancelled: with the same checks as any other ---


LIT, DOOR, HELD, MENDED = ("lit",), ("door",), ("held",), ("mended",)
MEND = GroundAction("mend", invariant=Holds(LIT), end_effects=(Set(MENDED, Constant(True)),), duration=5.0)
OPEN = GroundAction("open", start_effects=(Set(("moving",), Constant(True)),), end_effects=(Set(DOOR, Constant(True)),), duration=5.0)
LET_GO = (Set(HELD, Constant(False)), Set(("down",), Constant(True)))
DROP = GroundAction("drop", end_condition=Holds(HELD), end_effects=LET_GO, duration=5.0)
RUNG = Computed(Operation("eq", (Query(Literal.of("bell"), Layer.GLOBAL, Literal.of(None)), Literal.of("rung"))))
ONCE = Bindings({name: Binding(retries=0) for name in ("mend", "open", "drop")})


def outcomes(run: Run) -> list[str]:
    return [call.outcome for call in run.result().calls]


def test_what_a_call_whose_over_all_condition_broke_would_have_changed_is_not_believed() -> None:
    run = going(MEND, world=KnowledgeBase({LIT: True}))
    (request,) = run.open_requests
    report(run, LIT, False, 2.0)
    run.handle(Ended(request, SUCCEEDED), 2.5)
    assert outcomes(run) == ["invariant_false"], "how its request ended does not make it a success"
    assert not run.knowledge.value(MENDED)


@pytest.mark.parametrize("event", [Stop(cancel=True), Pause(at_once=True), Tick()])
def test_a_condition_that_breaks_while_the_call_is_being_cancelled_breaks_it(event: Stop | Pause | Tick) -> None:
    run = going(MEND, world=KnowledgeBase({LIT: True}), bindings=Bindings({"mend": Binding(retries=0, timeout=1.0)}))
    (request,) = run.open_requests
    run.handle(event, 2.0)
    report(run, LIT, False, 2.5)
    run.handle(Ended(request, SUCCEEDED), 3.0)
    assert not run.knowledge.value(MENDED)
    assert not run.interim_result().calls[0].is_done


@pytest.mark.parametrize(("is_seen", "outcome"), [(True, "succeeded"), (False, "canceled")])
def test_effects_of_a_stopped_call_are_looked_for_as_long_as_their_reports_may_be_late(is_seen: bool, outcome: str) -> None:
    run = going(OPEN, world=KnowledgeBase(sensed={"door": 1.0}), bindings=ONCE)
    (request,) = run.open_requests
    run.handle(Stop(cancel=True), 2.0)
    run.handle(Ended(request, SUCCEEDED), 3.0)
    assert [call.action.name for call in run.settling] == ["open"]
    report(run, DOOR, is_seen, 3.9)
    run.handle(Tick(), 4.0)
    assert outcomes(run) == [outcome]
    assert bool(run.knowledge.value(("moving",))) is is_seen, "what was believed of its start is taken back if it was not so"


def test_what_the_end_of_a_stopped_call_relies_on_is_not_asked_for_any_more() -> None:
    run = going(replace(OPEN, end_condition=RUNG), asks=True)
    (request,) = run.open_requests
    run.handle(Stop(cancel=True), 2.0)
    assert run.handle(Ended(request, SUCCEEDED), 3.0) == []
    assert outcomes(run) == ["canceled"]


def test_what_an_end_relies_on_counts_even_if_the_end_itself_changes_it() -> None:
    run = going(DROP, world=KnowledgeBase({HELD: True}), bindings=ONCE)
    (request,) = run.open_requests
    report(run, HELD, False, 2.0)
    run.handle(Ended(request, SUCCEEDED), 3.0)
    assert outcomes(run) == ["effects_missing"]
    assert run.result().failures[0].expected == "(held)"
    assert not run.knowledge.value(("down",))


def test_what_an_end_relies_on_may_have_to_be_asked_for_once_others_have_ended() -> None:
    run, _ = begun(plan_of(replace(OPEN, end_condition=RUNG), MEND, orders=("1e<0e",)), world=KnowledgeBase({LIT: True}), asks=True)
    opening, mending = run.open_requests
    assert run.handle(Ended(opening, SUCCEEDED), 1.0) == []
    assert any(isinstance(command, Ask) for command in run.handle(Ended(mending, SUCCEEDED), 2.0))


def test_a_goal_that_was_carried_out_before_anything_answered_is_not_sent_again() -> None:
    run, _ = begun(plan_of(OPEN), Bindings({"open": Binding(accept=5.0, retries=3)}))
    run.handle(Tick(), 5.0)
    assert sent(run.handle(Ended(run.open_requests[0], SUCCEEDED), 6.0)) == []
    assert outcomes(run) == ["succeeded"]
    assert [run.knowledge.value(fluent) for fluent in (("moving",), DOOR)] == [True, True]


def test_others_that_wait_for_its_start_go_on() -> None:
    run, _ = begun(plan_of(OPEN, GroundAction("look"), orders=("0s<1s",)), Bindings({"open": Binding(accept=5.0, retries=3)}))
    run.handle(Tick(), 5.0)
    assert sent(run.handle(Ended(run.open_requests[0], SUCCEEDED), 6.0)) == ["look"]
