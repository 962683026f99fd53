"""Random tasks in processes that die at random commits: what is drawn from a number, and what must hold in the end."""

from __future__ import annotations

import random
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Final
from unittest.mock import patch
from uuid import UUID

from pnm.actions.faults import NO_FAULTS
from pnm.core.machine.bindings import Bindings
from pnm.journal import journal
from pnm.tasks import Code, OnConflict, Wanted
from tests.support.runs.simulation.disk import DEATHS, DiskPlan
from tests.support.tasks.scenarios.crash import survive
from tests.support.tasks.scenarios.random_scenarios import Scenario, draw

LENGTHS: Final = (1, 3, 10, 1000)
"""Records after which a segment begins while tasks go on: most processes go on with what was said again at the beginning of one."""


def run_deaths(number: int, folder: Path, *, improve: float = 0.0) -> Counter[Code]:
    """Carry out the tasks of this number, in up to five processes; return how they have ended, and complain about what is wrong."""
    rng = random.Random(number)
    scenario = draw(rng)
    tasks = [_task(rng, scenario, UUID(int=position + 1)) for position in range(rng.randrange(1, 5))]
    with patch.multiple(journal, _LONGER=LENGTHS[number % len(LENGTHS)], _SHARE=0):
        survival = survive(
            scenario.world.problem,
            tasks,
            replace(scenario.settings, improve=improve, bindings=_unasked(scenario.settings.bindings)),
            folder / "journal",
            [DiskPlan(rng.randrange(1, 40), rng.choice(DEATHS), torn=rng.random()) for _ in range(rng.randrange(1, 5))],
            faults=scenario.faults if rng.random() < 0.5 else NO_FAULTS,
            programs=scenario.programs,
            limits=scenario.limits,
        )
    assert survival.endings.keys() == {task.id for task in tasks}, "every task has an end"
    assert not survival.wrong, survival.wrong
    errors = [ending.message for ending in survival.endings.values() if ending.code is Code.ERROR]
    assert not errors, errors
    return Counter(ending.code for ending in survival.endings.values())


def _task(rng: random.Random, scenario: Scenario, id: UUID) -> Wanted:
    kind, priority, on_conflict = rng.random(), rng.choice([0, 0, 1, 2]), rng.choice([OnConflict.DEFAULT, OnConflict.DEFAULT, *OnConflict])
    if kind < 0.7:
        return Wanted(id, scenario.world.goal(rng), priority, on_conflict=on_conflict)
    text = scenario.world.plan(rng) if kind < 0.85 else rng.choice([*scenario.programs])
    return Wanted(id, text, priority, on_conflict=on_conflict, is_plan=True)


def _unasked(bindings: Bindings) -> Bindings:
    """Return the bindings without questions to people: here are none."""
    return replace(bindings, actions={name: replace(binding, ask={}, goal=None) for name, binding in bindings.actions.items()})
