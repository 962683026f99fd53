"""Simulated robots for a problem."""

from __future__ import annotations

from planner_bridge.model import Problem
from planner_bridge.state import dynamic_names, initial_knowledge
from pnm.actions.faults import NO_FAULTS, Faults
from pnm.actions.simulated import SimulatedRobots
from pnm.actions.world import World
from pnm.bindings import Bindings
from pnm.sites import RobotsSite


class SimulatedSite(RobotsSite):
    """Simulated robots in a world that starts as the problem says."""

    def __init__(self, problem: Problem, bindings: Bindings, faults: Faults = NO_FAULTS) -> None:
        super().__init__(simulated_robots(problem, bindings, faults), bindings.assumed)


def simulated_robots(problem: Problem, bindings: Bindings, faults: Faults, *, speed: float = 1.0) -> SimulatedRobots:
    """Return robots in a world that starts as the problem says."""
    hidden = {fluent[0] for change in faults.changes for fluent in change.changes}
    world = World(initial_knowledge(problem), dynamic_names(problem) | hidden)
    untimed = 0.0 if problem.is_timed else 1.0  # beside durative actions, the others take no time at all
    return SimulatedRobots(world, faults, bindings, problem.timed, untimed, speed)
