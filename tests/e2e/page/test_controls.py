"""The page of `pnm serve` over ROS 2: a goal is sent there, paused, resumed and cancelled, which is in the journal as by other ways."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from pnm.journal.records import TaskAccepted, TaskHeld, TaskOver
from tests.support.e2e.deployment import ProblemDeployment
from tests.support.e2e.page.journals import steps
from tests.support.e2e.page.serving import announced, asked
from tests.support.e2e.plan_deployment import Serving
from tests.support.processes import until


def command(url: str, **fields: Any) -> tuple[int, dict[str, Any]]:
    """Send a command as the page does."""
    token = urlsplit(url).fragment.removeprefix("token=")
    headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/json"}
    status, _, text = asked(url, "/control", "POST", json.dumps(fields), **headers)
    return status, json.loads(text)


@pytest.fixture
def deployed(deploy: Callable[..., ProblemDeployment]) -> tuple[str, Path]:
    """A node with a page that controls it, in whose world robots are at work; where the page is, and the journal."""
    deployment = deploy("delivery/p01", speed="5", quick=True)
    deployment.simulate().ready()
    journal = deployment.folder / "node.journal"
    options = ["--view=0", "--view-controls", "--journal", str(journal)]
    serving = deployment.start(Serving(["-m", "planner_bridge", "serve", *deployment.files, *options], deployment.environment)).ready()
    return announced(serving.err), journal


def test_a_goal_from_the_page_is_paused_resumed_and_cancelled_and_all_of_it_is_kept(deployed: tuple[str, Path]) -> None:
    url, journal = deployed

    def kept() -> list[object]:
        return [step.record for step in steps(journal) if isinstance(step.record, TaskAccepted | TaskHeld | TaskOver)]

    assert command(url, do="check", goal="(at parcel1 kitchn)") == (
        409,
        {"refused": "unknown object 'kitchn'; did you mean 'kitchen'?", "line": 1, "column": 13},
    )
    assert command(url, do="goal", goal="(at parcel1 kitchen)")[0] == 200
    (accepted,) = kept()
    assert isinstance(accepted, TaskAccepted)
    assert accepted.wanted.text == "(at parcel1 kitchen)"
    task = accepted.wanted.id
    for word in ("pause", "resume", "cancel"):
        assert command(url, do=word, task=str(task)) == (200, {"refused": "", "line": 0, "column": 0})
    until(lambda: len(kept()) == 4)
    _, paused, resumed, over = kept()
    assert (paused, resumed) == (TaskHeld(task, True), TaskHeld(task, False))
    assert isinstance(over, TaskOver)
    assert over.ending.code.word == "cancelled"


def test_the_token_is_not_in_the_journal(deployed: tuple[str, Path]) -> None:
    url, journal = deployed
    token = urlsplit(url).fragment.removeprefix("token=")
    assert command(url, do="goal", goal="")[0] == 200
    assert len(token) >= 40
    assert token.encode() not in journal.read_bytes()
