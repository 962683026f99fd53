"""Original."""

from __future__ import annotations

from planner_bridge.model import Problem
from planner_bridge.plan import Plan


def write_original(problem: Problem, plan: Plan) -> str:
    """Write."""
    return ""
