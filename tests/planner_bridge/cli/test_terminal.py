"""What is seen on a terminal only: how long a planner has searched, and its limit; lines that are not too long; questions to a person."""

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
from tests.support.e2e.command_line import pnm
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


@pytest.mark.parametrize("command", [("export", "--with-plan"), ("run",)])
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


def test_why_there_is_no_plan_is_read_cause_by_cause(tmp_path: Path) -> None:
    (tmp_path / "d.pddl").write_text(CLOSED)
    (tmp_path / "p.pddl").write_text(HELD)
    status, seen = on_a_terminal("run", str(tmp_path / "d.pddl"), str(tmp_path / "p.pddl"))
    lines = [line.rstrip() for line in re.sub("\x1b\\[[0-9;?]*[A-Za-z]", "", seen).splitlines()]
    begin = next(number for number, line in enumerate(lines) if line.startswith("goal     not reached:"))
    assert status == 1
    assert all(len(line) <= 80 for line in lines[begin:])
    reason = [line.strip() for line in lines[begin:] if "replans" not in line]
    assert " ".join(reason).endswith(
        "proved unsolvable: (in_the_kitchen) cannot be reached: enter_the_kitchen() would do it, but (kitchen_door_open) is never true; "
        "(lamp_on) cannot be reached: no action brings it about"
    )
    assert "(lamp_on) cannot be reached: no action brings it about" in reason


GUIDE = ("domains/mall_guide/domain.pddl", "problems/mall_guide/p01.pddl")
FAILING = ("domains/delivery/domain.pddl", "problems/delivery/p01.pddl", "--faults", "problems/delivery/faults.yaml")


def test_a_run_fits_on_a_terminal_and_begins_with_who_moves() -> None:
    status, seen = on_a_terminal("run", *FAILING, "-v")
    lines = [line.rstrip().rpartition("\r")[2] for line in re.sub("\x1b\\[[0-9;?]*[A-Za-z]", "", seen).splitlines()]
    assert status == 0
    assert lines[0] == "robots   simulated here; --actions ros2 drives real ones"
    assert not [line for line in lines if len(line) > 80]


def test_how_large_a_machine_is_is_printed_when_it_is_asked_for() -> None:
    brief, verbose = (pnm("run", *GUIDE, *more).stdout for more in ((), ("-v",)))
    assert "machine  proved: whatever happens, it ends in the goal or in a named failure\n" in brief
    (extra,) = set(verbose.splitlines()) - set(brief.splitlines())
    assert re.fullmatch(r" {9}\d+ places, \d+ transitions, 11 orderings; proved sound: 8 calls of 8 shapes, \d+ states explored", extra)


# --- `pnm run --ask-for-help` ---

DOMAIN = "(define (domain d) (:predicates (open) (in)) (:action enter :precondition (open) :effect (in)))"
PROBLEM = "(define (problem p) (:domain d) (:init) (:goal (in)))"


@pytest.fixture
def closed(tmp_path: Path) -> tuple[str, str]:
    """A door that nothing opens."""
    domain, problem = tmp_path / "d.pddl", tmp_path / "p.pddl"
    domain.write_text(DOMAIN)
    problem.write_text(PROBLEM)
    return str(domain), str(problem)


def test_a_person_at_the_terminal_is_asked(closed: tuple[str, str]) -> None:
    hands, terminal = pty.openpty()
    command = [sys.executable, "-m", "planner_bridge", "run", *closed, "--ask-for-help"]
    with subprocess.Popen(command, stdin=terminal, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=ROOT, text=True) as process:
        os.close(terminal)
        assert process.stderr is not None
        shown = ""
        for answer in ("once more", "try again", "give up"):
            while not shown.endswith("or 'give up'. "):
                letter = process.stderr.read(1)
                assert letter, f"it has ended: {shown}"
                shown += letter
            assert "This goal cannot be reached: no plan: proved unsolvable: (in) cannot be reached" in shown
            shown = ""
            os.write(hands, f"{answer}\n".encode())
        out, _ = process.communicate(timeout=LIMIT)
    os.close(hands)
    assert process.returncode == 1
    assert "goal     not reached: no plan" in out
    assert out.rstrip().splitlines()[-2].endswith("a person was asked for help, and says to give up")


def test_without_a_terminal_the_goal_is_given_up_and_the_reason_says_so(closed: tuple[str, str]) -> None:
    done = pnm("run", *closed, "--ask-for-help")
    assert done.returncode == 1
    assert "help was asked for in vain: a person was to be asked or told something, but there is no terminal to do it on" in done.stdout
