"""What the first implementation of Petri Net Machines does: docs/project/original.md."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from planner_bridge.pipeline.achieve import carry_out
from pnm.core.machine.requests import Outcome, OutcomeKind, Request
from tests.support.files import ROOT
from tests.support.runs.direct import answering_with
from tests.support.yaml.original import COUNTING, RunOriginal, causes, counted, variables

PAGE = (ROOT / "docs" / "project" / "original.md").read_text(encoding="utf-8")


# --- golden results ---


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


def test_golden_counting_loop(run: RunOriginal) -> None:
    trace = run(COUNTING, counted, knowledge="{value: 5}")
    assert trace.result.goal
    assert [goal["value"] for name, goal in trace.sent if name == "given"] == [5, 6, 7, 8, 9]
    assert variables(trace) == {"value": 10, "result": 10}


ZERO = "[{while: {condition: {Comparison: [lt, [LocalQuery: value, 0]]}, actions: [{a: {}}]}}, {b: {}}]"
CHOICE = "[{a: {}, recoveries: {before: {when: {not: {Query: z}}, do: [{b: {}}, skip_action]}}}]"


@pytest.mark.parametrize(
    ("plan", "knowledge", "answers", "sent", "failed"),
    [
        ("[{a: {}}, {b: {}}]", "{}", {"a": ["aborted"]}, ["a"], ["aborted"]),
        ("[{a: {}}, {b: {}}]", "{}", {"a": ["canceled"]}, ["a", "b"], []),
        ("[{ready: {}}]", "{ready: false}", {}, [], ["precondition_false"]),
        ("[{concurrent_actions: [{a: {}}, {b: {}}]}, {c: {}}]", "{}", {"a": ["aborted"]}, ["a", "b"], ["aborted"]),
        ("[{concurrent_actions: [{a: {}}, {b: {}}]}]", "{}", {"a": ["aborted"], "b": ["aborted"]}, ["a", "b"], ["aborted", "aborted"]),
        ("[]", "{}", {}, [], []),
        (ZERO, "{value: 5}", {}, ["b"], []),
        ("[{both: {}}]", "{result: 1}", {}, [], []),  # its effects hold; its precondition does not
        ("[{both: {}}]", "{}", {}, [], ["precondition_false"]),
        (CHOICE, "{z: true}", {}, ["a"], []),
        (CHOICE, "{z: false}", {}, ["b"], []),
    ],
)
def test_golden_plan(
    run: RunOriginal, plan: str, knowledge: str, answers: dict[str, list[str]], sent: list[str], failed: list[str]
) -> None:
    trace = run(plan, answering_with(**answers), knowledge=knowledge)
    assert (trace.result.goal, trace.actions, causes(trace)) == (not failed, sent, failed)


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
def test_golden_recovery_before(run: RunOriginal, recovery: str, goal: bool, sent: list[str]) -> None:
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
def test_golden_recovery_during(run: RunOriginal, recovery: str, goal: bool, sent: list[str]) -> None:
    trace = run(f"[{{a: {{}}, recoveries: {{during: {{aborted: {recovery}}}}}}}, {{b: {{}}}}]", answering_with(a=["aborted"]))
    assert (trace.result.goal, trace.actions) == (goal, sent)


@pytest.mark.parametrize(
    ("recovery", "goal", "sent"),
    [("skip_action", True, ["found", "b"]), ("fail", False, ["found"]), ("[{c: {}}, restart_action]", True, ["found", "c", "b"])],
)
def test_golden_recovery_after(run: RunOriginal, recovery: str, goal: bool, sent: list[str]) -> None:
    def answer(request: Request) -> Outcome:
        return Outcome(OutcomeKind.SUCCEEDED, {"result": 1} if request.action.name == "c" else {})

    trace = run(f"[{{found: {{}}, recoveries: {{after: {recovery}}}}}, {{b: {{}}}}]", answer)
    assert (trace.result.goal, trace.actions) == (goal, sent)


# --- the page ---


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
