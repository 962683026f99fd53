"""Why a problem has the plan that it has, or none: the first question, with one line for each call."""

from __future__ import annotations

from planner_bridge.explanations.answer import Answer, Known, Solves, listed
from planner_bridge.explanations.needed_call import Course
from planner_bridge.model.plan import Plan
from planner_bridge.model.problem import Problem
from pnm.errors import counted


def why_plan(problem: Problem, plan: Plan) -> Answer:
    """Return what each call of a plan is for."""
    if not plan.steps:
        return Answer(
            "there is nothing to do: the goal is empty, holds already, or comes by itself", Known.PLAN, (), (Solves(problem, plan),)
        )
    course = Course.of(problem, plan)
    best = ", and it is proved that none is better" if plan.is_best else ""
    lines = tuple(_line(course, number) for number in range(len(plan.steps)))
    return Answer(f"there is a plan with {counted(len(plan.steps), 'call')}{best}", Known.PLAN, lines, (Solves(problem, plan),))


def _line(course: Course, call: int) -> Answer:
    needs = course.needs(call)
    if not needs:
        return Answer(f"{course.name(call)}: no later condition needs it", Known.SIMULATION)
    for_calls: dict[str, list[str]] = {}
    parts = []
    for need in needs:
        conditions = listed([str(condition) for condition in need.conditions])
        if need.by is None:
            parts.append(f"for the goal {conditions}")
        else:
            for_calls.setdefault(conditions, []).append(f"#{need.by}")
    for conditions, calls in for_calls.items():
        parts.append(f"for {listed(calls)}, which need{'s' if len(calls) == 1 else ''} {conditions}")
    return Answer(f"{course.name(call)}: {'; '.join(parts)}", Known.SIMULATION)
