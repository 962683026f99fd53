"""Faults of the first implementation that are not repeated: docs/project/original.md."""

from __future__ import annotations

from planner_bridge.model.world import simulated_backend
from pnm.clock import run_async
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.machine.generate import generate
from pnm.core.machine.verification.verify import verify
from pnm.language.plan import HandWrittenPlan
from pnm.language.runner import PlanRunner, Program
from tests.support.runs.direct import answering_with
from tests.support.yaml.original import COUNTING, RunOriginal, causes, counted, read_original, run_original, variables


def test_b1_b4_what_is_not_carried_out_fails_by_name(run: RunOriginal) -> None:
    for kind in ("unavailable", "rejected", "lost"):
        assert causes(run("[{a: {}}]", answering_with(a=[kind]))) == [kind]


def test_b2_missing_data_is_a_failure_and_nothing_is_sent(run: RunOriginal) -> None:
    trace = run("[{given: {}}]")
    assert (trace.sent, causes(trace)) == ([], ["data_missing"])
    assert trace.result.failures[0].expected == "values for value"


def test_b5_an_operation_that_is_impossible_fails_and_one_that_is_missing_is_refused(run: RunOriginal) -> None:
    assert causes(run("[{kb: {operation: {LocalUpdate: [v, {Operation: [add, [LocalQuery: w, 1]]}]}}}]")) == ["aborted"]
    assert "expected the key 'operation'" in run.wrong("[{kb: {}}]")


def test_b6_b10_a_condition_that_cannot_be_computed_does_not_hold(run: RunOriginal) -> None:
    condition = "{Comparison: [lt, [LocalQuery: value, 3]]}"
    rest = f"  small: {{preconditions: {condition}}}\n"
    assert causes(run("[{small: {}}]", knowledge="{value: text}", rest=rest)) == ["precondition_false"]
    for step in (
        f"if: {condition}, then: [{{a: {{}}}}], else: [{{b: {{}}}}]",
        f"while: {{condition: {condition}, actions: [{{a: {{}}}}]}}",
    ):
        trace = run(f"[{{{step}}}]", knowledge="{value: text}")
        assert (trace.actions, causes(trace)) == ([], ["condition_unknown"])


def test_b7_b8_any_number_of_operands_and_operations_in_operations(run: RunOriginal) -> None:
    three = "{and: [{Exists: [Query: v]}, {or: []}, {Exists: [Query: v]}]}"
    assert run(f"[{{if: {three}, then: [{{a: {{}}}}], else: [{{b: {{}}}}]}}]", knowledge="{v: 1}").actions == ["b"]
    nested = "{LocalUpdate: [v, {Operation: [add, [{Operation: [add, [LocalQuery: v, 1]]}, 1]]}]}"
    assert variables(run(f"[{{kb: {{operation: {nested}}}}}]", knowledge="{v: 1}")) == {"v": 3}


def test_b9_meta_information_is_computed_every_time(run: RunOriginal) -> None:
    ask = "{kb: {operation: {LocalUpdate: [heard, {RemoteQuery: [question, {number: {LocalQuery: n}}]}]}}}"
    count = "{kb: {operation: {LocalUpdate: [n, {Operation: [add, [LocalQuery: n, 1]]}]}}}"
    loop = f"[{{while: {{condition: {{Comparison: [lt, [LocalQuery: n, 3]]}}, actions: [{ask}, {count}]}}}}]"
    trace = run(loop, knowledge="{n: 0}", known={"question": 1})
    assert [one.meta for one in trace.asked] == ['{"number": 0}', '{"number": 1}', '{"number": 2}']


def test_b11_in_a_loop_an_action_is_called_in_every_round_and_rounds_are_counted(run: RunOriginal) -> None:
    loop = "[{while: {condition: {Exists: [LocalQuery: result]}, actions: [{found: {}}], limit: 7}}]"
    trace = run(loop, knowledge="{result: 0}")
    assert (trace.actions, causes(trace)) == (["found"] * 7, ["loop_limit"])


def test_b12_effects_that_never_come_are_waited_for_three_times(run: RunOriginal) -> None:
    trace = run("[{found: {}}]")
    assert (trace.actions, causes(trace)) == (["found"] * 4, ["effects_missing"])


def test_b18_names_are_names(run: RunOriginal) -> None:
    rest = "  Comparison: {<<: *ros_action}\n  exists: {<<: *ros_action}\n"
    names = "{query: 1, update: 2, lock: 3, self: 4, größe: 5}"
    trace = run("[{Comparison: {}}, {exists: {}}, {given: {value: {LocalQuery: lock}}}]", knowledge=names, rest=rest)
    assert (trace.result.goal, trace.actions, trace.sent[2][1]["value"]) == (True, ["Comparison", "exists", "given"], 3)
    assert "'while' is a word of the language" in run.wrong("[]", rest="  while: {}\n")


def test_c1_what_is_entered_again_goes_on(run: RunOriginal) -> None:
    trace = run(COUNTING.replace("10]]", "500]]"), counted, knowledge="{value: 0}")
    assert (trace.result.goal, len(trace.sent)) == (True, 501)


def test_c4_what_is_updated_beside_an_action_is_there_for_the_next(run: RunOriginal) -> None:
    trace = run("[{concurrent_actions: [{a: {}}, {kb: {operation: {LocalUpdate: [value, 2]}}}]}, {given: {}}]", knowledge="{value: 1}")
    assert trace.sent[-1][1]["value"] == 2


def test_c5_beginning_anew_in_a_branch_ends_the_others_and_begins_once(run: RunOriginal) -> None:
    branches = "[{a: {}, recoveries: {during: {aborted: restart_plan}}}, {b: {}}]"
    trace = run(f"[{{concurrent_actions: {branches}}}]", answering_with(a=["aborted"]))
    assert (trace.result.goal, trace.actions) == (True, ["a", "b", "a", "b"])


def test_p1_the_blocks_of_a_long_plan_are_proved_once() -> None:
    def long(calls: int) -> HandWrittenPlan:
        return read_original(f"[{', '.join(['{kb: {operation: {LocalUpdate: [v, 1]}}}'] * calls)}]")

    shorter, longer = (verify(generate(long(calls).graph)) for calls in (100, 400))
    assert (shorter.shapes, shorter.states) == (longer.shapes, longer.states)
    assert run_original(long(400)).result.goal


def test_p6_runs_that_are_over_are_forgotten() -> None:
    plan = read_original("[{a: {}}]")

    async def twice() -> list[object]:
        runner = PlanRunner({"plan": Program.of(plan)}, simulated_backend(plan, plan.bindings), KnowledgeBase())
        await runner.backend.open(runner.world)
        for _ in range(2):
            assert (await runner.execute(runner.prepare_run("plan"))).goal
        await runner.backend.close()
        return [*runner.going_on]

    assert run_async(twice(), virtual=True) == []


def test_6_missing_data_is_looked_up_in_the_global_knowledge(run: RunOriginal) -> None:
    trace = run("[{given: {}}]", known={"value": 7})
    assert (trace.result.goal, trace.sent[0][1]["value"]) == (True, 7)
