"""Plan requests: plans for a goal from the current state, without execution."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

from planner_bridge.model.grounding import problem_now
from planner_bridge.model.plan import Plan
from planner_bridge.model.problem import Problem
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.planning.solve import solve
from planner_bridge.tasks.result import code_of_planning
from planner_bridge.tasks.settings import Settings
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import Condition
from pnm.tasks import Code, MadePlan, StepState, TaskStep


@dataclass(frozen=True)
class Maker:
    """Answers plan requests, as `pnm.tasks.Make`.

    Args:
        settings: planner and time limit of requests that name none.
        read_goal: reads a text as a goal; raises InputError.
        began: the time of the problem's initial state, on the clock of the event loop.
    """

    problem: Problem
    knowledge: KnowledgeBase
    settings: Settings
    read_goal: Callable[[str], Condition]
    began: float

    async def make(self, goal: str, planner: str, seconds: float | None) -> MadePlan:
        """Search for a plan; cancelling this ends the planner."""
        elapsed = asyncio.get_running_loop().time() - self.began
        problem = replace(problem_now(self.problem, self.knowledge, elapsed), goal=self.read_goal(goal))
        stop = threading.Event()
        search = partial(
            solve,
            problem,
            planner=planner or self.settings.planner,
            timeout=seconds or self.settings.planner_timeout,
            cancel=stop,
            executor=self.settings.executor,
        )
        try:
            result = await asyncio.to_thread(search)
        finally:
            stop.set()
        if result.plan is None:
            return MadePlan(code_of_planning(result.status, ()), result.reason, str(problem.goal))
        return MadePlan(Code.GOAL_REACHED, f"found by {result.planner}", str(problem.goal), _steps(problem, result.plan))


def _steps(problem: Problem, plan: Plan) -> tuple[TaskStep, ...]:
    """Return the steps of a plan, each with the steps that are ordered before it."""
    before: dict[int, set[int]] = {}
    for ordering in plan_graph(problem, plan).orderings:
        before.setdefault(ordering.after.call, set()).add(ordering.before.call)
    return tuple(
        TaskStep(step.action, step.arguments, step.start, step.duration, StepState.WAITING, tuple(sorted(before.get(number, ()))))
        for number, step in enumerate(plan.steps)
    )
