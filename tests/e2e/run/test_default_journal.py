"""The journal that `pnm serve` has unless it is told otherwise: where it is, what goes on from it, and who does not share it."""

from __future__ import annotations

import json
from pathlib import Path

from tests.support.e2e.deployment import SimulationProgram
from tests.support.e2e.plan_deployment import PlanDeployment, Serving
from tests.support.e2e.task_node import DOMAIN, PROBLEM, goals
from tests.support.files import written
from tests.support.processes import LIMIT, Program


def serve(deployment: PlanDeployment, *options: str) -> Serving:
    return deployment.start(Serving(["-m", "planner_bridge", "serve", DOMAIN, PROBLEM, "--improve", "0", *options], deployment.environment))


def journal_line(serving: Serving) -> str:
    serving.ready()
    (line,) = [line for line in serving.out if line.startswith("journal: ")]
    return line.removeprefix("journal: ")


def test_a_killed_node_goes_on_without_any_option_and_history_finds_its_journal(deployment: PlanDeployment) -> None:
    command = ["-m", "planner_bridge", "simulate", DOMAIN, PROBLEM, "--speed", "4", "--log", "/dev/stdout"]
    robots = deployment.start(SimulationProgram(command, deployment.environment)).ready()
    serving = serve(deployment)
    place = journal_line(serving)
    domain_id = deployment.environment["ROS_DOMAIN_ID"]
    assert place.startswith(f"{deployment.folder}/state/pnm/journals/pnm-{domain_id}-")
    goals(deployment, "(and (at parcel1 hall) (at parcel2 kitchen))")
    robots.happens("start", "move")
    serving.process.kill()
    serving.process.wait(LIMIT)
    serving = serve(deployment)
    assert journal_line(serving) == f"{place}; 1 task of another process goes on"
    serving.until(lambda: any("reached the goal holds" in line for line in serving.out))
    serving.stop()
    for name in ("history", "replay"):
        found = deployment.start(Program(["-m", "planner_bridge", name, "--json"], deployment.environment))
        assert found.ended() == 0, str(found)
        assert f"journal: {place}" in found.err
        assert all(map(json.loads, found.out))
    assert journal_line(serve(deployment)) == f"{place}; goes on with what was known"


def test_nodes_of_other_names_and_files_have_other_journals(deployment: PlanDeployment) -> None:
    changed = Path(PROBLEM).read_text(encoding="utf-8") + "\n"
    (deployment.folder / "problem.pddl").write_text(changed, encoding="utf-8")
    own_problem = ["serve", DOMAIN, str(deployment.folder / "problem.pddl"), "--ros-args", "-r", "__node:=three"]
    nodes = [
        serve(deployment),
        serve(deployment, "--ros-args", "-r", "__ns:=/r1"),
        deployment.start(Serving(["-m", "planner_bridge", *own_problem], deployment.environment)),
    ]
    places = [journal_line(node) for node in nodes]
    names = [place.rpartition("/")[2] for place in places]
    assert [name.split("-")[0] for name in names] == ["pnm", "r1.pnm", "three"]
    digests = [name.split("-")[2] for name in names]
    assert digests[0] == digests[1] != digests[2]


def test_what_was_begun_with_other_files_is_not_forgotten_in_silence(deployment: PlanDeployment) -> None:
    first = serve(deployment).ready()
    goals(deployment, "(at parcel1 hall)")
    first.until(lambda: any("queued" in line for line in first.out))
    first.process.kill()
    first.process.wait(LIMIT)
    problem = written(deployment.folder / "problem.pddl", Path(PROBLEM).read_text(encoding="utf-8") + "\n")
    second = deployment.start(Serving(["-m", "planner_bridge", "serve", DOMAIN, str(problem)], deployment.environment))
    assert journal_line(second) != journal_line(first)
    assert any("not finished with the files that this node had before: (at parcel1 hall)" in line for line in second.err), str(second)
    second.stop()
    third = serve(deployment)
    assert journal_line(third).endswith("; 1 task of another process goes on")


def test_none_keeps_nothing_and_says_so(deployment: PlanDeployment) -> None:
    assert journal_line(serve(deployment, "--journal", "none")) == "none, tasks end with this process"
    assert not [*deployment.folder.glob("state/pnm/journals/*")]
