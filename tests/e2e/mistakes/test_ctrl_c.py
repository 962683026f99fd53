"""Ctrl-C at any moment of a command is a sentence, an exit status and, where it was asked for, one JSON object."""

from __future__ import annotations

import json
import signal

import click
import pytest

from planner_bridge.__main__ import UNTOLD
from planner_bridge.cli.commands import app
from planner_bridge.model.plan import PlanningStatus
from pnm.tasks import Code
from tests.support.files import ROOT
from tests.support.processes import Program

FILES = [str(ROOT / "domains" / "delivery" / "domain.pddl"), str(ROOT / "problems" / "delivery" / "p01.pddl")]
AT_IMPORT = """
import signal, sys
from planner_bridge.__main__ import main

class Interrupting:
    left = int(sys.argv.pop(1))

    def find_spec(self, name, path=None, target=None):
        self.left -= 1
        if self.left == 0:
            signal.raise_signal(signal.SIGINT)

sys.meta_path.insert(0, Interrupting())
main()
"""
"""`pnm` that is interrupted when it looks for so many modules."""
SWALLOWED = """
import signal, sys
from planner_bridge.__main__ import main
from planner_bridge.planning import solve

class Unheard:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)

def solve_interrupted(*arguments, **options):
    {how}
    while True:
        pass

solve.solve = solve_interrupted
main()
"""


def ended(*arguments: str) -> tuple[int, list[str], list[str]]:
    """The exit status of a program, and what it has printed, in which there is no traceback."""
    program = Program(["-c", *arguments], {})
    try:
        return program.ended(), program.out, program.err
    finally:
        program.close()


@pytest.mark.parametrize(("command", "modules"), [("plan", 1), ("run", 200), ("plan", 800)])
def test_ctrl_c_before_a_command_has_begun_is_told_as_any_other_end(command: str, modules: int) -> None:
    status, out, err = ended(AT_IMPORT, str(modules), command, *FILES, "--json")
    (told,) = map(json.loads, out)
    if status:
        assert (status, told["reason"], err) == (1, "cancelled", ["cancelled"])
    else:  # it was over before so many were imported
        assert told.get("goal_reached") or told["status"] == "solved"


def test_ctrl_c_in_commands_without_json_is_one_line() -> None:
    assert ended(AT_IMPORT, "30", "history", "--json") == (1, [], ["cancelled"])


def test_the_json_of_a_command_that_was_cancelled_has_the_keys_of_that_command() -> None:
    assert {command: json.loads(f"{{{text}}}") for command, text in UNTOLD.items()} == {
        "run": {"goal_reached": False, "code": "cancelled"},
        "goal": {"goal_reached": False, "code": int(Code.CANCELLED)},
        "plan": {"status": PlanningStatus.CANCELLED.value, "steps": None},
        "odds": {"chance": None, "alone": None, "with_new_plans": None},
        "check": {"ready": None, "rows": None},
        "why": {"answers": None},
        "status": {"paused": None, "hands": None, "tasks": None},
        "facts": {},
    }
    assert ended(AT_IMPORT, "30", "facts", "--json") == (1, ['{"reason": "cancelled"}'], ["cancelled"])


def test_every_command_with_json_says_in_it_that_it_was_cancelled() -> None:
    with click.Context(app) as context:
        commands = {name: app.get_command(context, name) for name in app.list_commands(context)}
    with_json = {name for name, command in commands.items() if command and "as_json" in {option.name for option in command.params}}
    assert with_json - {"replay", "history"} == set(UNTOLD), "these print an object a line"


@pytest.mark.parametrize(
    "how",
    ["signal.raise_signal(signal.SIGINT)", "Unheard()", "exec('signal.raise_signal(signal.SIGINT)')"],
    ids=["in a function", "in a destructor", "in a text"],
)
def test_ctrl_c_that_python_would_swallow_is_heard(how: str) -> None:
    status, out, err = ended(SWALLOWED.format(how=how), "plan", *FILES, "--json")
    assert (status, [json.loads(one)["reason"] for one in out], err) == (1, ["cancelled"], ["cancelled"])


def test_a_second_signal_ends_a_run_that_hangs_and_its_json_is_there() -> None:
    hanging = """
import threading
from planner_bridge.__main__ import main
from pnm.files import signals
from pnm.actions.simulated_robots import SimulatedRobots

def send(self, request, report):
    print("sent", flush=True, file=sys.stderr)
    while True:
        try:
            threading.Event().wait()
        except KeyboardInterrupt:
            pass

def told(self, number, frame, receive=signals.StoppableWork._receive):
    print("told", flush=True, file=sys.stderr)
    receive(self, number, frame)

signals._ONE_REQUEST = 0.0
signals.StoppableWork._receive = told
SimulatedRobots.send = send
main()
"""
    program = Program(["-c", f"import sys\n{hanging}", "run", *FILES, "--json"], {})
    try:
        program.until(lambda: "sent" in program.err)
        program.process.send_signal(signal.SIGTERM)
        program.until(lambda: "told" in program.err)
        program.process.send_signal(signal.SIGTERM)
        assert program.ended(30.0) == 1
    finally:
        program.close()
    assert [one["reason"] for one in program.objects()] == ["cancelled"]
