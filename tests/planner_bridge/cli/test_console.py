"""What `pnm run` prints while a task goes on."""

from __future__ import annotations

from pathlib import Path

import pytest

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


def plan(folder: Path, text: str) -> Done:
    """Run a plan by hand."""
    (folder / "plan.yaml").write_text(text)
    return pnm("run", "--plan", str(folder / "plan.yaml"))


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


def test_a_quiet_run_prints_how_it_ended(tmp_path: Path) -> None:
    done = run(tmp_path, options=("-q",))
    assert (done.returncode, done.stdout) == (0, "goal     holds\n         1 plan, 0 replans, 2 requests, 0 failures\n")


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
