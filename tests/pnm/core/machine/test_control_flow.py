"""Loops, choices, recoveries and resources: sound machines, and runs that do what the plan says."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pnm.core.execution.events import Begin, Send
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.computed_values import Data, Layer, Literal, Operation, Parameter, Query, Question, Update
from pnm.core.logic.conditions import Computed, Condition, Holds
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.generate import generate
from pnm.core.machine.machine import OnFailure
from pnm.core.machine.plan_graph import (
    EMPTY,
    ActionCall,
    Cause,
    Choice,
    Flow,
    GroundAction,
    Junction,
    Loop,
    PlanGraph,
    Recovery,
    Step,
    Then,
)
from pnm.core.machine.requests import Ended, Outcome, OutcomeKind
from pnm.core.machine.verification.explore import Unsound
from pnm.core.machine.verification.verify import explore, verify
from tests.support.runs.direct import RUN, drive, outcomes
from tests.support.runs.mutants import _less_output, check_proof_of_mutants
from tests.support.runs.plan_graphs import ordering

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
    "resource and an end that waits": plan(call(0, resources=("arm",)), call(1, resources=("arm",)), orders=("1s<0e",)),
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
    check_proof_of_mutants(generate(SHAPES[name], ONCE))


# --- runs ----------------------------------------------------------------------------------


def local(name: str) -> Query:
    return Query(Literal.of(name), Layer.LOCAL)


def store(index: int, name: str, value: Data, layer: Layer = Layer.LOCAL) -> ActionCall:
    return ActionCall(index, GroundAction("store", operation=Update(Literal.of(name), value, layer)))


def ne(name: str, value: object) -> Condition:
    return Computed(Operation("ne", (local(name), Literal.of(value))))


def counted(limit: int = 1000) -> PlanGraph:
    """Count n up to 10."""
    more = Operation("add", (local("n"), Literal.of(1)))
    return plan(Loop(2, ne("n", 10), flow(call(0), store(1, "n", more), orders=("0e<1s",)), limit))


def test_a_loop_goes_round_as_long_as_its_condition_holds() -> None:
    trace = drive(counted(), variables={"n": 5}, bindings=ONCE)
    assert trace.result.goal
    assert trace.actions == ["a0"] * 5
    assert trace.run.knowledge.local.variable("n") == 10
    assert [one.outcome for one in trace.result.calls] == ["succeeded"] * 10
    assert len({one.started for one in trace.result.calls}) == 1


def test_a_loop_whose_condition_never_becomes_false_fails_by_name() -> None:
    trace = drive(counted(3), variables={"n": 5}, bindings=ONCE)
    assert not trace.result.goal
    assert trace.actions == ["a0"] * 3
    (failure,) = trace.result.failures
    assert (failure.cause, failure.observed) == ("loop_limit", "local[n] is 8")
    assert "after 3 rounds" in failure.expected


def test_a_loop_counts_its_rounds_anew_each_time_it_is_reached() -> None:
    more = Operation("add", (local("n"), Literal.of(1)))
    inner = Loop(4, ne("n", 3), flow(store(1, "n", more)), 3)
    outer = flow(
        store(0, "n", Literal.of(0)), inner, store(2, "m", Operation("add", (local("m"), Literal.of(1)))), orders=("0e<4s", "4e<2s")
    )
    trace = drive(plan(Loop(3, ne("m", 4), outer, 4)), variables={"m": 0})
    assert trace.result.goal, trace.result.reason


@pytest.mark.parametrize(("variables", "expected"), [({"n": 1}, ["a1"]), ({"n": 2}, ["a0"]), ({}, ["a0"])])
def test_a_choice_takes_one_branch(variables: dict[str, object], expected: list[str]) -> None:
    assert drive(plan(Choice(2, ne("n", 1), flow(call(0)), flow(call(1)))), variables=variables).actions == expected


def test_a_condition_that_cannot_be_computed_is_not_true() -> None:
    late = Computed(Operation("gt", (local("n"), Literal.of(1))))
    assert drive(plan(Choice(2, late, flow(call(0)), flow(call(1)))), variables={"n": "three"}).actions == ["a1"]


def test_a_chain_recovers_and_the_call_begins_anew_until_that_is_used_up() -> None:
    recovering = plan(call(0, on(Cause.ABORTED, Then.RETRY, call(1), times=2)))
    assert drive(recovering, outcomes(a0=["aborted", "aborted"]), bindings=ONCE).actions == ["a0", "a1", "a0", "a1", "a0"]
    failed = drive(recovering, outcomes(a0=["aborted"] * 3), bindings=ONCE).result
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
@pytest.mark.parametrize("chain", [(), (call(1),)])
def test_how_a_recovery_goes_on(then: Then, goal: bool, outcome: str, chain: tuple[ActionCall, ...]) -> None:
    trace = drive(plan(call(0, on(Cause.ABORTED, then, *chain))), outcomes(a0=["aborted"]), bindings=ONCE)
    assert trace.result.goal is goal
    assert trace.actions == ["a0", *(one.action.name for one in chain)]
    assert trace.result.calls[0].outcome == outcome
    assert [one.replan for one in trace.result.failures] == ([] if goal else [then is Then.REPLAN])


def test_a_chain_that_fails_fails_the_call() -> None:
    trace = drive(plan(call(0, on(Cause.ABORTED, Then.RETRY, call(1)))), outcomes(a0=["aborted"], a1=["aborted"]), bindings=ONCE)
    assert [str(one.call) for one in trace.result.failures] == ["a1()#1", "a0()#0"]


def test_a_check_of_the_plan_s_own_comes_before_the_action() -> None:
    lost = Recovery(frozenset({Cause.BEFORE}), Then.SKIP, flow(call(1)), 1, ne("n", 1))
    assert drive(plan(call(0, lost)), variables={"n": 1}).actions == ["a0"]
    assert drive(plan(call(0, lost)), variables={"n": 2}).actions == ["a1"]


def test_restarting_the_plan_ends_what_is_beside_it_first_and_begins_once() -> None:
    restarting = plan(
        call(0, on(Cause.ABORTED, Then.RESTART_PLAN)), call(1, on(Cause.ABORTED, Then.RESTART_PLAN)), call(2), orders=("0e<2s", "1e<2s")
    )
    trace = drive(restarting, outcomes(a0=["aborted"], a1=["aborted"]), bindings=ONCE)
    assert trace.result.goal
    assert trace.actions == ["a0", "a1", "a0", "a1", "a2"]
    trace = drive(restarting, outcomes(a0=["aborted"] * 2), bindings=ONCE)
    assert not trace.result.goal
    assert trace.actions == ["a0", "a1"] * 2


def test_however_many_calls_may_restart_the_plan_the_proof_costs_the_same() -> None:
    def proof(number: int) -> int:
        return verify(generate(plan(*(call(index, on(Cause.ABORTED, Then.RESTART_PLAN)) for index in range(number))))).states

    assert proof(10) == proof(3) == proof(2)


def test_a_call_whose_wish_to_restart_is_treated_otherwise_is_found() -> None:
    machine = generate(plan(*(call(index, on(Cause.ABORTED, Then.RESTART_PLAN)) for index in range(4))))
    third = [*machine.restart_places][2]
    with pytest.raises(Unsound):
        verify(replace(machine, net=_less_output(machine.net, f"restart_too {third}", "restarting")))


def test_a_call_that_others_would_undo_is_not_counted_as_failed_when_the_plan_begins_anew() -> None:
    beside = plan(call(0, on(Cause.ABORTED, Then.RESTART_PLAN)), call(1, on(Cause.ABORTED, Then.RETRY)))
    assert drive(beside, outcomes(a0=["aborted"], a1=["aborted"]), bindings=ONCE).result.goal


def test_a_resource_is_had_by_one_call_at_a_time() -> None:
    machine = generate(SHAPES["resource"], ONCE)
    run = Run(machine, Layered(KnowledgeBase()), id=RUN)
    commands = run.handle(Begin(), 0.0)
    first = [one.request for one in commands if isinstance(one, Send)]
    assert [one.action.name for one in first] == ["a0"]
    commands = run.handle(Ended(first[0].id, Outcome(OutcomeKind.SUCCEEDED)), 1.0)
    assert [one.request.action.name for one in commands if isinstance(one, Send)] == ["a1"]


# --- knowledge -----------------------------------------------------------------------------


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
    both = plan(store(0, "spam", Literal.of("eggs"), Layer.ALL), store(1, "ham", local("spam")), orders=("0e<1s",))
    trace = drive(both, known={})
    assert trace.told == [(Question("spam", Layer.GLOBAL, "null"), "eggs")]
    assert trace.run.knowledge.local.variables() == {"spam": "eggs", "ham": "eggs"}
    shared = drive(both).run.knowledge
    assert shared.world.variables() == {"spam": "eggs"}


def test_a_variable_that_nobody_knows_is_not_copied_as_nothing() -> None:
    trace = drive(plan(store(0, "ham", Query(Literal.of("spam")))), known={})
    assert [(one.cause, one.expected) for one in trace.result.failures] == [("data_missing", "values for spam")]


def test_an_operation_that_is_impossible_fails_by_name() -> None:
    trace = drive(
        plan(store(0, "ham", Operation("add", (Literal.of(1), Literal.of("x"))))), bindings=Bindings({"store": Binding(retries=0)})
    )
    assert trace.result.failures[0].cause == "aborted"
    assert "add(1, 'x')" in trace.result.failures[0].observed


def test_a_question_is_asked_once_per_decision() -> None:
    both_ways = Computed(Operation("eq", (Query(Literal.of("spam"), Layer.GLOBAL), Literal.of(1))))
    trace = drive(plan(Loop(1, both_ways, flow(store(0, "n", Literal.of(1))), 3)), known={"spam": 1})
    assert len(trace.asked) == 4
    assert not trace.result.goal


def test_missing_goal_data_is_looked_up_globally_then_asked_for_then_a_failure_by_name() -> None:
    graph = plan(ActionCall(0, GroundAction("wait", ("?time",), ("time",))))
    near = drive(graph, variables={"time": 1}, known={"time": 2})
    assert near.sent == [("wait", {"action": "wait", "arguments": ["1"], "duration": 0.0, "time": 1})]
    assert drive(graph, known={"time": 2}).sent[0][1]["time"] == 2
    asking = Bindings({"wait": Binding(ask={"time": "How long?"})})
    asked = drive(graph, known={}, bindings=asking)
    assert asked.asked == [Question("time", Layer.GLOBAL, "null"), Question("time", Layer.PERSON, '"How long?"')]
    assert [(one.cause, one.expected) for one in asked.result.failures] == [("data_missing", "values for time")]


def test_what_a_person_is_asked_names_the_arguments_of_the_call() -> None:
    graph = plan(ActionCall(0, GroundAction("wait", ("r1", "?time"), ("robot", "time"))))
    asking = Bindings({"wait": Binding(ask={"time": "How long shall {robot} wait, {sir}?"})})
    asked = drive(graph, known={}, bindings=asking).asked
    assert asked[-1] == Question("time", Layer.PERSON, '"How long shall r1 wait, {sir}?"')


def test_a_parameter_that_knowledge_fills_keeps_its_kind() -> None:
    few = Computed(Operation("lt", (Parameter("?n"), Literal.of(5))))
    graph = plan(ActionCall(0, GroundAction("count", ("?n",), ("n",), precondition=few)))
    assert drive(graph, variables={"n": 3}).sent[0][1]["n"] == 3
    assert [one.cause for one in drive(graph, variables={"n": 7}).result.failures] == ["precondition_false"]


def test_what_is_expected_is_checked_after_and_spares_the_action_before() -> None:
    done = replace(call(0).action, expected=Computed(Operation("exists", (local("result"),))))
    graph = plan(ActionCall(0, done))
    assert drive(graph, variables={"result": 1}, bindings=ONCE).actions == []
    trace = drive(graph, bindings=ONCE)
    assert [one.cause for one in trace.result.failures] == ["effects_missing"]
    found = drive(graph, lambda _: Outcome(OutcomeKind.SUCCEEDED, {"result": 1}), bindings=ONCE)
    assert found.result.goal
    loop = plan(Loop(1, ne("n", 1), flow(ActionCall(0, done)), 2))
    assert drive(loop, variables={"result": 1}, bindings=ONCE).actions == ["a0", "a0"]


@pytest.mark.parametrize("name", [*SHAPES, *LARGE])
def test_every_failure_and_every_call_that_is_passed_over_has_a_cause(name: str) -> None:
    machine = generate({**SHAPES, **LARGE}[name], ONCE)
    calls = {call.index for call in machine.plan.calls}
    explained = {place for step in calls for place in machine.blocks[step] if not machine.initial[place]}

    after_chains = {place for region in machine.regions if region.owner in calls for place in region.last}

    def comes_from_an_explained_place(transition: str) -> bool:
        return machine.rules[transition].cause is not None or not (explained | after_chains).isdisjoint(machine.net.inputs[transition])

    while left := {place for place in explained if not all(map(comes_from_an_explained_place, machine.net.preset(place)))}:
        explained -= left
    for transition, outputs in machine.net.outputs.items():
        rule = machine.rules[transition]
        if rule.call not in calls or machine.net.inputs[transition].keys() & outputs.keys():
            continue  # of a loop, or a counter that is refilled
        if any(place in machine.failure_places for place in outputs):
            assert comes_from_an_explained_place(transition), transition
        elif f"{machine.plan.calls[rule.call or 0]} done" in outputs:
            assert rule.outcome is not None or comes_from_an_explained_place(transition), transition
