"""Robots whose sensors are late: what has changed is reported when the action that has changed it may be over already."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from planner_bridge.model.problem import Problem
from planner_bridge.model.world import robots_of
from planner_bridge.tasks.settings import Settings
from pnm.actions.backend import SimulatedBackend
from pnm.actions.faults import Faults
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.expressions import Fluent, Unknown, Value
from pnm.core.machine.bindings import Bindings
from tests.support.tasks.simulation import TaskSimulation, simulate_tasks

LATE: Final = 0.5
"""Seconds."""


class LateBackend(SimulatedBackend):
    """Simulated robots, and late sensors."""

    async def open(self, knowledge: KnowledgeBase) -> None:
        """Start the world's clock and its state reports."""
        world, loop = self.robots.world, asyncio.get_running_loop()
        names = world.reported(self._assumed)
        knowledge.sense(names, lag=2.0 * LATE)
        knowledge.replace(names, world.report(names))

        def report(changes: Mapping[Fluent, Value | Unknown]) -> None:
            loop.call_later(LATE, knowledge.update, {fluent: value for fluent, value in changes.items() if fluent[0] in names})

        world.truth.listen(report)
        self.robots.begin()


def late_backend(problem: Problem, bindings: Bindings, faults: Faults) -> SimulatedBackend:
    """Return the robots of a problem, with late sensors."""
    return LateBackend(robots_of(problem, bindings, faults), bindings.assumed)


def reach_with_late_sensors(problem: Problem, goal: str, journal: Path) -> None:
    """Have a goal reached, and keep a journal of that."""

    async def scenario(simulation: TaskSimulation) -> None:
        await simulation.reaches(simulation.want(goal))

    simulate_tasks(scenario, problem, chosen=Settings(), make_backend=late_backend, journal=journal)
