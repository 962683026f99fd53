"""Loops, choices, recoveries and resources: sound machines, and runs that do what the plan says."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pnm.core.execution.events import Ask, Pause, Resume, Tick
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.computed_values import Layer, Literal, Operation, Query
from pnm.core.logic.conditions import Computed
from pnm.core.logic.expressions import UNKNOWN
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.generate import generate
from pnm.core.machine.machine import OnFailure
from pnm.core.machine.plan_graph import ActionCall, Choice, Loop, PlanGraph, Recovery, Then, WaitUntil
from pnm.core.machine.verification.part import Unsound
from pnm.core.machine.verification.verify import explore, verify
from tests.support.runs.commands import begun
from tests.support.runs.control_flow import LARGE, SHAPES, call_with, flow, local, ne, on, store
from tests.support.runs.direct import answering_with, drive
from tests.support.runs.mutation.changes import without_output
from tests.support.runs.mutation.gate import check_proof_of_mutants
from tests.support.runs.plan_graphs import plan_of_steps

READY = Computed(Operation("eq", (local("n"), Literal.of(1))))
ONCE = Bindings({f"a{index}": Binding(retries=0) for index in range(10)})


@pytest.mark.parametrize("on_failure", [OnFailure.DRAIN, OnFailure.CANCEL])
@pytest.mark.parametrize("name", SHAPES)
def test_every_answer_of_the_world_leads_to_goal_or_failed(name: str, on_failure: OnFailure) -> None:
    machine = generate(SHAPES[name], ONCE, on_failure=on_failure)
    explore(machine)
    verify(machine)


@pytest.mark.parametrize("name", LARGE)
def test_larger_machines_are_proved_block_by_block(name: str) -> None:
    verify(generate(LARGE[name], ONCE))


@pytest.mark.parametrize(
    "name", ["wait in a loop", "choice in a loop", "loop in a loop", "retry", "restart", "own check before", "under way"]
)
def test_the_block_proof_accepts_no_machine_that_the_state_space_refutes(name: str) -> None:
    check_proof_of_mutants(generate(SHAPES[name], ONCE))


def counting_plan(limit: int = 1000) -> PlanGraph:
    """Count n up to 10."""
    more = Operation("add", (local("n"), Literal.of(1)))
    return plan_of_steps(Loop(2, ne("n", 10), flow(call_with(0), store(1, "n", more), orders=("0e<1s",)), limit))


# --- runs ---


def test_a_loop_whose_condition_never_becomes_false_fails_by_name() -> None:
    trace = drive(counting_plan(3), variables={"n": 5}, bindings=ONCE)
    assert not trace.result.goal
    assert trace.actions == ["a0"] * 3
    (failure,) = trace.result.failures
    assert (failure.cause, failure.observed) == ("loop_limit", "local[n] is 8")
    assert "after 3 rounds" in failure.expected


COUNTED = Loop(
    2,
    Computed(Operation("lt", (local("n"), local("most")))),
    flow(call_with(0), store(1, "n", Operation("add", (local("n"), Literal.of(1)))), orders=("0e<1s",)),
    9,
)
CHOSEN = Choice(2, COUNTED.condition, flow(call_with(0)), flow(call_with(1)))


@pytest.mark.parametrize("step", [COUNTED, CHOSEN])
@pytest.mark.parametrize(("value", "shown"), [("abc", '"abc"'), (None, "null")])
def test_a_step_whose_condition_cannot_be_computed_fails_by_name(step: Loop | Choice, value: object, shown: str) -> None:
    trace = drive(plan_of_steps(step), variables={"n": 0, "most": value})
    assert (trace.result.goal, trace.actions) == (False, [])
    (failure,) = trace.result.failures
    assert (failure.cause, failure.expected) == ("condition_unknown", "lt(local[n], local[most]) to be true or false")
    assert failure.observed == f"local[n] is 0, local[most] is {shown}"


def test_a_condition_that_nothing_reports_any_more_is_waited_for_and_fails_by_name() -> None:
    world = KnowledgeBase({("ok",): UNKNOWN})
    world.sense({"ok"}, lag=2.0)
    trace = drive(SHAPES["choice"], world=world)
    assert (trace.result.goal, trace.actions) == (False, [])
    assert [(failure.cause, failure.observed) for failure in trace.result.failures] == [("condition_unknown", "(ok) is unknown")]


def test_a_wait_ends_when_its_condition_becomes_true() -> None:
    graph = plan_of_steps(WaitUntil(2, READY, 5.0), store(0, "n", Literal.of(1)), call_with(1), orders=("2e<1s",))
    trace = drive(graph, variables={"n": 0})
    assert (trace.result.goal, trace.actions) == (True, ["a1"])


@pytest.mark.parametrize(("variables", "observed"), [({"n": 0}, "local[n] is 0"), ({}, "local[n] is missing")])
def test_a_wait_for_what_does_not_come_fails_by_name(variables: dict[str, object], observed: str) -> None:
    trace = drive(plan_of_steps(WaitUntil(1, READY, 5.0), call_with(0), orders=("1e<0s",)), variables=variables)
    assert (trace.result.goal, trace.actions) == (False, [])
    (failure,) = trace.result.failures
    assert (failure.cause, failure.expected, failure.observed) == ("wait_limit", "eq(local[n], 1) within 5 s", observed)


def test_the_limit_of_a_wait_does_not_pass_during_a_pause() -> None:
    run, _ = begun(plan_of_steps(WaitUntil(0, READY, 5.0)))
    run.handle(Pause(), 1.0)
    run.handle(Tick(), 100.0)
    assert not run.over
    run.handle(Resume(), 101.0)
    run.handle(Tick(), 105.0)
    assert not run.over
    run.handle(Tick(), 106.0)
    assert [failure.cause for failure in run.result().failures] == ["wait_limit"]


def test_no_question_stops_the_limit_of_a_wait() -> None:
    asked = Computed(Operation("eq", (Query(Literal.of("n"), Layer.GLOBAL), Literal.of(1))))
    run, commands = begun(plan_of_steps(WaitUntil(0, asked, 5.0)), asks=True)
    assert any(isinstance(command, Ask) for command in commands)
    run.handle(Tick(), 4.0)
    assert not run.over
    run.handle(Tick(), 5.0)
    assert [failure.cause for failure in run.result().failures] == ["wait_limit"]


def test_a_chain_recovers_and_the_call_begins_anew_until_that_is_used_up() -> None:
    recovering = plan_of_steps(call_with(0, on(Cause.ABORTED, Then.RETRY, call_with(1), times=2)))
    assert drive(recovering, answering_with(a0=["aborted", "aborted"]), bindings=ONCE).actions == ["a0", "a1", "a0", "a1", "a0"]
    failed = drive(recovering, answering_with(a0=["aborted"] * 3), bindings=ONCE).result
    assert [one.cause for one in failed.failures] == ["aborted"]


@pytest.mark.parametrize(
    ("then", "goal", "outcome"),
    [
        (Then.SKIP, True, "aborted, passed over"),
        (Then.CONTINUE, True, "succeeded"),
        (Then.FAIL, False, "aborted"),
        (Then.REPLAN, False, "aborted"),
    ],
)
@pytest.mark.parametrize("chain", [(), (call_with(1),)])
def test_how_a_recovery_goes_on(then: Then, goal: bool, outcome: str, chain: tuple[ActionCall, ...]) -> None:
    trace = drive(plan_of_steps(call_with(0, on(Cause.ABORTED, then, *chain))), answering_with(a0=["aborted"]), bindings=ONCE)
    assert trace.result.goal is goal
    assert trace.actions == ["a0", *(one.action.name for one in chain)]
    assert trace.result.calls[0].outcome == outcome
    assert [one.replan for one in trace.result.failures] == ([] if goal else [then is Then.REPLAN])


def test_a_chain_that_fails_fails_the_call() -> None:
    trace = drive(
        plan_of_steps(call_with(0, on(Cause.ABORTED, Then.RETRY, call_with(1)))),
        answering_with(a0=["aborted"], a1=["aborted"]),
        bindings=ONCE,
    )
    assert [str(one.call) for one in trace.result.failures] == ["a1()#1", "a0()#0"]


def test_a_check_of_the_plan_s_own_comes_before_the_action() -> None:
    lost = Recovery(frozenset({Cause.BEFORE}), Then.SKIP, flow(call_with(1)), 1, ne("n", 1))
    assert drive(plan_of_steps(call_with(0, lost)), variables={"n": 1}).actions == ["a0"]
    assert drive(plan_of_steps(call_with(0, lost)), variables={"n": 2}).actions == ["a1"]


def restarts(index: int) -> ActionCall:
    """A call that has the plan begin anew when it is aborted."""
    return call_with(index, on(Cause.ABORTED, Then.RESTART_PLAN))


def test_restarting_the_plan_ends_what_is_beside_it_first_and_begins_once() -> None:
    restarting = plan_of_steps(restarts(0), restarts(1), call_with(2), orders=("0e<2s", "1e<2s"))
    trace = drive(restarting, answering_with(a0=["aborted"], a1=["aborted"]), bindings=ONCE)
    assert trace.result.goal
    assert trace.actions == ["a0", "a1", "a0", "a1", "a2"]
    trace = drive(restarting, answering_with(a0=["aborted"] * 2), bindings=ONCE)
    assert not trace.result.goal
    assert trace.actions == ["a0", "a1"] * 2


def test_a_plan_begins_anew_as_often_as_it_may_whoever_asks() -> None:
    reason = "restart_limit: expected the plan to begin anew 1 time at most; observed one more is asked for"
    for most, actions, why in ((None, 3, reason), (1, 3, reason), (2, 5, "the goal holds")):
        restarting = replace(plan_of_steps(restarts(0), restarts(1), orders=("0e<1s",)), restarts=most)
        verify(generate(restarting))
        trace = drive(restarting, answering_with(a0=["aborted"], a1=["aborted"]), bindings=ONCE)
        assert (len(trace.actions), trace.result.reason) == (actions, why)


def test_a_restart_that_is_not_counted_for_the_plan_is_found() -> None:
    machine = generate(plan_of_steps(restarts(0)))
    with pytest.raises(Unsound, match="does not count how often the plan begins anew"):
        verify(replace(machine, plan=replace(machine.plan, restarts=2)))


def test_however_many_calls_may_restart_the_plan_the_proof_costs_the_same() -> None:
    def proof(number: int) -> int:
        return verify(generate(plan_of_steps(*map(restarts, range(number))))).states

    assert proof(10) == proof(3) == proof(2)


def test_a_call_whose_wish_to_restart_is_treated_otherwise_is_found() -> None:
    machine = generate(plan_of_steps(*map(restarts, range(4))))
    third = [*machine.restart_places][2]
    with pytest.raises(Unsound):
        verify(without_output(machine, f"restart_too {third}", "restarting"))


def test_a_call_that_others_would_undo_is_not_counted_as_failed_when_the_plan_begins_anew() -> None:
    beside = plan_of_steps(restarts(0), call_with(1, on(Cause.ABORTED, Then.RETRY)))
    assert drive(beside, answering_with(a0=["aborted"], a1=["aborted"]), bindings=ONCE).result.goal
