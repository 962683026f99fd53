"""`pnm why`: plans, problems without one, and runs explained on the command line; wrong names refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from planner_bridge.pipeline.achieve import achieve
from tests.support.e2e.command_line import pnm
from tests.support.files import ROOT

DELIVERY = (str(ROOT / "domains/delivery/domain.pddl"), str(ROOT / "problems/delivery/p01.pddl"))


def test_what_each_call_is_for_and_one_of_them() -> None:
    assert "#7 unload(r2, parcel1, hall): for the goal (at parcel1 hall)" in pnm("why", *DELIVERY).stdout
    one = pnm("why", *DELIVERY, "--call", "2").stdout
    assert one.startswith("#2 move(r1, store, hall) is needed")
    assert pnm("why", *DELIVERY, "--call", "(move r1 store hall)").stdout == one


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["--not", "fly(r1)"], "--not: there is no action 'fly'; expected one of move, pass_door"),
        (["--not", "mov(r1, hall, kitchen)"], "--not: there is no action 'mov'; did you mean 'move'?"),
        (["--not", "move(r1, hall, kichen)"], "--not: 'kichen' is no object for ?to of move; did you mean 'kitchen'?"),
        (["--not", "move(r1)"], "--not: move takes 3 arguments"),
        (["--not", ""], "--not: expected a call such as"),
        (["--call", "pass_door(r1, door1, corridor, kitchen)"], "--call: pass_door(r1, door1, corridor, kitchen) is not in the plan"),
        (["--call", "8"], "--call: there is no call 8: the plan has 8"),
        (["--call", "1", "--not", "move(r1, hall, kitchen)"], "expected one of --call, --not and --replan"),
        (["--replan"], "--replan is about a run"),
        (["--task", "1"], "--task and --to are about a journal"),
    ],
)
def test_questions_that_make_no_sense_are_refused(given: list[str], message: str) -> None:
    done = pnm("why", *DELIVERY, *given)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(message)


def test_half_a_question_is_refused(tmp_path: Path) -> None:
    assert "expected DOMAIN and PROBLEM, or neither" in pnm("why", DELIVERY[0]).stderr
    assert "--not needs other plans" in pnm("why", "--journal", str(tmp_path / "x"), "--not", "move(r1, hall, kitchen)").stderr
    missing = pnm("why", "--journal", str(tmp_path / "none.journal"))
    assert missing.returncode == 2
    assert "Traceback" not in missing.stderr


def test_a_run_is_explained_and_other_ways_in_the_middle_of_it(tmp_path: Path) -> None:
    journal = tmp_path / "run.journal"
    assert achieve(*DELIVERY, journal=journal).goal_reached
    assert pnm("why", "--journal", str(journal)).stdout == "the goal of the problem is over: goal_reached: the goal holds [observed]\n"
    assert pnm("why", "--journal", str(journal), "--replan").stdout.startswith("there was no new plan")
    waits = pnm("why", "--journal", str(journal), "--to", "28").stdout
    assert "#6 unload(r1, parcel2, kitchen) waits" in waits
    now = pnm("why", *DELIVERY, "--journal", str(journal), "--to", "28").stdout
    assert "for the goal (at parcel2 kitchen)" in now
    assert "load(r1, parcel2, store)" not in now, "it is done"
