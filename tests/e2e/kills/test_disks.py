"""Disks that fill and become free again, and that nobody may write: tasks wait, and go on; what cannot begin says why."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import pytest

from tests.support.e2e.plan_deployment import PlanDeployment, Serving
from tests.support.e2e.task_node import DOMAIN, PROBLEM
from tests.support.tasks.kills.campaign import carried_out_on_a_disk
from tests.support.tasks.kills.disks import small_disk
from tests.support.tasks.kills.instants import DiskFull
from tests.support.tasks.kills.scenario import random_scenario


def test_tasks_wait_while_the_disk_is_full_and_go_on_when_it_is_not(tmp_path: Path) -> None:
    full = [DiskFull(2, 0.1, is_killed=True), DiskFull(1, 0.1, is_killed=True), DiskFull(2, 0.4, is_killed=False)]
    with small_disk(tmp_path / "disk") as disk:
        verdict = carried_out_on_a_disk(replace(random_scenario(8), deaths=(*full, *full)), tmp_path, disk)
    assert not verdict.wrong, "\n".join(verdict.wrong)
    assert verdict.kills == 2, "the third process has all the time it needs"
    assert "nothing new is sent until it can" in verdict.said


def test_a_node_whose_disk_is_read_only_says_so_and_starts_when_it_is_not(deployment: PlanDeployment) -> None:
    def serve() -> Serving:
        journal = str(disk.folder / "journal")
        return deployment.start(Serving(["-m", "planner_bridge", "serve", DOMAIN, PROBLEM, "--journal", journal], deployment.environment))

    with small_disk(deployment.folder / "disk") as disk:
        if not disk.is_real and os.getuid() == 0:
            pytest.skip("no disk may be mounted here, and folders are not read-only for the superuser")
        with disk.read_only():
            refused = serve()
            assert refused.ended() == 2
            assert "journal cannot be " in " ".join(refused.err), str(refused)
        serve().ready().stop()
