"""What is seen on a terminal only: how long a planner has searched, and its limit; reasons on lines that are not too long."""

from __future__ import annotations

import os
import pty
import re
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from planner_bridge.pddl import write_domain, write_problem
from tests.support.files import ROOT
from tests.support.pddl.problems import hard
from tests.support.processes import LIMIT


def on_a_terminal(*arguments: str) -> tuple[int, str]:
    """Return the exit status of a command, and what it has written to its terminal."""
    here, there = pty.openpty()
    seen: list[bytes] = []

    def read() -> None:
        try:
            while text := os.read(here, 4096):
                seen.append(text)
        except OSError:  # the terminal is closed
            pass

    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "80"}
    with subprocess.Popen(
        [sys.executable, "-m", "planner_bridge", *arguments], cwd=ROOT, env=environment, stdin=there, stdout=there, stderr=there
    ) as process:
        os.close(there)
        reader = threading.Thread(target=read)
        reader.start()
        status = process.wait(LIMIT)
    reader.join()
    os.close(here)
    return status, b"".join(seen).decode()


@pytest.mark.parametrize("command", [("plan",), ("net",), ("export", "--with-plan"), ("run",)])
def test_a_search_says_for_how_long_it_goes_on_and_what_to_do_when_its_time_is_over(command: tuple[str, ...], tmp_path: Path) -> None:
    domain, problem = tmp_path / "domain.pddl", tmp_path / "problem.pddl"
    domain.write_text(write_domain(hard().domain))
    problem.write_text(write_problem(hard()))
    status, seen = on_a_terminal(*command, str(domain), str(problem), "--planner-timeout", "1.5")
    assert status == 1
    assert re.search(r"kairos is looking for a plan, 1\.5 s at most: .*0:00:01", seen, re.DOTALL)
    assert "a longer limit (--planner-timeout) or another planner (--planner race) may find one" in " ".join(seen.split())


CLOSED = """(define (domain d)
  (:predicates (at_dock) (in_the_hall) (in_the_kitchen) (front_door_open) (kitchen_door_open) (lamp_on))
  (:action enter_the_hall :precondition (and (at_dock) (front_door_open)) :effect (and (not (at_dock)) (in_the_hall)))
  (:action enter_the_kitchen :precondition (and (in_the_hall) (kitchen_door_open)) :effect (in_the_kitchen)))"""
HELD = "(define (problem p) (:domain d) (:init (at_dock) (front_door_open)) (:goal (and (in_the_kitchen) (lamp_on))))"


@pytest.mark.parametrize(("command", "head"), [("plan", "no plan:"), ("run", "goal     not reached:")])
def test_why_there_is_no_plan_is_read_cause_by_cause(command: str, head: str, tmp_path: Path) -> None:
    (tmp_path / "d.pddl").write_text(CLOSED)
    (tmp_path / "p.pddl").write_text(HELD)
    status, seen = on_a_terminal(command, str(tmp_path / "d.pddl"), str(tmp_path / "p.pddl"))
    lines = [line.rstrip() for line in re.sub("\x1b\\[[0-9;?]*[A-Za-z]", "", seen).splitlines()]
    begin = next(number for number, line in enumerate(lines) if line.startswith(head))
    assert status == 1
    assert all(len(line) <= 80 for line in lines[begin:])
    reason = [line.strip() for line in lines[begin:] if "replans" not in line]
    assert " ".join(reason).endswith(
        "proved unsolvable: (in_the_kitchen) cannot be reached: enter_the_kitchen() would do it, but (kitchen_door_open) is never true; "
        "(lamp_on) cannot be reached: no action brings it about"
    )
    assert "(lamp_on) cannot be reached: no action brings it about" in reason


def test_nothing_of_it_is_seen_in_a_pipe(tmp_path: Path) -> None:
    (tmp_path / "p.pddl").write_text("(define (problem p) (:domain d) (:init) (:goal (a)))")
    (tmp_path / "d.pddl").write_text("(define (domain d) (:predicates (a)) (:action do :parameters () :effect (a)))")
    command = [sys.executable, "-m", "planner_bridge", "plan", str(tmp_path / "d.pddl"), str(tmp_path / "p.pddl")]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=True)
    assert "is looking" not in done.stdout + done.stderr


GUIDE = ("domains/mall_guide/domain.pddl", "problems/mall_guide/p01.pddl")
FAILING = ("domains/delivery/domain.pddl", "problems/delivery/p01.pddl", "--faults", "problems/delivery/faults.yaml")


@pytest.mark.parametrize("files", [GUIDE, FAILING])
def test_a_run_fits_on_a_terminal_and_begins_with_who_moves(files: tuple[str, ...]) -> None:
    status, seen = on_a_terminal("run", *files, "-v")
    lines = [line.rstrip().rpartition("\r")[2] for line in re.sub("\x1b\\[[0-9;?]*[A-Za-z]", "", seen).splitlines()]
    assert status == 0
    assert lines[0] == "robots   simulated here; --actions ros2 drives real ones"
    assert not [line for line in lines if len(line) > 80]


def test_how_large_a_machine_is_is_printed_when_it_is_asked_for() -> None:
    brief, verbose = (pnm_run(*GUIDE, *more) for more in ((), ("-v",)))
    assert "machine  proved: whatever happens, it ends in the goal or in a named failure\n" in brief
    (extra,) = set(verbose.splitlines()) - set(brief.splitlines())
    assert re.fullmatch(r" {9}\d+ places, \d+ transitions, 20 orderings; proved sound: 8 calls of 7 shapes, \d+ states explored", extra)


def pnm_run(*arguments: str) -> str:
    command = [sys.executable, "-m", "planner_bridge", "run", *arguments]
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=True).stdout
