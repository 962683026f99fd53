"""Runs that store, compute, ask for and check knowledge."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pnm.core.logic.computed_values import Layer, Literal, Operation, Parameter, Query, Question
from pnm.core.logic.conditions import Computed
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import ActionCall, GroundAction, Loop
from pnm.core.machine.requests import Outcome, OutcomeKind
from pnm.core.machine.verification.part import Unsound
from pnm.core.machine.verification.verify import explore, verify
from tests.support.runs.control_flow import SHAPES, call_with, flow, local, ne, store
from tests.support.runs.direct import drive
from tests.support.runs.plan_graphs import plan_of_steps

ONCE = Bindings({f"a{index}": Binding(retries=0) for index in range(10)})


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


def test_an_operation_that_is_impossible_fails_by_name() -> None:
    trace = drive(
        plan_of_steps(store(0, "ham", Operation("add", (Literal.of(1), Literal.of("x"))))), bindings=Bindings({"store": Binding(retries=0)})
    )
    assert trace.result.failures[0].cause == "aborted"
    assert "add(1, 'x')" in trace.result.failures[0].observed


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


def test_what_is_expected_is_checked_after_and_spares_the_action_before() -> None:
    done = replace(call_with(0).action, expected=Computed(Operation("exists", (local("result"),))))
    graph = plan_of_steps(ActionCall(0, done))
    assert drive(graph, variables={"result": 1}, bindings=ONCE).actions == []
    trace = drive(graph, bindings=ONCE)
    assert [one.cause for one in trace.result.failures] == ["effects_missing"]
    found = drive(graph, lambda _: Outcome(OutcomeKind.SUCCEEDED, {"result": 1}), bindings=ONCE)
    assert found.result.goal
    loop = plan_of_steps(Loop(1, ne("n", 1), flow(ActionCall(0, done)), 2))
    assert drive(loop, variables={"result": 1}, bindings=ONCE).actions == ["a0", "a0"]
