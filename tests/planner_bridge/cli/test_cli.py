"""The command line from outside: exit statuses, messages with positions, no traceback."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from pnm.core.machine.verification.part import Unsound
from tests.support.e2e.command_line import pnm, result
from tests.support.files import ROOT
from tests.support.processes import LIMIT

DELIVERY = (str(ROOT / "domains/delivery/domain.pddl"), str(ROOT / "problems/delivery/p01.pddl"))
FAULTS = str(ROOT / "problems/delivery/faults.yaml")


def test_a_plan_is_printed() -> None:
    done = pnm("plan", *DELIVERY)
    assert done.returncode == 0
    assert done.stdout.startswith("plan     8 calls, 14.0 s\n      0.00 s  load(r1, parcel2, store)  [4.00 s]\n")


def test_a_plan_as_json() -> None:
    told = result(pnm("plan", *DELIVERY, "--json"))
    assert told["status"] == "solved"
    assert told["steps"][0] == {"action": "load", "arguments": ["r1", "parcel2", "store"], "start": 0.0, "duration": 4.0}  # type: ignore[index]
    assert all(len(str(step["start"])) < 8 for step in told["steps"])  # type: ignore[attr-defined]


def test_a_run_reaches_the_goal() -> None:
    done = pnm("run", *DELIVERY)
    assert done.returncode == 0
    assert "\ngoal     holds\n         1 plan, 0 replans, 8 requests, 0 failures\n" in done.stdout


def test_a_run_as_json_tells_everything() -> None:
    done = pnm("run", *DELIVERY, "--faults", FAULTS, "--json")
    told = result(done)
    assert done.returncode == 0
    assert done.stdout.count("\n") == 1
    assert (told["goal_reached"], told["plans"], told["replans"]) == (True, 2, 2)
    assert set(told["seconds"]) == {"parse", "plan", "translate", "verify", "execute"}  # type: ignore[call-overload]
    assert told["failures"][0] == {  # type: ignore[index]
        "call": "move(r1, hall, kitchen)#4",
        "cause": "aborted",
        "expected": "success",
        "observed": "the way is blocked",
    }
    assert {"action", "arguments", "outcome", "attempts"} <= set(told["calls"][0])  # type: ignore[index]


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


def test_no_plan_is_exit_one_and_says_so(tmp_path: Path) -> None:
    problem = tmp_path / "impossible.pddl"
    text = Path(DELIVERY[1]).read_text()
    problem.write_text(text[: text.index("(:goal")] + "(:goal (and (at parcel1 hall) (not (at parcel1 hall)))))")
    done = pnm("run", DELIVERY[0], str(problem), "--json")
    assert done.returncode == 1
    assert result(done)["goal_reached"] is False
    assert str(result(done)["reason"]).startswith("no plan: ")


@pytest.mark.parametrize(
    ("command", "text", "message"),
    [
        ("plan", "", "p.pddl:1:1: "),
        ("run", "(" * 20000, "p.pddl:1:"),
        ("net", "(define (problem p) (:domain delivery) (:goal (flies r1)))", "p.pddl:1:48: "),
    ],
    ids=["plan", "run", "net"],
)
def test_bad_input_is_exit_two_with_its_position(tmp_path: Path, command: str, text: str, message: str) -> None:
    (tmp_path / "p.pddl").write_text(text)
    done = pnm(command, DELIVERY[0], str(tmp_path / "p.pddl"))
    assert done.returncode == 2
    assert message in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert done.stdout == ""


def test_binary_missing_and_huge_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "binary.pddl").write_bytes(bytes(range(256)) * 40)
    with (tmp_path / "huge.pddl").open("wb") as huge:
        huge.truncate(10**9)
    for name in ("binary", "missing", "huge"):
        done = pnm("run", DELIVERY[0], str(tmp_path / f"{name}.pddl"))
        assert done.returncode == 2
        assert f"{name}.pddl:" in done.stderr


@pytest.mark.parametrize(
    ("option", "text"), [("--bindings", "actions:\n  mvoe: {server: /x}\n"), ("--faults", "faults:\n  - {action: mvoe, do: abort}\n")]
)
def test_a_file_of_an_option_is_refused_with_its_position(tmp_path: Path, option: str, text: str) -> None:
    (tmp_path / "x.yaml").write_text(text)
    done = pnm("run", *DELIVERY, option, str(tmp_path / "x.yaml"))
    assert done.returncode == 2
    assert re.search(r"x.yaml:2:\d+: there is no action 'mvoe' in the domain; did you mean 'move'\?\n$", done.stderr)


def test_an_unknown_planner_is_refused_with_those_there_are() -> None:
    done = pnm("plan", *DELIVERY, "--planner", "fastforward")
    assert done.returncode == 2
    assert done.stderr.startswith("there is no planner 'fastforward'; installed: ")


def test_a_machine_as_json_has_everything_that_executes_it() -> None:
    machine = json.loads(pnm("net", *DELIVERY).stdout)
    assert machine["calls"][0]["name"] == "load(r1, parcel2, store)#0"
    assert {place["role"] for place in machine["places"]} == {"", "goal", "failure", "budget", "ordering"}
    assert all(ordering["protects"] for ordering in machine["orderings"])


def test_the_demo_tells_the_whole_story() -> None:
    done = pnm("demo")
    assert done.returncode == 0
    for word in (
        "plan     8 calls",
        "machine  ",
        "proved: whatever happens, it ends in the goal or in a named failure",
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


@pytest.mark.parametrize("command", [["run", *DELIVERY], ["plan", *DELIVERY], ["net", *DELIVERY], ["demo"]])
def test_nobody_has_to_read_to_the_end(command: list[str]) -> None:
    with subprocess.Popen(
        [sys.executable, "-m", "planner_bridge", *command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT
    ) as process:
        assert process.stdout
        assert process.stderr
        process.stdout.close()
        assert process.stderr.read() == ""
        assert process.wait(LIMIT) == (0 if command[0] in ("run", "demo") else 1)


def test_unsound_is_an_error_with_a_trace() -> None:
    assert Unsound("it ends", ["a", "b"]).trace == ("a", "b")


# --- export and import ---------------------------------------------------------------------

PATROL = (str(ROOT / "domains/patrol/domain.pddl"), str(ROOT / "problems/patrol/p01.pddl"))


def test_what_is_exported_is_imported_again(tmp_path: Path) -> None:
    assert pnm("export", *PATROL, "-o", str(tmp_path / "x.yaml"), "--with-plan").returncode == 0
    done = pnm("import", str(tmp_path / "x.yaml"), "-o", str(tmp_path / "new"))
    written = "".join(f"wrote {tmp_path / 'new' / name}\n" for name in ("domain.pddl", "problem.pddl", "bindings.yaml"))
    assert (done.returncode, done.stdout, done.stderr) == (0, "", written)
    again = pnm("export", *(str(tmp_path / "new" / name) for name in ("domain.pddl", "problem.pddl")), "--with-plan")
    assert again.stdout == (tmp_path / "x.yaml").read_text(encoding="utf-8")
    assert "\nplan:\n  - move: {robot: r1, from: dock1, to: gate}\n" in again.stdout


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (("export", PATROL[0], "--with-plan"), 2, "a plan is for a problem; expected its file after "),
        (("export", str(ROOT / "nothing.pddl")), 2, f"{ROOT}/nothing.pddl: there is no such file"),
        (("import", str(ROOT / "nothing.yaml"), "-o", "x"), 2, f"{ROOT}/nothing.yaml: there is no such file"),
        (("import", FAULTS, "-o", "x"), 2, f"{FAULTS}:1:1: there is no domain in the file; expected the key 'actions'"),
    ],
)
def test_what_cannot_be_exported_or_imported(arguments: tuple[str, ...], status: int, message: str, tmp_path: Path) -> None:
    done = pnm(*arguments)
    assert done.returncode == status
    assert done.stderr.startswith(message)


@pytest.mark.parametrize("arguments", [["--help"], ["serve", "--help"]])
def test_help_needs_no_ros(arguments: list[str]) -> None:
    assert without_ros(arguments) == (0, "")


@pytest.mark.parametrize("arguments", [["serve", *DELIVERY], ["simulate", *DELIVERY], ["run", *DELIVERY, "--actions", "ros2"]])
def test_without_ros_a_command_that_needs_it_says_what_to_install(arguments: list[str]) -> None:
    status, errors = without_ros(arguments)
    assert status == 1
    assert "`pip install 'petri-net-machines[ros2]'`" in errors
    assert len(errors.splitlines()) == 1


def without_ros(arguments: list[str]) -> tuple[int, str]:
    """The exit status, and what is written to stderr, of a command where the packages of ROS 2 cannot be imported."""
    missing = "sys.modules |= dict.fromkeys(('rclpy', 'rcl_interfaces', 'lifecycle_msgs', 'action_msgs'))"
    program = f"import sys; {missing}; from planner_bridge.cli.commands import app; app(sys.argv[1:])"
    done = subprocess.run([sys.executable, "-c", program, *arguments], capture_output=True, text=True, check=False, cwd=ROOT)
    return done.returncode, done.stderr
