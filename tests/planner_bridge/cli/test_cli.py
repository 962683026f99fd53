"""The command line from outside: exit statuses, messages with positions, no traceback."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from planner_bridge.cli.commands import app
from pnm.errors import installation
from tests.support.e2e.command_line import pnm, result
from tests.support.files import ROOT
from tests.support.processes import LIMIT

DELIVERY = (str(ROOT / "domains/delivery/domain.pddl"), str(ROOT / "problems/delivery/p01.pddl"))
PNM = (sys.executable, "-m", "planner_bridge")


@pytest.mark.parametrize("command", ["plan", "run"])
def test_what_is_wrong_with_a_file_but_understood_is_said_beside_the_answer(command: str, tmp_path: Path) -> None:
    domain, problem = tmp_path / "d.pddl", tmp_path / "p.pddl"
    facts = " ".join("(clean)" for _ in range(30))
    domain.write_text("(define (domain d) (:predicates (clean))\n(:action wipe :precondition (not (clean)) :effect (clean)))")
    problem.write_text(f"(define (problem p) (:domain other) (:init {facts}) (:goal (clean)))")
    done = pnm(command, str(domain), str(problem), "--json")
    assert done.returncode == 0
    assert done.stdout.count("\n") == 1
    assert result(done)
    lines = done.stderr.splitlines()
    assert lines[0] == f"{domain}:2:29: warning: :negative-preconditions is needed here but not among the :requirements"
    assert lines[1] == f"{problem}:1:30: warning: the problem is for a domain 'other'; this one is 'd'"
    assert lines[2] == f"{problem}:1:52: warning: (clean) is there twice"
    assert lines[-1] == f"{problem}: 10 more warnings"
    assert len(lines) == 1 + 20 + 1


def test_the_demo_tells_the_whole_story() -> None:
    done = pnm("demo")
    assert done.returncode == 0
    for word in (
        "plan     8 calls",
        "machine  proved: whatever happens, it ends in the goal or in a named failure",
        "failed move(r1, hall, kitchen)",
        "replan   ",
        "goal     holds",
        "is true",
    ):
        assert word in done.stdout
    assert "is false" not in done.stdout


def test_net_says_what_is_proved_and_which_transitions_never_fire() -> None:
    short, long = pnm("net", *DELIVERY), pnm("net", *DELIVERY, "-v")
    (line,) = short.stderr.splitlines()
    assert line.startswith("proved sound: 8 calls of ")
    assert "; 8 of " in line
    assert line.endswith(" transitions can never fire, -v lists them")
    assert "unload(r2, parcel1, hall)#7 ended_early: such an end implies that the request was accepted" in long.stderr
    assert long.stdout == short.stdout


@pytest.mark.parametrize(("command", "status"), [("run", 0), ("plan", 1)])
def test_nobody_has_to_read_to_the_end(command: str, status: int) -> None:
    with subprocess.Popen([*PNM, command, *DELIVERY], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT) as process:
        assert process.stdout
        assert process.stderr
        process.stdout.close()
        assert process.stderr.read() == ""
        assert process.wait(LIMIT) == status


def test_a_run_imports_neither_what_postgresql_nor_what_odds_and_nodes_need() -> None:
    python = [sys.executable, "-X", "importtime", *PNM[1:], "run", "-q", *DELIVERY]
    done = subprocess.run(python, capture_output=True, text=True, cwd=ROOT, timeout=LIMIT, check=True)
    imported = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines() if line.startswith("import time:")}
    assert "click" in imported
    needless = {"pg8000", "planner_bridge.pipeline.odds", "planner_bridge.node.options"}
    assert not needless & imported


@pytest.mark.parametrize(("arguments", "status"), [(["serve", "--help"], 0), (["serve", *DELIVERY], 1)])
def test_without_ros_a_command_that_needs_it_has_its_help_and_says_what_to_install(arguments: list[str], status: int) -> None:
    missing = "sys.modules |= dict.fromkeys(('rclpy', 'rcl_interfaces', 'lifecycle_msgs', 'action_msgs'))"
    program = f"import sys; {missing}; from planner_bridge.cli.commands import app; app(sys.argv[1:])"
    done = subprocess.run([sys.executable, "-c", program, *arguments], capture_output=True, text=True, check=False, cwd=ROOT)
    assert (done.returncode, len(done.stderr.splitlines())) == (status, status)
    assert (f"`{installation('ros2')}`" in done.stderr) == bool(status)


# --- help ---


CONTEXT = click.Context(app, info_name="pnm")
COMMANDS = {name: command for name in app.list_commands(CONTEXT) if (command := app.get_command(CONTEXT, name))}


def shown(*arguments: str) -> str:
    done = CliRunner().invoke(app, arguments, prog_name="pnm")
    assert done.exit_code == 0
    return done.output


def test_no_description_is_cut_off() -> None:
    lines = shown("--help").partition("Commands:\n")[2].splitlines()
    assert [line.split()[0] for line in lines] == [*COMMANDS]
    for line in lines:
        name, description = line.split(maxsplit=1)
        assert description == COMMANDS[name].get_short_help_str(100), "the list has it without importing the command"
        assert description.endswith(".")
        assert not description.endswith("...")
        assert len(description) <= 50, line


@pytest.mark.parametrize("name", COMMANDS)
def test_every_help_has_an_example_whose_words_the_command_takes(name: str) -> None:
    text = " ".join(shown("help", name).split())
    assert text == " ".join(shown(name, "--help").split())
    examples = text.partition("Example")[2].lstrip("s: ").split("; ")
    for example in examples:
        program, command, *arguments = shlex.split(example)
        assert (program, command) == ("pnm", name)
        COMMANDS[name].make_context(name, arguments, resilient_parsing=False)


@pytest.mark.parametrize("name", COMMANDS)
def test_the_limit_of_the_planner_has_one_name(name: str) -> None:
    options = {option for parameter in COMMANDS[name].params for option in parameter.opts}
    assert "--timeout" not in options
    assert ("--planner-timeout" in options) is ("--planner" in options)
    assert all(re.fullmatch(r"-[a-z]|--[a-z-]+|[a-z_]+", option) for option in options)
