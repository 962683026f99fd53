"""Simulated robots for a problem, or for a hand-written plan."""

from __future__ import annotations

from planner_bridge.model.grounding import dynamic_names, initial_knowledge
from planner_bridge.model.problem import Problem
from pnm.actions.backend import RobotsSite
from pnm.actions.faults import NO_FAULTS, Faults
from pnm.actions.simulated_robots import SimulatedRobots, simulated_robots
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.effects import names_written
from pnm.core.machine.bindings import Bindings
from pnm.language.plan import HandWrittenPlan


class SimulatedSite(RobotsSite):
    """Simulated robots in a world that starts as the problem says."""

    def __init__(self, problem: Problem, bindings: Bindings, faults: Faults = NO_FAULTS) -> None:
        super().__init__(robots_of(problem, bindings, faults), bindings.assumed)


def robots_of(problem: Problem, bindings: Bindings, faults: Faults, *, speed: float = 1.0) -> SimulatedRobots:
    """Return robots in a world that starts as the problem says."""
    truth, changing = initial_knowledge(problem), dynamic_names(problem)
    return simulated_robots(truth, changing, bindings, faults, problem.timed, lasting=problem.is_timed, speed=speed)


def simulated_site(plan: HandWrittenPlan, bindings: Bindings, faults: Faults = NO_FAULTS) -> RobotsSite:
    """Return simulated robots in a world that starts as the plan says."""
    calls = plan.graph.calls
    written = (names_written((*call.action.start_effects, *call.action.end_effects)) for call in calls)
    timed = (frozenset(fluent[0] for fluent in change.changes) for change in plan.timed)
    truth = KnowledgeBase(plan.facts, objects=plan.objects, rules=plan.rules)
    lasting = bool(plan.timed) or any(call.action.duration is not None for call in calls)
    changing, capacities = frozenset().union(*written, *timed), plan.graph.capacities
    robots = simulated_robots(truth, changing, bindings, faults, plan.timed, lasting=lasting, capacities=capacities)
    return RobotsSite(robots, bindings.assumed)
