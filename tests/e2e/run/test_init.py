"""`pnm init`: the files that it writes for servers which are not ours pass `pnm check`, and a goal is reached with them."""

from __future__ import annotations

import pytest

from tests.support.processes import Program


@pytest.fixture
def servers(deploy):
    deployment = deploy("delivery/p01", quick=True)
    foreign = deployment.start(Program(["-m", "tests.support.e2e.programs.foreign_servers"], deployment.environment))
    foreign.until(lambda: foreign.out)
    return deployment


def test_the_first_files_pass_the_check_and_reach_their_goal(servers, tmp_path) -> None:
    def ends(*arguments: str) -> Program:
        program = servers.start(Program(["-m", "planner_bridge", *arguments], servers.environment))
        program.ended()
        return program

    folder = tmp_path / "mine"
    written = ends("init", str(folder))
    assert written.ended() == 0, str(written)
    assert "lines need a decision" in written.out[-1]
    files = [str(folder / "domain.pddl"), str(folder / "problem.pddl"), "--sensing", str(folder / "sensing.yaml")]
    checked = ends("check", *files)
    assert checked.ended() == 0, str(checked)
    run = ends("run", *files, "--actions", "ros2")
    assert run.ended() == 0, str(run)
    again = ends("init", str(folder))
    assert again.ended() == 2
    assert "domain.pddl" in again.err[-1]
