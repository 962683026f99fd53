"""Simulated robots for a problem."""

from __future__ import annotations

from planner_bridge.model.grounding import dynamic_names, initial_knowledge
from planner_bridge.model.problem import Problem
from pnm.actions.backend import RobotsSite
from pnm.actions.faults import NO_FAULTS, Faults
from pnm.actions.simulated_robots import SimulatedRobots, simulated_robots
from pnm.core.machine.bindings import Bindings


class SimulatedSite(RobotsSite):
    """Simulated robots in a world that starts as the problem says."""

    def __init__(self, problem: Problem, bindings: Bindings, faults: Faults = NO_FAULTS) -> None:
        super().__init__(robots_of(problem, bindings, faults), bindings.assumed)


def robots_of(problem: Problem, bindings: Bindings, faults: Faults, *, speed: float = 1.0) -> SimulatedRobots:
    """Return robots in a world that starts as the problem says."""
    truth, changing = initial_knowledge(problem), dynamic_names(problem)
    return simulated_robots(truth, changing, bindings, faults, problem.timed, lasting=problem.is_timed, speed=speed)
