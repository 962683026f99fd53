"""Plan requests: plans for a goal from the current state, without execution."""

from __future__ import annotations

import threading
from dataclasses import replace

from planner_bridge.model.plan import Plan
from planner_bridge.model.problem import Problem
from planner_bridge.node.world_queries import SharedWorld
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.planning.solve import solve
from planner_bridge.tasks.result import code_of_planning
from planner_bridge.tasks.settings import Settings
from pnm.clock import in_own_thread
from pnm.tasks import Code, MadePlan, StepState, TaskStep


async def make_plan(world: SharedWorld, settings: Settings, goal: str, planner: str, seconds: float | None) -> MadePlan:
    """Search for a plan for a goal of the world, as its text or its name; cancelling this ends the planner.

    The settings have the planner and the time limit of requests that name none.
    """
    current, cancel = world.current_problem(), threading.Event()
    planner, timeout = planner or settings.planner, seconds or settings.planner_timeout

    def search() -> MadePlan:
        problem = replace(current, goal=world.read_goal(goal))
        result = solve(problem, planner=planner, timeout=timeout, improve=settings.improve, cancel=cancel, executor=settings.executor)
        if result.plan is None:
            return MadePlan(code_of_planning(result.status, ()), result.reason, str(problem.goal))
        return MadePlan(Code.GOAL_REACHED, f"found by {result.planner}", str(problem.goal), _steps(problem, result.plan))

    try:
        return await in_own_thread(search)
    finally:
        cancel.set()


def _steps(problem: Problem, plan: Plan) -> tuple[TaskStep, ...]:
    """Return the steps of a plan, each with the steps that are ordered before it."""
    before: dict[int, set[int]] = {}
    for ordering in plan_graph(problem, plan).orderings:
        before.setdefault(ordering.after.call, set()).add(ordering.before.call)
    return tuple(
        TaskStep(step.action, step.arguments, step.start, step.duration, StepState.WAITING, tuple(sorted(before.get(number, ()))))
        for number, step in enumerate(plan.steps)
    )
