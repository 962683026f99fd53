"""Random problems whose actions have several outcomes, pursued stretch by stretch in processes that die.

While no call fails, a declared outcome is no failure, no request is begun twice, and what can be reached for certain is reached. Whatever
fails, a task ends in its goal, which then is so in the world, or in a failure with a name.
"""

from __future__ import annotations

import random
from pathlib import Path
from uuid import UUID

from planner_bridge.tasks.settings import Settings
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.core.logic.conditions import evaluate
from pnm.core.machine.bindings import Binding, Bindings
from pnm.tasks import Code, Wanted
from tests.support.pddl.chance import Exact, uncertain_problem
from tests.support.runs.simulation.disk import DEATHS, DiskPlan
from tests.support.tasks.scenarios.crash import Survival, survive

KINDS = (FaultKind.ABORT, FaultKind.ABORT, FaultKind.REJECT, FaultKind.NO_EFFECT, FaultKind.SLOW)


def run_chances(number: int, folder: Path) -> Survival:
    """Pursue the goal of the problem of this number; complain about what is wrong."""
    rng = random.Random(number)
    problem = uncertain_problem(number, counts=rng.random() < 0.3)
    exact, names, retries = Exact(problem), [*problem.domain.actions], rng.choice([0, 1])
    failing = [
        Fault(rng.choice(names), rng.choice(KINDS), rng.randrange(3), rng.choice([1, 2, 6])) for _ in range(rng.choice([0, 0, 1, 3]))
    ]
    task = Wanted(UUID(int=1), str(problem.goal))
    survival = survive(
        problem,
        [task],
        Settings(improve=0.0, bindings=Bindings({name: Binding(retries=retries) for name in names}, lag=0.1)),
        folder / "journal",
        [DiskPlan(rng.randrange(1, 30), rng.choice(DEATHS), torn=rng.random()) for _ in range(rng.randrange(4))],
        faults=Faults(tuple(failing), seed=number),
    )
    assert not survival.wrong, survival.wrong
    ending, story = survival.endings[task.id], survival.story
    assert ending.code is not Code.ERROR, ending
    assert evaluate(problem.goal, story.truth) is True or ending.code is not Code.GOAL_REACHED, ending
    if not failing:
        results = [one.result or one.run.interim_result() for one in story.replay.runs.values()]
        assert not [failure for result in results for failure in result.failures]
        assert not survival.repeated
        assert ending.code is Code.GOAL_REACHED or not exact.has_strong_cyclic_policy, ending
    return survival
