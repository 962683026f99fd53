"""What `pnm run` prints while a task goes on."""

from __future__ import annotations

from pathlib import Path

from tests.support.processes import pnm

SHOP = "(define (domain shop) (:requirements :typing :durative-actions :timed-initial-literals) (:predicates (open) (bought))\n"
BUY = " (:durative-action buy :parameters () :duration (= ?duration 3) :condition (over all (open)) :effect (at end (bought))))"


def test_seconds_count_from_the_beginning_of_the_task(tmp_path: Path) -> None:
    (tmp_path / "d.pddl").write_text(SHOP + BUY)
    (tmp_path / "p.pddl").write_text("(define (problem p) (:domain shop) (:init (at 5 (open))) (:goal (bought)))")
    lines = pnm("run", str(tmp_path / "d.pddl"), str(tmp_path / "p.pddl")).stdout.splitlines()
    assert [line for line in lines if "buy()" in line] == [
        "      5.00 s  buy()  [3.00 s]",
        "      5.00 s  start  buy()",
        "      8.00 s  done   buy()",
    ]


def test_seconds_of_a_hand_written_plan_count_from_its_beginning(tmp_path: Path) -> None:
    (tmp_path / "p.yaml").write_text("actions: {look: {duration: 1}}\nplan: [{look: , release: 3}]\n")
    lines = pnm("run", "--plan", str(tmp_path / "p.yaml")).stdout.splitlines()
    assert "      3.00 s  start  look()" in lines
