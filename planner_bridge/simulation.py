"""Simulated robots for a problem or a hand-written plan."""

from __future__ import annotations

from typing import TYPE_CHECKING

from planner_bridge.model.grounding import dynamic_names, initial_knowledge
from planner_bridge.model.problem import Problem
from pnm.actions.backend import SimulatedBackend
from pnm.actions.faults import NO_FAULTS, Faults
from pnm.actions.simulated_robots import SimulatedRobots, simulated_robots
from pnm.core.logic.effects import names_written
from pnm.core.machine.bindings import Bindings

if TYPE_CHECKING:
    from pnm.language.plan import HandWrittenPlan


def simulated_backend(described: Problem | HandWrittenPlan, bindings: Bindings, faults: Faults = NO_FAULTS) -> SimulatedBackend:
    """Return an execution backend of simulated robots, in a world that begins as the problem or plan says."""
    return SimulatedBackend(robots_of(described, bindings, faults), bindings.assumed)


def robots_of(described: Problem | HandWrittenPlan, bindings: Bindings, faults: Faults, *, speed: float = 1.0) -> SimulatedRobots:
    """Return simulated robots in a world that begins as the problem or plan says."""
    if isinstance(described, Problem):
        changing, lasting, capacities = dynamic_names(described), described.is_timed, None
    else:
        calls = described.graph.calls
        changing = names_written(tuple(effect for call in calls for effect in (*call.action.start_effects, *call.action.end_effects)))
        changing |= {fluent[0] for change in described.timed for fluent in change.changes}
        lasting = bool(described.timed) or any(call.action.duration is not None for call in calls)
        capacities = described.graph.capacities
    truth = initial_knowledge(described)
    return simulated_robots(truth, changing, bindings, faults, described.timed, lasting=lasting, speed=speed, capacities=capacities)
