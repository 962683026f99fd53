"""PDDL and planners: from a goal to a plan, from a plan to a Petri Net Machine, and again after a failure.

`achieve` does what `pnm run` does, and `achieve_async` the same on the event loop that is running. Each arrow
of problem → plan → plan graph → machine is one function: `load`, `solve`, `plan_graph`, `pnm.generate`.
"""

from typing import TYPE_CHECKING

from pnm.files.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from planner_bridge.model.plan import (
        Plan as Plan,
        PlanningResult as PlanningResult,
        PlanningStatus as PlanningStatus,
        PlanStep as PlanStep,
    )
    from planner_bridge.model.problem import Domain as Domain, Problem as Problem
    from planner_bridge.ordering.plan_to_graph import plan_graph as plan_graph
    from planner_bridge.pddl import (
        parse_domain as parse_domain,
        parse_problem as parse_problem,
        read_domain as read_domain,
        read_problem as read_problem,
    )
    from planner_bridge.pddl.writer import write_domain as write_domain, write_problem as write_problem
    from planner_bridge.pipeline.achieve import achieve as achieve, achieve_async as achieve_async
    from planner_bridge.pipeline.goal_handle import GoalHandle as GoalHandle
    from planner_bridge.pipeline.loading import load as load
    from planner_bridge.planning.kairos import validate as validate
    from planner_bridge.planning.solve import solve as solve
    from planner_bridge.tasks.replanning import Limits as Limits
    from planner_bridge.tasks.result import TaskResult as TaskResult
    from planner_bridge.tasks.settings import Settings as Settings, TaskObserver as TaskObserver
    from planner_bridge.view.story import timelines as timelines
    from pnm.core.logic.domain import ActionSchema as ActionSchema
else:
    __all__, __getattr__, __dir__ = lazy_exports(__name__, __file__)
