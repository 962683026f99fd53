"""PDDL and planners: from a goal to a plan, from a plan to a Petri Net Machine, and again after a failure.

`achieve` does what `pnm run` does. Each arrow of problem → plan → plan graph → machine is one
function: `load`, `solve`, `plan_graph`, `pnm.generate`.
"""

from typing import TYPE_CHECKING

from pnm.files.lazy_exports import lazily

if TYPE_CHECKING:
    from planner_bridge.loading import load
    from planner_bridge.model.plan import Plan, PlanningResult, PlanningStatus, PlanStep
    from planner_bridge.model.problem import Domain, Problem
    from planner_bridge.ordering.plan_to_graph import plan_graph
    from planner_bridge.pddl import parse_domain, parse_problem, read_domain, read_problem
    from planner_bridge.pddl.write.writer import write_domain, write_problem
    from planner_bridge.pipeline import achieve
    from planner_bridge.planning.kairos import validate
    from planner_bridge.planning.solve import solve
    from planner_bridge.tasks.replanning import Limits
    from planner_bridge.tasks.result import TaskResult
    from planner_bridge.tasks.settings import Settings, TaskObserver
    from pnm.core.logic.domain import ActionSchema

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
    "ActionSchema": "pnm.core.logic.domain",
    "Domain": "planner_bridge.model.problem",
    "Problem": "planner_bridge.model.problem",
    "parse_domain": "planner_bridge.pddl",
    "parse_problem": "planner_bridge.pddl",
    "read_domain": "planner_bridge.pddl",
    "read_problem": "planner_bridge.pddl",
    "write_domain": "planner_bridge.pddl.write.writer",
    "write_problem": "planner_bridge.pddl.write.writer",
    "Settings": "planner_bridge.tasks.settings",
    "TaskObserver": "planner_bridge.tasks.settings",
    "TaskResult": "planner_bridge.tasks.result",
    "achieve": "planner_bridge.pipeline",
    "load": "planner_bridge.loading",
    "Plan": "planner_bridge.model.plan",
    "PlanningResult": "planner_bridge.model.plan",
    "PlanningStatus": "planner_bridge.model.plan",
    "PlanStep": "planner_bridge.model.plan",
    "solve": "planner_bridge.planning.solve",
    "validate": "planner_bridge.planning.kairos",
    "plan_graph": "planner_bridge.ordering.plan_to_graph",
    "Limits": "planner_bridge.tasks.replanning",
}

__getattr__, __dir__ = lazily(__name__, _WHERE)
