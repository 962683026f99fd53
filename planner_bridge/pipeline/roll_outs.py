"""Roll-outs: runs of the machine itself, with its recovery and its new plans, on simulated robots under virtual time."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from planner_bridge.model.plan import Plan, PlanningResult, PlanningStatus
from planner_bridge.model.problem import Problem
from planner_bridge.model.world import simulated_backend
from planner_bridge.pipeline.carry_out import carry_out
from planner_bridge.pipeline.goal_handle import GoalHandle
from planner_bridge.pipeline.odds import Odds
from planner_bridge.planning.solve import solve
from planner_bridge.tasks.result import Stopwatch, TaskResult
from planner_bridge.tasks.settings import Settings, TaskObserver
from pnm.actions.faults import Faults
from pnm.clock import run_async
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.expressions import Fluent, is_number
from pnm.tasks import Code

SECONDS: Final = 2.0
"""Seconds of processor time for all roll-outs together."""
MOST: Final = 2000
"""Roll-outs, at most: the interval is 2 % wide then at worst."""


def roll_outs(
    run: Callable[[int], tuple[TaskResult, KnowledgeBase | None] | None], before: KnowledgeBase, seconds: float, most: int
) -> Odds | None:
    """Return the odds by as many runs as there is time for; None if there is none for a single one.

    Args:
        run: carries a run out, given its seed, and returns its result and the world after it; None if its time was not enough.
        before: the world before each.
    """
    until, reached, number = time.process_time() + seconds, list[float](), 0
    numbers: dict[Fluent, list[float]] = {}
    while number < most and time.process_time() < until and (ended := run(number)) is not None:
        number += 1
        result, after = ended
        if result.code is Code.CANCELLED:
            raise KeyboardInterrupt
        if result.goal_reached:
            reached.append(max((call.ended - result.began for call in result.calls if call.ended is not None), default=0.0))
            for fluent, value in after.facts().items() if after else ():
                if is_number(value) and (fluent in numbers or value != before.value(fluent)):
                    numbers.setdefault(fluent, []).append(float(value))
    return Odds.estimated(len(reached), number, reached, numbers) if number else None


def roll_outs_of_goal(
    problem: Problem, plan: Plan, settings: Settings, faults: Faults, seconds: float = SECONDS, most: int = MOST
) -> Odds | None:
    """Return the odds of a goal by roll-outs that begin with this plan.

    What follows a failure is planned with the first plan that is found, and once for all roll-outs in which the same is known.
    """
    until, found = time.process_time() + seconds, dict[frozenset[Any], list[tuple[Problem, PlanningResult]]]()
    before = simulated_backend(problem, settings.bindings, faults).robots.world.truth

    def run(number: int) -> tuple[TaskResult, KnowledgeBase] | None:
        given, is_late = [PlanningResult(PlanningStatus.SOLVED, plan, planner=settings.planner)], False

        def planned(now: Problem, *, timeout: float, **options: Any) -> PlanningResult:
            nonlocal is_late
            if given:
                return given.pop()
            alike = found.setdefault(frozenset(now.init.items()), [])
            for other, result in alike:
                if other == now and other.unknown == now.unknown:
                    return result
            left = until - time.process_time()
            result = solve(now, timeout=max(0.01, min(timeout, left)), **options)
            is_late = left < timeout and result.status is PlanningStatus.TIMED_OUT
            alike.append((now, result))
            return result

        backend = simulated_backend(problem, settings.bindings, replace(faults, seed=number))
        chosen = replace(settings, improve=0.0, solver=planned)
        result = run_async(GoalHandle(backend, problem, chosen, TaskObserver(), Stopwatch()).run(), virtual=True)
        return None if is_late else (result, backend.robots.world.truth)

    return roll_outs(run, before, seconds, most)


def roll_outs_of_plan(
    file: Path,
    name: str | None,
    parameters: Mapping[str, object],
    settings: Settings,
    faults: Faults,
    seconds: float = SECONDS,
    most: int = MOST,
) -> Odds | None:
    """Return the odds of a hand-written plan by roll-outs; people who are asked something do not answer."""

    def run(number: int) -> tuple[TaskResult, None]:
        return carry_out(file, name, parameters, faults=replace(faults, seed=number), settings=settings), None

    return roll_outs(run, KnowledgeBase(), seconds, most)
