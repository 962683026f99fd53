"""PDDL and planners: from a goal to a plan, from a plan to a Petri Net Machine, and again after a failure.

`achieve` does what `pnm run` does. Each arrow of problem → plan → plan graph → machine is one
function: `load`, `solve`, `plan_graph`, `pnm.generate`.
"""

from typing import TYPE_CHECKING

from pnm.lazy import lazily

if TYPE_CHECKING:
    from planner_bridge.loading import load
    from planner_bridge.model import ActionSchema, Domain, Problem
    from planner_bridge.pddl import parse_domain, parse_problem, read_domain, read_problem
    from planner_bridge.pddl.writer import write_domain, write_problem
    from planner_bridge.pipeline import achieve
    from planner_bridge.plan import Plan, PlanningResult, PlanningStatus, PlanStep
    from planner_bridge.planning import solve, validate
    from planner_bridge.plans import plan_graph
    from planner_bridge.replanning import Limits
    from planner_bridge.tasks import Settings, TaskObserver, TaskResult

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

_WHERE = {
    "ActionSchema": "planner_bridge.model",
    "Domain": "planner_bridge.model",
    "Problem": "planner_bridge.model",
    "parse_domain": "planner_bridge.pddl",
    "parse_problem": "planner_bridge.pddl",
    "read_domain": "planner_bridge.pddl",
    "read_problem": "planner_bridge.pddl",
    "write_domain": "planner_bridge.pddl.writer",
    "write_problem": "planner_bridge.pddl.writer",
    "Settings": "planner_bridge.tasks",
    "TaskObserver": "planner_bridge.tasks",
    "TaskResult": "planner_bridge.tasks",
    "achieve": "planner_bridge.pipeline",
    "load": "planner_bridge.loading",
    "Plan": "planner_bridge.plan",
    "PlanningResult": "planner_bridge.plan",
    "PlanningStatus": "planner_bridge.plan",
    "PlanStep": "planner_bridge.plan",
    "solve": "planner_bridge.planning",
    "validate": "planner_bridge.planning",
    "plan_graph": "planner_bridge.plans",
    "Limits": "planner_bridge.replanning",
}

__getattr__, __dir__ = lazily(__name__, _WHERE)
