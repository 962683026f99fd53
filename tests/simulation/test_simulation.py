"""Simulations: no law is broken, a seed is the same wherever it is simulated, and what can go wrong does."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from pnm.core.machine.requests import OutcomeKind
from pnm.journal.records import TaskOver
from pnm.tasks import Code
from tests.support.files import ROOT
from tests.support.runs.simulation.course import simulate
from tests.support.runs.simulation.disk import Fate
from tests.support.runs.simulation.laws import broken_laws
from tests.support.runs.simulation.story import Heard, Lied, Sent, Started, Story, Suffered
from tests.support.runs.simulation.sweep import judged

SEEDS = range(80)


@pytest.fixture(scope="module")
def stories() -> list[Story]:
    return [simulate(seed) for seed in SEEDS]


def test_no_law_is_broken(stories: list[Story]) -> None:
    assert not [(seed, wrong) for seed, story in zip(SEEDS, stories, strict=True) for wrong in broken_laws(story)]


def test_everything_goes_wrong_that_can(stories: list[Story]) -> None:
    suffered = {moment.what for story in stories for moment in story.of(Suffered)}
    wanted = {fate.value for fate in Fate} - {Fate.SLEEPS_AFTER.value}
    assert wanted <= suffered
    assert {"is killed", "wakes", "is fenced off", "finds the disk full", "restarted", "stop", "pause", "pause at once"} <= suffered
    assert max(moment.epoch for story in stories for moment in story.of(Started)) > 3
    assert any(sent.is_again for story in stories for sent in story.of(Sent))
    assert {moment.kind for story in stories for moment in story.of(Lied)} == {OutcomeKind.SUCCEEDED, OutcomeKind.ABORTED}
    heard = {moment.kind for story in stories for moment in story.of(Heard)}
    assert {OutcomeKind.SUCCEEDED, OutcomeKind.ABORTED, OutcomeKind.REJECTED, OutcomeKind.CANCELED, OutcomeKind.LOST} <= heard
    codes = {record.ending.code for story in stories for record in story.records if isinstance(record, TaskOver)}
    assert codes == {Code.GOAL_REACHED, Code.ACTION_FAILED, Code.CANCELLED}


def test_a_seed_is_the_same_simulation_in_another_process() -> None:
    code = f"from {judged.__module__} import judged; print(*(judged(seed).digest for seed in range(4)))"
    environment = {**os.environ, "PYTHONHASHSEED": "1"}
    there = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT, env=environment)
    assert there.stdout.split() == [judged(seed).digest for seed in range(4)]
    assert len(set(there.stdout.split())) == 4
