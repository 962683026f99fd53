"""What `pnm run` prints while a task goes on, and what `pnm watch` keeps in sight on a terminal of 80 columns."""

from __future__ import annotations

import io
from pathlib import Path
from uuid import UUID

import pytest
from rich.console import Console

from planner_bridge.cli.console import ToldFailures
from planner_bridge.cli.running_node import TaskBoard
from pnm.tasks import TraceEvent, TraceKind
from tests.support.e2e.command_line import Done, pnm

TIMED = ":requirements :typing :durative-actions :timed-initial-literals"
SHOP = f"""(define (domain d) ({TIMED}) (:predicates (open) (bought))
 (:durative-action buy :parameters () :duration (= ?duration 3) :condition (over all (open)) :effect (at end (bought))))"""
TWICE = f"""(define (domain d) ({TIMED}) (:predicates (a) (b))
 (:durative-action first :parameters () :duration (= ?duration 3) :condition () :effect (at end (a)))
 (:durative-action second :parameters () :duration (= ?duration 3) :condition (at start (a)) :effect (at end (b))))"""


def run(folder: Path, *faults: str, domain: str = TWICE, init: str = "", goal: str = "(b)", options: tuple[str, ...] = ()) -> Done:
    """Run a small problem, in which this goes wrong."""
    files = {
        "d.pddl": domain,
        "p.pddl": f"(define (problem p) (:domain d) (:init {init}) (:goal {goal}))",
        "f.yaml": f"faults: [{', '.join(f'{{action: {fault}}}' for fault in faults)}]",
    }
    for name, text in files.items():
        (folder / name).write_text(text)
    return pnm("run", str(folder / "d.pddl"), str(folder / "p.pddl"), "--faults", str(folder / "f.yaml"), *options)


def plan(folder: Path, text: str, *options: str) -> Done:
    """Run a plan by hand."""
    (folder / "plan.yaml").write_text(text)
    return pnm("run", "--plan", str(folder / "plan.yaml"), *options)


def test_seconds_count_from_the_beginning_of_the_task(tmp_path: Path) -> None:
    lines = run(tmp_path, domain=SHOP, init="(at 5 (open))", goal="(bought)").stdout.splitlines()
    assert [line for line in lines if "buy()" in line] == [
        "      5.00 s  buy()  [3.00 s]",
        "      5.00 s  start  buy()",
        "      8.00 s  done   buy()",
    ]


def test_seconds_of_a_hand_written_plan_count_from_its_beginning(tmp_path: Path) -> None:
    done = plan(tmp_path, "actions: {look: {duration: 1}}\nplan: [{look: , release: 3}]\n")
    assert "      3.00 s  start  look()" in done.stdout.splitlines()


@pytest.mark.parametrize(
    ("fault", "start", "why"),
    [
        ("hang", "10.00", "timed_out: expected an end within 10 s; observed none; then cancelled on request"),
        ("abort", " 1.50", "aborted: the action failed"),
        ("no_effect", " 3.01", "effects_missing: expected (a); observed (a) is false"),
    ],
)
def test_why_a_call_is_tried_again_stands_beside_the_attempt(tmp_path: Path, fault: str, start: str, why: str) -> None:
    done = run(tmp_path, f"first, do: {fault}, times: 1")
    assert f"     {start} s  retry  first(): attempt 2, after {why}" in done.stdout.splitlines()


def test_why_a_call_is_given_up_stands_beside_the_failure_with_its_limits(tmp_path: Path) -> None:
    lines = run(tmp_path, "first, do: hang, ignores_cancel: true, times: 1").stdout.splitlines()
    why = "expected an end within 10 s, or a confirmed cancellation within 5 s after that; observed neither"
    late = "     10.00 s  late   first(): it has not ended within 10 s, and is being cancelled"
    assert lines.index(late) == lines.index(f"     15.00 s  failed first(): timed_out: {why}") - 1


def test_a_call_that_is_over_as_soon_as_it_is_cancelled_has_failed_and_was_not_late(tmp_path: Path) -> None:
    lines = run(tmp_path, "first, do: hang, times: 2").stdout.splitlines()
    begun, *after = (line for line in lines if "first()" in line and " s  " in line and "[" not in line)
    assert begun == "      0.00 s  start  first()"
    assert after[:2] == [
        "     10.00 s  retry  first(): attempt 2, after timed_out: expected an end within 10 s; observed none; then cancelled on request",
        "     20.00 s  failed first() in 2 attempts: timed_out",
    ]


def test_a_call_of_a_plan_is_late_and_not_the_call_of_that_plan_with_its_number(tmp_path: Path) -> None:
    plans = "outer: {domain: d.yaml, plan: [{inner: , timeout: 2}]}\ninner: {domain: d.yaml, plan: [first: ]}\n"
    (tmp_path / "d.yaml").write_text("actions: {first: }")
    (tmp_path / "faults.yaml").write_text("faults: [{action: first, do: hang, ignores_cancel: true}]")
    lines = plan(tmp_path, plans, "--name", "outer", "--faults", str(tmp_path / "faults.yaml")).stdout.splitlines()
    assert [line for line in lines if " late " in line] == [
        "      2.00 s  late   inner(): it has not ended within 2 s, and is being cancelled"
    ]


def test_a_call_that_is_not_needed_is_said(tmp_path: Path) -> None:
    done = plan(tmp_path, "facts: [(b)]\nactions: {go: {effects: [(b)]}}\nplan: [go:]\n")
    assert "      0.00 s  spared go(): its effects hold already" in done.stdout.splitlines()


def test_every_call_has_its_reason_also_if_another_has_failed_for_the_same(tmp_path: Path) -> None:
    lines = run(tmp_path, *(f"{call}, do: abort, times: 1, message: no air" for call in ("first", "second"))).stdout.splitlines()
    assert [line.split("retry")[1].strip() for line in lines if " retry " in line] == [
        "first(): attempt 2, after aborted: no air",
        "second(): attempt 2, after aborted: no air",
    ]


def test_the_same_reason_is_printed_once_and_again_at_the_end(tmp_path: Path) -> None:
    lines = run(tmp_path, "first, do: abort, times: 9, message: out of tea").stdout.splitlines()
    assert [line.split()[2] for line in lines if "out of tea" in line] == ["retry", "reached:"]
    assert "      3.00 s  failed first() in 2 attempts: aborted" in lines


def test_a_question_without_an_answer_is_told_also_where_the_plan_goes_on(tmp_path: Path) -> None:
    choice = "{if: {Comparison: [eq, [PersonQuery: bell, rung]]}, then: [ring: ]}"
    done = plan(tmp_path, f"actions: {{ring: }}\nplan: [{choice}]\n")
    assert done.returncode == 0
    assert done.stderr == "person[bell] has no answer: a person was to be asked or told something, but there is no terminal to do it on\n"


def test_the_results_of_a_plan_are_printed_behind_its_end(tmp_path: Path) -> None:
    text = "params: [worst, told]\nactions: {go: }\nresults: [worst, told]\nplan: [go: ]\n"
    done = plan(tmp_path, text, "--set", "worst=31", "--set", "told=a b")
    assert done.stdout.splitlines()[-1] == "results  worst: 31, told: a b"


# --- `pnm watch` ---


TEA, POST = UUID(int=0xAAAAAAAA << 96), UUID(int=0xBBBBBBBB << 96)


def lines(board: TaskBoard, now: float) -> list[str]:
    console = Console(file=io.StringIO(), width=80)
    console.print(board.shown(now))
    return [line.rstrip() for line in console.file.getvalue().splitlines()]


def note(board: TaskBoard, task: UUID, kind: TraceKind, subject: str, text: str, now: float) -> None:
    board.note(TraceEvent(task, now, kind, subject, text), now)


def test_tasks_that_are_not_over_and_their_calls_stay_in_sight() -> None:
    board = TaskBoard()
    note(board, TEA, TraceKind.GOAL, "", "(has ada tea)", 0)
    note(board, TEA, TraceKind.STATE, "", "running", 0)
    note(board, TEA, TraceKind.SENT, "move(r1, hall, kitchen)", "", 1)
    note(board, TEA, TraceKind.FEEDBACK, "move(r1, hall, kitchen)", "distance_remaining 1.2", 2)
    note(board, POST, TraceKind.GOAL, "", "(at post [hall])", 2)
    note(board, POST, TraceKind.STATE, "", "queued: waits for (at r1 dock): it would change (at r1 hall), which the other needs", 2)
    assert lines(board, 13) == [
        "aaaaaaaa  (has ada tea)  running",
        "    12 s  move(r1, hall, kitchen)  distance_remaining 1.2",
        "bbbbbbbb  (at post [hall])  queued: waits for (at r1 dock): it would change (at",
        "          r1 hall), which the other needs",
    ]
    note(board, TEA, TraceKind.ENDED, "move(r1, hall, kitchen)", "succeeded", 14)
    assert [line.split()[0] for line in lines(board, 14)] == ["aaaaaaaa", "bbbbbbbb", "r1"]
    note(board, POST, TraceKind.STATE, "", "over: cancelled: its client has cancelled it", 15)
    note(board, TEA, TraceKind.STATE, "", "over: goal_reached: the goal holds", 15)
    assert lines(board, 15) == []


def test_a_request_to_cancel_is_no_call() -> None:
    board = TaskBoard()
    note(board, TEA, TraceKind.STATE, "", "running", 0)
    note(board, TEA, TraceKind.SENT, "move(r1, hall, kitchen)", "", 1)
    note(board, TEA, TraceKind.SENT, "", "a request to cancel move(r1, hall, kitchen): it has not ended within 30 s", 31)
    assert lines(board, 33) == ["aaaaaaaa    running", "    32 s  move(r1, hall, kitchen)"]


def test_a_failure_is_told_once() -> None:
    failures, move, blocked = ToldFailures(), "move(r1, hall, kitchen)", "aborted: the way is blocked"

    def told(task: UUID, kind: TraceKind, subject: str, text: str) -> str:
        return failures.words(TraceEvent(task, 0.0, kind, subject, text)).removeprefix(f"{subject}: ")

    assert told(TEA, TraceKind.ENDED, move, blocked) == blocked
    assert told(POST, TraceKind.FAILED, f"{move}#4", blocked) == blocked, "that is another task"
    assert told(TEA, TraceKind.FAILED, f"{move}#4", blocked) == "it is not tried again in this plan"
    assert told(TEA, TraceKind.FAILED, f"{move}#4", blocked) == blocked
    told(TEA, TraceKind.ENDED, move, "canceled: cancelled on request")
    late = "timed_out: expected an end within 30 s; observed none; then cancelled on request"
    assert told(TEA, TraceKind.FAILED, f"{move}#4", late) == late
    told(TEA, TraceKind.ENDED, move, blocked)
    told(TEA, TraceKind.STATE, "", "over: cancelled: its client has cancelled it")
    assert failures.ends == {}
