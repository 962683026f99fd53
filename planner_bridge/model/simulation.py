"""Simulated robots for a problem or a hand-written plan."""

from __future__ import annotations

from typing import TYPE_CHECKING

from planner_bridge.model.grounding import dynamic_names, initial_knowledge
from planner_bridge.model.problem import Problem
from pnm.actions.backend import SimulatedBackend
from pnm.actions.faults import NO_FAULTS, Faults
from pnm.actions.simulated_robots import SimulatedRobots, SimulatedWorld
from pnm.core.logic.effects import names_written
from pnm.core.machine.bindings import Bindings

if TYPE_CHECKING:
    from pnm.language.plan import HandWrittenPlan


def simulated_backend(described: Problem | HandWrittenPlan, bindings: Bindings, faults: Faults = NO_FAULTS) -> SimulatedBackend:
    """Return an execution backend of simulated robots, in the initial world of the problem or plan."""
    return SimulatedBackend(robots_of(described, bindings, faults), bindings.assumed)


def robots_of(described: Problem | HandWrittenPlan, bindings: Bindings, faults: Faults, *, speed: float = 1.0) -> SimulatedRobots:
    """Return simulated robots in the initial world of the problem or plan."""
    if isinstance(described, Problem):
        changing = dynamic_names(described)
    else:
        calls = described.graph.calls
        changing = names_written(tuple(effect for call in calls for effect in (*call.action.start_effects, *call.action.end_effects)))
        changing |= dynamic_names(described.declared)  # a planner that takes over may use any action of the domain
    hidden = {fluent[0] for change in faults.changes for fluent in change.changes}
    return SimulatedRobots(
        SimulatedWorld(initial_knowledge(described), changing | hidden),
        faults,
        bindings,
        described.timed,
        # In PDDL an action without a duration is instantaneous where there are times; otherwise nothing is known of how long it takes.
        untimed=0.0 if isinstance(described, Problem) and described.is_timed else 1.0,
        speed=speed,
        capacities={} if isinstance(described, Problem) else described.graph.capacities,
    )
