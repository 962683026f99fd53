"""Processes that are killed at every commit: goals go on in the next one, and nothing is done twice."""

from __future__ import annotations

from pathlib import Path
from uuid import UUID

import pytest

from planner_bridge.tasks.settings import Settings
from pnm.tasks import Code, Wanted
from tests.support.pddl.problems import fleet
from tests.support.runs.simulation.disk import DEATHS, DiskPlan, Fate
from tests.support.tasks.scenarios.crash import survive
from tests.support.tasks.scenarios.random_deaths import run_deaths

GOALS = (Wanted(UUID(int=1), "(in p0 a2)"), Wanted(UUID(int=2), "(at r1 a3)"))


@pytest.mark.parametrize("fate", DEATHS, ids=lambda fate: fate.name)
def test_a_goal_survives_a_death_at_every_commit(tmp_path: Path, fate: Fate) -> None:
    settings = Settings(improve=0.0)
    commit = 0
    while True:
        commit += 1
        survival = survive(fleet(), GOALS, settings, tmp_path / f"{commit}.journal", [DiskPlan(commit, fate)])
        assert {ending.code for ending in survival.endings.values()} == {Code.GOAL_REACHED}, (commit, survival.endings)
        assert not survival.doubled, commit
        assert not survival.wrong, commit
        if not survival.deaths:
            break
    assert commit > 20


@pytest.mark.parametrize("number", range(5))
def test_random_tasks_survive_random_deaths(number: int, tmp_path: Path) -> None:
    run_deaths(number, tmp_path)
