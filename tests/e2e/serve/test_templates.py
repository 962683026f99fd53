"""The worlds of `pnm init --template` run at once, in this process and over ROS 2, and say what comes next."""

from __future__ import annotations

from pathlib import Path

import pytest

from planner_bridge.cli.robot import TEMPLATES
from tests.support.e2e.command_line import pnm
from tests.support.e2e.deployment import SimulationProgram
from tests.support.e2e.plan_deployment import PlanDeployment
from tests.support.files import ROOT
from tests.support.processes import Program

LINES = 60


def test_every_template_has_a_name_that_can_be_chosen_and_files_that_can_be_read_at_a_glance() -> None:
    folders = {folder.name: folder for folder in (ROOT / "domains" / "templates").iterdir()}
    assert sorted(folders) == sorted(TEMPLATES)
    for file in (file for folder in folders.values() for file in folder.iterdir()):
        lines = [line for line in file.read_text().splitlines() if line]
        assert len(lines) <= LINES, file
        assert lines[0].startswith((";", "#")), f"{file} does not say what to edit"


@pytest.mark.parametrize("name", TEMPLATES)
def test_a_template_runs_at_once_also_when_something_goes_wrong(tmp_path: Path, name: str) -> None:
    written = pnm("init", "mine", "--template", name, cwd=tmp_path)
    assert (written.returncode, "pnm run mine/domain.pddl mine/problem.pddl" in written.stdout) == (0, True), written.output
    done = pnm("run", "mine/domain.pddl", "mine/problem.pddl", "--improve", "0", "--faults", "mine/faults.yaml", cwd=tmp_path)
    assert (done.returncode, " retry " in done.stdout) == (0, True), done.output
    before = (tmp_path / "mine" / "domain.pddl").read_bytes()
    again = pnm("init", "mine", "--template", name, cwd=tmp_path)
    assert (again.returncode, "already exists" in again.stderr) == (2, True), again.output
    assert (tmp_path / "mine" / "domain.pddl").read_bytes() == before


@pytest.mark.parametrize("name", [name for name in TEMPLATES if name != "nav2"])  # no wheel has the types of Nav2
def test_a_template_passes_the_check_over_ros(deployment: PlanDeployment, name: str) -> None:
    folder = deployment.folder / "mine"
    assert pnm("init", str(folder), "--template", name).returncode == 0
    files = [str(folder / "domain.pddl"), str(folder / "problem.pddl")]
    absent = deployment.pnm(Program, "check", *files)
    assert absent.ended() == 1, str(absent)
    deployment.pnm(SimulationProgram, "simulate", *files).ready()
    for words in (["check", *files, "--wait", "30"], ["run", *files, "--actions", "ros2", "-q"]):
        program = deployment.pnm(Program, *words)
        assert program.ended() == 0, str(program)
