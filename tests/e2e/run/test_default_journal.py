"""The journal that `pnm serve` has unless it is told otherwise: where it is, what goes on from it, and who does not share it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from planner_bridge.node.node_journal import journal_of
from tests.support.e2e.command_line import pnm
from tests.support.e2e.plan_deployment import PlanDeployment, Serving
from tests.support.e2e.task_node import DOMAIN, PROBLEM, goals
from tests.support.files import written
from tests.support.processes import LIMIT


def serve(deployment: PlanDeployment, *options: str) -> Serving:
    return deployment.pnm(Serving, "serve", DOMAIN, PROBLEM, "--improve", "0", *options)


def journal_line(serving: Serving) -> str:
    serving.ready()
    (line,) = [line for line in serving.out if line.startswith("journal: ")]
    return line.removeprefix("journal: ")


def kill(serving: Serving) -> None:
    serving.process.kill()
    serving.process.wait(LIMIT)


def test_a_killed_node_goes_on_without_any_option_and_with_other_files_another_begins_that_says_so(
    deployment: PlanDeployment, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = serve(deployment)
    place = journal_line(first)
    domain_id = deployment.environment["ROS_DOMAIN_ID"]
    assert place.startswith(f"{deployment.folder}/state/pnm/journals/pnm-{domain_id}-")
    goals(deployment, "(at parcel1 hall)")
    first.until(lambda: any("queued" in line for line in first.out))
    kill(first)
    problem = written(deployment.folder / "problem.pddl", Path(PROBLEM).read_text(encoding="utf-8") + "\n")
    other = deployment.pnm(Serving, "serve", DOMAIN, str(problem))
    assert journal_line(other) != place
    assert any("not finished with the files that this node had before: (at parcel1 hall)" in line for line in other.err), str(other)
    other.stop()
    second = serve(deployment)
    assert journal_line(second) == f"{place}; 1 task of another process goes on"
    second.stop()
    monkeypatch.setenv("XDG_STATE_HOME", deployment.environment["XDG_STATE_HOME"])
    for name in ("history", "replay"):
        found = pnm(name, "--json")
        assert found.returncode == 0, found.stderr
        assert found.stderr == f"journal: {place}\n"
        assert all(map(json.loads, found.stdout.splitlines()))
    assert journal_line(serve(deployment)) == f"{place}; goes on with what was known"


def test_nodes_of_other_names_and_files_have_other_journals() -> None:
    files, others = "0" * 64, "1" * 64
    places = [journal_of("", node, 7, origin) for node, origin in (("/pnm", files), ("/r1/pnm", files), ("/pnm", others))]
    assert [place.name for place in places if isinstance(place, Path)] == [
        "pnm-7-000000000000.journal",
        "r1.pnm-7-000000000000.journal",
        "pnm-7-111111111111.journal",
    ]


def test_none_keeps_nothing_and_says_so(deployment: PlanDeployment) -> None:
    assert journal_line(serve(deployment, "--journal", "none")) == "none, tasks end with this process"
    assert not [*deployment.folder.glob("state/pnm/journals/*")]
