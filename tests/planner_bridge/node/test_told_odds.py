"""The odds that a node tells of its tasks while it carries out a policy."""

from __future__ import annotations

from uuid import UUID

import pytest

from planner_bridge.node.spare_time import Foreteller
from planner_bridge.tasks.settings import Settings
from pnm.actions.faults import Faults
from pnm.tasks import TaskListener
from tests.support.pddl.chance import NEVER_FAILS, RIVER, to_the_island
from tests.support.tasks.node import simulated
from tests.support.tasks.simulation import TaskSimulation


class Told(TaskListener):
    """Writes down the odds of tasks. The mutable state is these."""

    def __init__(self, simulation: TaskSimulation) -> None:
        self.simulation, self.odds = simulation, list[float]()

    def changed(self, task: UUID) -> None:
        for status in self.simulation.master.status():
            if status.odds and (not self.odds or self.odds[-1] != status.odds.chance):
                self.odds.append(status.odds.chance)


@simulated(RIVER, chosen=Settings(), faults=Faults(drawn=to_the_island))
async def test_odds_count_with_what_the_policy_has_after_each_outcome(simulation: TaskSimulation):
    told, foreteller = Told(simulation), Foreteller(simulation.master, NEVER_FAILS, simulation.knowledge)
    simulation.master.listen(foreteller)
    simulation.master.listen(told)
    await simulation.reaches(simulation.want("(far)"))
    await foreteller.close()
    assert told.odds == [pytest.approx(0.65), pytest.approx(0.8)]
