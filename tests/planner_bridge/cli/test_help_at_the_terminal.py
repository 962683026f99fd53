"""`pnm run --ask-for-help`: a person at the terminal is asked when the goal cannot be reached."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.e2e.command_line import pnm
from tests.support.files import ROOT
from tests.support.processes import LIMIT

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
