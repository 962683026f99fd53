"""PDDL and planners: from a goal to a plan, from a plan to a Petri Net Machine, and again after a failure.

`achieve` does what `pnm run` does. Each arrow of problem → plan → plan graph → machine is one
function: `load`, `solve`, `plan_graph`, `pnm.generate`.
"""

from planner_bridge.model import ActionSchema, Domain, Problem
from planner_bridge.pddl import parse_domain, parse_problem, read_domain, read_problem
from planner_bridge.pddl_writer import write_domain, write_problem
from planner_bridge.pipeline import Settings, TaskObserver, TaskResult, achieve, load
from planner_bridge.plan import Plan, PlanningResult, PlanningStatus, PlanStep
from planner_bridge.planning import solve, validate
from planner_bridge.plans import plan_graph
from planner_bridge.replanning import Limits

__all__ = [
    "ActionSchema",
    "Domain",
    "Limits",
    "Plan",
    "PlanStep",
    "PlanningResult",
    "PlanningStatus",
    "Problem",
    "Settings",
    "TaskObserver",
    "TaskResult",
    "achieve",
    "load",
    "parse_domain",
    "parse_problem",
    "plan_graph",
    "read_domain",
    "read_problem",
    "solve",
    "validate",
    "write_domain",
    "write_problem",
]
