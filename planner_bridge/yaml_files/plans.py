"""Plans."""

from __future__ import annotations

from planner_bridge.yaml_files.emitter import Entry
from pnm.plan_graph import PlanGraph


def plan_entries(graph: PlanGraph) -> list[Entry]:
    """Return the plan."""
    return []
