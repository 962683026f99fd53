"""Plans in YAML, carried out; the listings of the paper and what the original implementation did are in tests/docs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest

from planner_bridge.pipeline.achieve import carry_out
from pnm.core.logic.computed_values import Layer, Literal, Operation, Query
from pnm.core.logic.conditions import All, Computed, Condition
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.plan_graph import ActionCall, Choice, GroundAction, Loop, PlanGraph, WaitUntil
from pnm.core.machine.requests import Outcome, OutcomeKind
from tests.support.runs.direct import Answer, Trace, answering_with, drive, succeed
from tests.support.yaml.programs import only_plan


def run_text(text: str, answer: Answer = succeed, known: Mapping[str, object] | None = None) -> Trace:
    plan = only_plan(text)
    return drive(plan.graph, answer, bindings=plan.bindings, variables=plan.variables, known=known, on_failure=plan.on_failure)


def test_values_that_a_step_gives_are_not_seen_by_preconditions() -> None:
    assert not run_text("actions: {a: {params: [x], preconditions: {Exists: [LocalQuery: x]}}}\nplan: [a: {x: 1}]\n").result.goal


WAITS = """\
actions:
  knock: {duration: 2, effects: [(open door)]}
  enter: {params: [d], recoveries: {during: {aborted: {do: [STEP, retry], times: 1}}}}
plan:
- concurrent_actions: [{knock: }, {enter: {d: door}}]
"""


@pytest.mark.parametrize(
    "step",
    [
        '{wait_until: {condition: "(open ?d)", limit: 5}}',
        '{if: "(open ?d)", then: [], else: [{wait_until: {condition: (never), limit: 1}}]}',
        '{while: {condition: {not: "(open ?d)"}, actions: [knock: ], limit: 9}}',
    ],
)
def test_a_condition_in_a_recovery_is_about_the_call_that_recovers(step: str) -> None:
    left = [Outcome(OutcomeKind.ABORTED)]
    plan = only_plan(WAITS.replace("STEP", step))
    conditions = [one.condition for one in plan.graph.every_step if isinstance(one, WaitUntil | Choice | Loop)]
    assert not any("?d" in str(condition) for condition in conditions)
    succeeded = Outcome(OutcomeKind.SUCCEEDED)
    trace = run_text(WAITS.replace("STEP", step), lambda request: left.pop() if left and request.action.name == "enter" else succeeded)
    assert trace.result.goal, trace.result.reason


def test_an_operation_on_knowledge_changes_a_list() -> None:
    operation = "{Operation: [setitem, [{LocalQuery: l}, 0, 9]]}"
    text = f"actions: {{k: {{type: kb_action}}}}\ninitial_knowledge: {{l: [1, 2]}}\nplan: [k: {{operation: {operation}}}]\n"
    assert run_text(text).run.knowledge.local.variable("l") == [9, 2]


def test_others_are_asked_and_told() -> None:
    text = """\
actions: {k: {type: kb_action}}
initial_knowledge: {place: coffee}
plan:
  - k:
      operation:
        LocalUpdate:
          - place
          - RemoteQuery:
              - RemoteQuery: [{LocalQuery: place}, {kind: class}]
              - {status: which}
  - k: {operation: {RemoteUpdate: [CONTROLLER, "", {status: end, value: {LocalQuery: place}}]}}
"""
    trace = run_text(text, known={"coffee": "shops", "shops": "the one upstairs"})
    assert trace.result.goal, trace.result.reason
    assert [(question.name, question.layer, question.meta) for question in trace.asked] == [
        ("coffee", Layer.GLOBAL, '{"kind": "class"}'),
        ("shops", Layer.GLOBAL, '{"status": "which"}'),
    ]
    ((told, value),) = trace.told
    assert (told.name, value, told.meta) == ("CONTROLLER", "", '{"status": "end", "value": "the one upstairs"}')


def test_a_chain_of_recovery_knows_what_the_call_was_given() -> None:
    text = """\
actions:
  move:
    params: "?r ?speed"
    recoveries: {during: {aborted: {do: [say: {text: ["?r", "?speed"]}, retry], times: 2}}}
  say: {params: [text]}
initial_knowledge: {speed: 7}
plan: [move: {r: r1}]
"""
    trace = run_text(text, answering_with(move=["aborted", "aborted"]))
    assert trace.result.goal, trace.result.reason
    assert trace.actions == ["move", "say", "move", "say", "move"]
    assert trace.sent[1][1]["text"] == ["r1", 7]


# --- effects that only somebody outside knows: asked for after the call, and missing if the answer is not so ---


OUTSIDE = [Layer.ALL, Layer.GLOBAL, Layer.PERSON]


def rung(layer: Layer, name: str = "bell") -> Condition:
    return Computed(Operation("eq", (Query(Literal.of(name), layer), Literal.of("rung"))))


def ring(expected: Condition, known: dict[str, object]) -> Trace:
    bindings = Bindings({"ring": Binding(retries=1)})
    return drive(PlanGraph((ActionCall(0, GroundAction("ring", expected=expected)),)), known=known, bindings=bindings)


@pytest.mark.parametrize("layer", OUTSIDE)
@pytest.mark.parametrize("answer", ["silent", None])
def test_an_effect_that_is_not_so_outside_is_missing(layer: Layer, answer: object) -> None:
    trace = ring(rung(layer), {"bell": answer})
    assert not trace.result.goal
    assert trace.actions == ["ring", "ring"]
    (failure,) = trace.result.failures
    assert failure.cause == "effects_missing"
    assert failure.expected == str(rung(layer))


@pytest.mark.parametrize("layer", OUTSIDE)
def test_an_effect_that_is_so_outside_is_asked_for_after_the_call(layer: Layer) -> None:
    early = ActionCall(0, GroundAction("look"))
    assert ring(rung(layer), {"bell": "rung"}).actions == []  # so already
    trace = drive(PlanGraph((early, ActionCall(1, GroundAction("ring", end_condition=rung(layer))))), known={"bell": "rung"})
    assert trace.result.goal
    assert trace.actions == ["look", "ring"]
    assert [question.name for question in trace.asked] == ["bell"]


def test_every_part_of_an_effect_is_asked_for() -> None:
    trace = ring(All((rung(Layer.GLOBAL), rung(Layer.GLOBAL, "door"))), {"bell": "rung", "door": "closed"})
    (failure,) = trace.result.failures
    assert failure.expected == str(rung(Layer.GLOBAL, "door"))


@pytest.mark.parametrize("query", ["RemoteQuery", "Query"])
def test_a_hand_written_plan_does_not_believe_what_nobody_confirms(tmp_path: Path, query: str) -> None:
    effects = f"{{Comparison: [eq, [{query}: bell, rung]]}}"
    (tmp_path / "p.yaml").write_text(f"knowledge: memory\nactions: {{ring: {{effects: {effects}}}}}\nplan: [ring:]\n")
    result = carry_out(tmp_path / "p.yaml")
    assert not result.goal_reached
    assert [call.attempts for call in result.calls] == [4]
    assert "effects_missing" in result.reason


def test_a_goal_that_is_false_outside_is_explained_with_the_answer() -> None:
    trace = drive(PlanGraph((), goal=rung(Layer.GLOBAL)), known={"bell": "silent"})
    assert trace.result.reason.endswith('expected eq(global[bell], "rung"); observed global[bell] is "silent"')
