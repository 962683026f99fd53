"""The door to unified-planning: its Problems in, and its engines, in a child process of their own.

The only module that imports unified-planning, and only what asks for it imports this module:
that takes 1 to 3 seconds and 150 MB. Run as a program it is the child of `planner_bridge.child`.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import unified_planning.shortcuts as up
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.engines.results import PlanGenerationResult
from unified_planning.exceptions import UPException
from unified_planning.io import PDDLReader, PDDLWriter

from planner_bridge.model import Problem
from planner_bridge.pddl import parse_domain, parse_problem
from pnm.errors import InputError

_STATUS = {
    Status.UNSOLVABLE_PROVEN: "UNSOLVABLE",
    Status.UNSOLVABLE_INCOMPLETELY: "NO_PLAN",
    Status.TIMEOUT: "TIMED_OUT",
    Status.MEMOUT: "OUT_OF_MEMORY",
    Status.INTERNAL_ERROR: "CRASHED",
    Status.UNSUPPORTED_PROBLEM: "UNSUPPORTED",
    Status.INTERMEDIATE: "NO_PLAN",
}


def from_unified_planning(problem: up.Problem) -> Problem:
    """Turn a unified-planning Problem into ours, by way of its PDDL.

    Raises:
        InputError: the problem cannot be written as PDDL, or uses what we do not read.
    """
    writer = PDDLWriter(problem)
    name = problem.name or "problem"
    try:
        domain_text, problem_text = writer.get_domain(), writer.get_problem()
    except UPException as error:
        raise InputError(f"unified-planning cannot write {name} as PDDL: {error}") from error
    domain = parse_domain(domain_text, f"{name} (domain of a unified-planning Problem)")
    return parse_problem(problem_text, domain, f"{name} (a unified-planning Problem)")


def _solve(engine: str, timeout: float) -> dict[str, object]:
    environment = up.get_environment()
    environment.credits_stream = None
    environment.error_used_name = False
    known = sorted(name for name in environment.factory.engines if environment.factory.engine(name).is_oneshot_planner())
    if engine not in known:
        return {"status": "unknown engine", "message": f"there is no planner {engine!r}; installed: {', '.join(known)}"}
    try:
        problem = PDDLReader().parse_problem("domain.pddl", "problem.pddl")
    except Exception as error:  # the reader raises whatever its grammar raises
        return {"status": "UNSUPPORTED", "message": f"unified-planning cannot read the problem: {str(error).splitlines()[0]}"}
    with up.OneshotPlanner(name=engine) as planner:
        planner.skip_checks = True
        try:
            result: PlanGenerationResult = planner.solve(problem, timeout=timeout)
        except UPException as error:
            return {"status": "UNSUPPORTED", "message": str(error).splitlines()[0]}
    if result.plan is None:
        messages = " ".join(" ".join(one.message for one in result.log_messages or ()).split())
        return {"status": _STATUS.get(result.status, "NO_PLAN"), "message": messages[-300:]}
    return {"status": "SOLVED", "steps": list(_steps(result.plan))}


def _steps(plan: Any) -> list[tuple[str, list[str], float, float]]:
    if hasattr(plan, "timed_actions"):
        return [(*_call(action), float(start), float(duration or 0)) for start, action, duration in plan.timed_actions]
    if not hasattr(plan, "actions"):
        plan = next(iter(plan.all_sequential_plans()))
    return [(*_call(action), float(index), 0.0) for index, action in enumerate(plan.actions)]


def _call(action: Any) -> tuple[str, list[str]]:
    return action.action.name, [str(parameter) for parameter in action.actual_parameters]


def _main() -> None:
    engine, timeout = sys.argv[1], float(sys.argv[2])
    Path("answer.json").write_text(json.dumps(_solve(engine, timeout)))


if __name__ == "__main__":
    _main()
