"""Loops, choices, recoveries, resources and knowledge: sound machines, and runs that do what the plan says."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pnm.core.execution.events import Ask, Pause, Resume, Tick
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.computed_values import Layer, Literal, Operation, Parameter, Query, Question
from pnm.core.logic.conditions import Computed
from pnm.core.logic.expressions import UNKNOWN
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.generate import generate
from pnm.core.machine.machine import OnFailure
from pnm.core.machine.plan_graph import ActionCall, GroundAction, Loop, Then, WaitUntil
from pnm.core.machine.verification.part import Unsound
from pnm.core.machine.verification.verify import explore, verify
from tests.support.runs.commands import begun
from tests.support.runs.control_flow import LARGE, SHAPES, call_with, flow, local, on, store
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


# --- runs ---


def test_a_condition_that_nothing_reports_any_more_is_waited_for_and_fails_by_name() -> None:
    world = KnowledgeBase({("ok",): UNKNOWN})
    world.sense({"ok"}, lag=2.0)
    trace = drive(SHAPES["choice"], world=world)
    assert (trace.result.goal, trace.actions) == (False, [])
    assert [(failure.cause, failure.observed) for failure in trace.result.failures] == [("condition_unknown", "(ok) is unknown")]


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


def restarts(index: int) -> ActionCall:
    """A call that has the plan begin anew when it is aborted."""
    return call_with(index, on(Cause.ABORTED, Then.RESTART_PLAN))


def test_restarting_the_plan_ends_what_is_beside_it_first_and_begins_once() -> None:
    restarting = plan_of_steps(restarts(0), restarts(1), call_with(2), orders=("0e<2s", "1e<2s"))
    trace = drive(restarting, answering_with(a0=["aborted"], a1=["aborted"]), bindings=ONCE)
    assert trace.result.goal
    assert trace.actions == ["a0", "a1", "a0", "a1", "a2"]


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


# --- knowledge: what is stored, computed, asked for and checked ---


def test_what_keeps_a_resource_while_it_waits_for_others_is_not_sound() -> None:
    machine = generate(SHAPES["resource and an end that waits"], ONCE)
    given, kept = "a0()#0 succeeded", "a0()#0 await"
    outputs = {one: dict(places) for one, places in machine.net.outputs.items()}
    outputs[kept]["resource arm"] = outputs[given].pop("resource arm")
    keeping = replace(machine, net=replace(machine.net, outputs=outputs))
    with pytest.raises(Unsound, match="keeps resources that they may need"):
        verify(keeping)
    with pytest.raises(Unsound):
        explore(keeping)


def test_an_update_of_global_knowledge_is_awaited_and_a_local_one_is_not() -> None:
    both = plan_of_steps(store(0, "spam", Literal.of("eggs"), Layer.ALL), store(1, "ham", local("spam")), orders=("0e<1s",))
    trace = drive(both, known={})
    assert trace.told == [(Question("spam", Layer.GLOBAL, "null"), "eggs")]
    assert trace.run.knowledge.local.variables() == {"spam": "eggs", "ham": "eggs"}
    shared = drive(both).run.knowledge
    assert shared.world.variables() == {"spam": "eggs"}


def test_a_variable_that_nobody_knows_is_not_copied_as_nothing() -> None:
    trace = drive(plan_of_steps(store(0, "ham", Query(Literal.of("spam")))), known={})
    assert [(one.cause, one.expected) for one in trace.result.failures] == [("data_missing", "values for spam")]


def test_a_question_is_asked_once_per_decision() -> None:
    both_ways = Computed(Operation("eq", (Query(Literal.of("spam"), Layer.GLOBAL), Literal.of(1))))
    trace = drive(plan_of_steps(Loop(1, both_ways, flow(store(0, "n", Literal.of(1))), 3)), known={"spam": 1})
    assert len(trace.asked) == 4
    assert not trace.result.goal


def test_missing_goal_data_is_looked_up_globally_then_asked_for_then_a_failure_by_name() -> None:
    graph = plan_of_steps(ActionCall(0, GroundAction("wait", ("?time",), ("time",))))
    near = drive(graph, variables={"time": 1}, known={"time": 2})
    assert near.sent == [("wait", {"action": "wait", "arguments": ["1"], "duration": 0.0, "time": 1})]
    assert drive(graph, known={"time": 2}).sent[0][1]["time"] == 2
    asking = Bindings({"wait": Binding(ask={"time": "How long?"})})
    asked = drive(graph, known={}, bindings=asking)
    assert asked.asked == [Question("time", Layer.GLOBAL, "null"), Question("time", Layer.PERSON, '"How long?"')]
    assert [(one.cause, one.expected) for one in asked.result.failures] == [("data_missing", "values for time")]


def test_what_a_person_is_asked_names_the_arguments_of_the_call() -> None:
    graph = plan_of_steps(ActionCall(0, GroundAction("wait", ("r1", "?time"), ("robot", "time"))))
    asking = Bindings({"wait": Binding(ask={"time": "How long shall {robot} wait, {sir}?"})})
    asked = drive(graph, known={}, bindings=asking).asked
    assert asked[-1] == Question("time", Layer.PERSON, '"How long shall r1 wait, {sir}?"')


def test_a_parameter_that_knowledge_fills_keeps_its_kind() -> None:
    few = Computed(Operation("lt", (Parameter("?n"), Literal.of(5))))
    graph = plan_of_steps(ActionCall(0, GroundAction("count", ("?n",), ("n",), precondition=few)))
    assert drive(graph, variables={"n": 3}).sent[0][1]["n"] == 3
    assert [one.cause for one in drive(graph, variables={"n": 7}).result.failures] == ["precondition_false"]
