"""What the first implementation of Petri Net Machines does, and where this one does something else: docs/original.md."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import pytest

from planner_bridge.pipeline import carry_out
from planner_bridge.simulation import simulated_backend
from pnm.clock import run_async
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.machine.generate import generate
from pnm.core.machine.requests import Outcome, OutcomeKind, Request
from pnm.core.machine.verification.verify import verify
from pnm.errors import InputError
from pnm.language.plan import HandWrittenPlan, read_plans
from pnm.language.runner import Performer, Program
from tests.support.files import ROOT
from tests.support.runs.direct import Answer, Trace, drive, outcomes, succeed

PAGE = (ROOT / "docs" / "original.md").read_text(encoding="utf-8")
TYPES = """
external_knowledge_base: {module: rpn_ros_interface.ros_external_knowledge_base, class: ROSExternalKnowledgeBase}
action_types:
  Ros: &ros_action {type: {module: rpn_ros_interface.action, class: ROSAtomicAction}}
  Rpn: &rpn_action {type: {module: rpn_ros_interface.rpn_action, class: RPNAtomicAction}}
  Kb: &kb_action {type: {module: pnp_actions.kb_action, class: KBAction}}
actions:
  a: {<<: *ros_action}
  b: {<<: *ros_action}
  c: {<<: *ros_action}
  given: {<<: *ros_action, params: [value]}
  ready: {<<: *ros_action, preconditions: {Comparison: [eq, [LocalQuery: ready, true]]}}
  found: {<<: *ros_action, effects: {Exists: [LocalQuery: result]}}
  both: {<<: *ros_action, preconditions: {Exists: [LocalQuery: nothing]}, effects: {Exists: [LocalQuery: result]}}
  kb: {<<: *kb_action, params: [operation]}
"""


def read(folder: Path, plan: str, knowledge: str = "{}", rest: str = "") -> HandWrittenPlan:
    path = folder / "plan.yaml"
    path.write_text(f"{TYPES}{rest}---\ninitial_knowledge: {knowledge}\nplan: {plan}\n", encoding="utf-8")
    (found,) = read_plans(path).values()
    return found


def told(plan: HandWrittenPlan, answer: Answer = succeed, known: Mapping[str, object] | None = None) -> Trace:
    world = KnowledgeBase(plan.facts, objects=plan.objects, rules=plan.rules)
    return drive(plan.graph, answer, bindings=plan.bindings, variables=plan.variables, known=known, world=world)


class Run:
    """Reads a plan and runs it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __call__(
        self, plan: str, answer: Answer = succeed, *, knowledge: str = "{}", rest: str = "", known: dict[str, object] | None = None
    ) -> Trace:
        return told(read(self.folder, plan, knowledge, rest), answer, known)

    def wrong(self, plan: str, rest: str = "") -> str:
        with pytest.raises(InputError) as caught:
            read(self.folder, plan, rest=rest)
        return str(caught.value)


@pytest.fixture
def run(tmp_path: Path) -> Run:
    return Run(tmp_path)


def variables(trace: Trace) -> dict[str, object]:
    return trace.run.knowledge.local.variables()


def causes(trace: Trace) -> list[str]:
    return [failure.cause for failure in trace.result.failures]


# --- golden results ------------------------------------------------------------------------


def test_golden_paper_listings(tmp_path: Path) -> None:
    path = tmp_path / "listing.yaml"
    path.write_text(
        """
actions:
  dummy_server:
    type: rpn_action
    params: [value]
    effects: {and: [{Comparison: [eq, [Query: time, Query: value]]}, {not: {Comparison: [ne, [Query: time, Query: value]]}}]}
    simulated: {time: "?value"}
  wait: {type: ros_action, params: [time], preconditions: {Exists: [Query: time]}}
---
initial_knowledge: {value: 3}
plan:
  - dummy_server: {}
  - concurrent_actions: [{wait: {}}, {wait: {}}, {concurrent_actions: [{wait: {time: 5}}, {wait: {time: 6}}]}]
"""
    )
    result = carry_out(path)
    assert result.goal_reached
    assert result.variables == {"value": 3, "time": 3}
    calls = [(call.call.action.name, call.call.action.arguments, call.started) for call in result.calls]
    assert calls == [("dummy_server", ("3",), 0.0), *(("wait", (time,), 1.0) for time in ("3", "3", "5", "6"))]


COUNTING = """
  - found: {}
  - while:
      condition: {Comparison: [ne, [LocalQuery: value, 10]]}
      actions:
        - given: {}
        - kb: {operation: {LocalUpdate: [value, {LocalQuery: result}, ""]}}
"""


def counted(request: Request) -> Outcome:
    value = request.goal.get("value", 0)
    assert isinstance(value, int)
    return Outcome(OutcomeKind.SUCCEEDED, {"result": value + 1})


def test_golden_counting_loop(run: Run) -> None:
    trace = run(COUNTING, counted, knowledge="{value: 5}")
    assert trace.result.goal
    assert [goal["value"] for name, goal in trace.sent if name == "given"] == [5, 6, 7, 8, 9]
    assert variables(trace) == {"value": 10, "result": 10}


def test_golden_single_abort_fails(run: Run) -> None:
    trace = run("[{a: {}}, {b: {}}]", outcomes(a=["aborted"]))
    assert (trace.result.goal, trace.actions, causes(trace)) == (False, ["a"], ["aborted"])


def test_golden_single_preempt_continues(run: Run) -> None:
    trace = run("[{a: {}}, {b: {}}]", outcomes(a=["canceled"]))
    assert (trace.result.goal, trace.actions) == (True, ["a", "b"])


def test_golden_precondition_false_fails(run: Run) -> None:
    trace = run("[{ready: {}}]", knowledge="{ready: false}")
    assert (trace.result.goal, trace.actions, causes(trace)) == (False, [], ["precondition_false"])


def test_golden_fork_with_one_abort_fails_and_the_others_end(run: Run) -> None:
    trace = run("[{concurrent_actions: [{a: {}}, {b: {}}]}, {c: {}}]", outcomes(a=["aborted"]))
    assert (trace.result.goal, trace.actions, causes(trace)) == (False, ["a", "b"], ["aborted"])
    assert {call.call.action.name: call.outcome for call in trace.result.calls}["b"] == "succeeded"


def test_golden_fork_with_all_aborts_fails(run: Run) -> None:
    trace = run("[{concurrent_actions: [{a: {}}, {b: {}}]}]", outcomes(a=["aborted"], b=["aborted"]))
    assert (trace.result.goal, causes(trace)) == (False, ["aborted", "aborted"])


def test_golden_empty_plan_succeeds(run: Run) -> None:
    assert run("[]").result.goal


def test_golden_loop_with_zero_rounds(run: Run) -> None:
    trace = run("[{while: {condition: {Comparison: [lt, [LocalQuery: value, 0]]}, actions: [{a: {}}]}}, {b: {}}]", knowledge="{value: 5}")
    assert (trace.result.goal, trace.actions) == (True, ["b"])


def test_golden_effects_that_hold_spare_the_action_even_if_its_precondition_is_false(run: Run) -> None:
    trace = run("[{both: {}}]", knowledge="{result: 1}")
    assert (trace.result.goal, trace.actions) == (True, [])
    assert causes(run("[{both: {}}]")) == ["precondition_false"]


@pytest.mark.parametrize(
    ("recovery", "goal", "sent"),
    [
        ("skip_action", True, ["b"]),
        ("[{c: {}}, skip_action]", True, ["c", "b"]),
        ("fail", False, []),
        ("[{kb: {operation: {LocalUpdate: [z, 1]}}}, restart_action]", True, ["a", "b"]),
        ("[{kb: {operation: {LocalUpdate: [z, 1]}}}, restart_plan]", True, ["a", "b"]),
    ],
)
def test_golden_recovery_before(run: Run, recovery: str, goal: bool, sent: list[str]) -> None:
    when = "{not: {Exists: [LocalQuery: z]}}"
    trace = run(f"[{{a: {{}}, recoveries: {{before: {{when: {when}, do: {recovery}}}}}}}, {{b: {{}}}}]")
    assert (trace.result.goal, trace.actions) == (goal, sent)


@pytest.mark.parametrize(
    ("recovery", "goal", "sent"),
    [
        ("skip_action", True, ["a", "b"]),
        ("continue", True, ["a", "b"]),
        ("fail", False, ["a"]),
        ("[{c: {}}, skip_action]", True, ["a", "c", "b"]),
        ("restart_action", True, ["a", "a", "b"]),
        ("[{c: {}}, restart_action]", True, ["a", "c", "a", "b"]),
        ("restart_plan", True, ["a", "a", "b"]),
    ],
)
def test_golden_recovery_during(run: Run, recovery: str, goal: bool, sent: list[str]) -> None:
    trace = run(f"[{{a: {{}}, recoveries: {{during: {{aborted: {recovery}}}}}}}, {{b: {{}}}}]", outcomes(a=["aborted"]))
    assert (trace.result.goal, trace.actions) == (goal, sent)


@pytest.mark.parametrize(
    ("recovery", "goal", "sent"),
    [("skip_action", True, ["found", "b"]), ("fail", False, ["found"]), ("[{c: {}}, restart_action]", True, ["found", "c", "b"])],
)
def test_golden_recovery_after(run: Run, recovery: str, goal: bool, sent: list[str]) -> None:
    def answer(request: Request) -> Outcome:
        return Outcome(OutcomeKind.SUCCEEDED, {"result": 1} if request.action.name == "c" else {})

    trace = run(f"[{{found: {{}}, recoveries: {{after: {recovery}}}}}, {{b: {{}}}}]", answer)
    assert (trace.result.goal, trace.actions) == (goal, sent)


def test_golden_before_with_a_chain_is_if_then_else(run: Run) -> None:
    plan = "[{a: {}, recoveries: {before: {when: {not: {Query: z}}, do: [{b: {}}, skip_action]}}}]"
    assert run(plan, knowledge="{z: true}").actions == ["a"]
    assert run(plan, knowledge="{z: false}").actions == ["b"]


# --- faults that are not repeated ----------------------------------------------------------


def test_b1_b4_what_is_not_carried_out_fails_by_name(run: Run) -> None:
    for kind in ("unavailable", "rejected", "lost"):
        assert causes(run("[{a: {}}]", outcomes(a=[kind]))) == [kind]


def test_b2_missing_data_is_a_failure_and_nothing_is_sent(run: Run) -> None:
    trace = run("[{given: {}}]")
    assert (trace.sent, causes(trace)) == ([], ["data_missing"])
    assert trace.result.failures[0].expected == "values for value"


def test_b5_an_operation_that_is_impossible_fails_and_one_that_is_missing_is_refused(run: Run) -> None:
    assert causes(run("[{kb: {operation: {LocalUpdate: [v, {Operation: [add, [LocalQuery: w, 1]]}]}}}]")) == ["aborted"]
    assert "expected the key 'operation'" in run.wrong("[{kb: {}}]")


def test_b6_b10_a_condition_that_cannot_be_computed_does_not_hold(run: Run) -> None:
    condition = "{Comparison: [lt, [LocalQuery: value, 3]]}"
    rest = f"  small: {{preconditions: {condition}}}\n"
    assert causes(run("[{small: {}}]", knowledge="{value: text}", rest=rest)) == ["precondition_false"]
    plan = f"[{{if: {condition}, then: [{{a: {{}}}}], else: [{{b: {{}}}}]}}]"
    assert run(plan, knowledge="{value: text}").actions == ["b"]


def test_b7_b8_any_number_of_operands_and_operations_in_operations(run: Run) -> None:
    three = "{and: [{Exists: [Query: v]}, {or: []}, {Exists: [Query: v]}]}"
    assert run(f"[{{if: {three}, then: [{{a: {{}}}}], else: [{{b: {{}}}}]}}]", knowledge="{v: 1}").actions == ["b"]
    nested = "{LocalUpdate: [v, {Operation: [add, [{Operation: [add, [LocalQuery: v, 1]]}, 1]]}]}"
    assert variables(run(f"[{{kb: {{operation: {nested}}}}}]", knowledge="{v: 1}")) == {"v": 3}


def test_b9_meta_information_is_computed_every_time(run: Run) -> None:
    ask = "{kb: {operation: {LocalUpdate: [heard, {RemoteQuery: [question, {number: {LocalQuery: n}}]}]}}}"
    count = "{kb: {operation: {LocalUpdate: [n, {Operation: [add, [LocalQuery: n, 1]]}]}}}"
    loop = f"[{{while: {{condition: {{Comparison: [lt, [LocalQuery: n, 3]]}}, actions: [{ask}, {count}]}}}}]"
    trace = run(loop, knowledge="{n: 0}", known={"question": 1})
    assert [one.meta for one in trace.asked] == ['{"number": 0}', '{"number": 1}', '{"number": 2}']


def test_b11_in_a_loop_an_action_is_called_in_every_round_and_rounds_are_counted(run: Run) -> None:
    loop = "[{while: {condition: {Exists: [LocalQuery: result]}, actions: [{found: {}}], limit: 7}}]"
    trace = run(loop, knowledge="{result: 0}")
    assert (trace.actions, causes(trace)) == (["found"] * 7, ["loop_limit"])


def test_b12_effects_that_never_come_are_waited_for_three_times(run: Run) -> None:
    trace = run("[{found: {}}]")
    assert (trace.actions, causes(trace)) == (["found"] * 4, ["effects_missing"])


def test_b14_a_chain_without_a_command_is_refused(run: Run) -> None:
    assert "expected a command at the end of the chain" in run.wrong("[{a: {}, recoveries: {during: {aborted: [{b: {}}]}}}]")


def test_b15_runs_do_not_inherit_what_others_knew(tmp_path: Path) -> None:
    plan = read(tmp_path, "[{kb: {operation: {LocalUpdate: [list, {Operation: [concat, [LocalQuery: list, [1]]]}]}}}]", "{list: []}")
    assert [variables(told(plan)) for _ in range(2)] == [{"list": [1]}] * 2


def test_b17_an_expression_with_two_words_is_refused(run: Run) -> None:
    assert "stands beside other keys" in run.wrong("[{if: {Exists: [Query: a], not: {Query: b}}, then: []}]")


def test_b18_names_are_names(run: Run) -> None:
    rest = "  Comparison: {<<: *ros_action}\n  exists: {<<: *ros_action}\n"
    names = "{query: 1, update: 2, lock: 3, self: 4, größe: 5}"
    trace = run("[{Comparison: {}}, {exists: {}}, {given: {value: {LocalQuery: lock}}}]", knowledge=names, rest=rest)
    assert (trace.result.goal, trace.actions, trace.sent[2][1]["value"]) == (True, ["Comparison", "exists", "given"], 3)
    assert "'while' is a word of the language" in run.wrong("[]", rest="  while: {}\n")


def test_c1_what_is_entered_again_goes_on(run: Run) -> None:
    trace = run(COUNTING.replace("10]]", "500]]"), counted, knowledge="{value: 0}")
    assert (trace.result.goal, len(trace.sent)) == (True, 501)


def test_c2_a_person_is_asked_once_for_one_check(run: Run) -> None:
    plan = "[{if: {Comparison: [eq, [PersonQuery: go, true]]}, then: [{a: {}}], else: [{b: {}}]}]"
    for answer, done in ((True, ["a"]), (False, ["b"])):
        trace = run(plan, known={"go": answer})
        assert (trace.actions, len(trace.asked)) == (done, 1)


def test_c4_what_is_updated_beside_an_action_is_there_for_the_next(run: Run) -> None:
    trace = run("[{concurrent_actions: [{a: {}}, {kb: {operation: {LocalUpdate: [value, 2]}}}]}, {given: {}}]", knowledge="{value: 1}")
    assert trace.sent[-1][1]["value"] == 2


def test_c5_beginning_anew_in_a_branch_ends_the_others_and_begins_once(run: Run) -> None:
    branches = "[{a: {}, recoveries: {during: {aborted: restart_plan}}}, {b: {}}]"
    trace = run(f"[{{concurrent_actions: {branches}}}]", outcomes(a=["aborted"]))
    assert (trace.result.goal, trace.actions) == (True, ["a", "b", "a", "b"])


def test_p1_the_blocks_of_a_long_plan_are_proved_once(tmp_path: Path) -> None:
    def long(calls: int) -> HandWrittenPlan:
        return read(tmp_path, f"[{', '.join(['{kb: {operation: {LocalUpdate: [v, 1]}}}'] * calls)}]")

    shorter, longer = (verify(generate(long(calls).graph)) for calls in (100, 400))
    assert (shorter.shapes, shorter.states) == (longer.shapes, longer.states)
    assert told(long(400)).result.goal


def test_p6_runs_that_are_over_are_forgotten(tmp_path: Path) -> None:
    plan = read(tmp_path, "[{a: {}}]")

    async def twice() -> list[object]:
        performer = Performer({"plan": Program.of(plan)}, simulated_backend(plan, plan.bindings), KnowledgeBase())
        await performer.backend.open(performer.world)
        for _ in range(2):
            assert (await performer.execute(performer.perform("plan"))).goal
        await performer.backend.close()
        return [*performer.going_on]

    assert run_async(twice(), virtual=True) == []


def test_6_missing_data_is_looked_up_in_the_global_knowledge(run: Run) -> None:
    trace = run("[{given: {}}]", known={"value": 7})
    assert (trace.result.goal, trace.sent[0][1]["value"]) == (True, 7)


# --- the page ------------------------------------------------------------------------------


def test_every_fault_and_difference_is_on_the_page() -> None:
    expected = [
        *(f"B{number}" for number in range(1, 20)),
        *(f"C{number}" for number in range(1, 7)),
        *(f"P{number}" for number in range(1, 7)),
    ]
    assert re.findall(r"^\| ([BCP]\d+) \|", PAGE, re.MULTILINE) == expected
    assert re.findall(r"^\| (\d+) \|", PAGE, re.MULTILINE) == [str(number) for number in range(1, 14)]


def test_every_test_that_the_page_names_is_there() -> None:
    named = set(re.findall(r"`(test_\w+)`", PAGE))
    there = {
        name for path in (ROOT / "tests").rglob("test_*.py") for name in re.findall(r"def (test_\w+)", path.read_text(encoding="utf-8"))
    }
    assert named <= there
    golden = {name for name in globals() if name.startswith("test_") and not name.startswith("test_every")}
    assert golden <= named
