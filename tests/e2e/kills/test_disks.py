"""Disks that fill and become free again: tasks wait, and go on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

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
