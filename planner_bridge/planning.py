"""Problem → Plan: Kairos in this process by default, any other engine in a child process.

Every plan is validated before it is returned, by Kairos' validator. A limit in seconds bounds
every search, and a search can be cancelled from another thread.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Mapping
from typing import Final

import kairos

from planner_bridge.model import Domain, Problem
from planner_bridge.pddl.writer import write_domain, write_problem
from planner_bridge.plan import Plan, PlanningResult, PlanningStatus, PlanStep
from pnm.errors import InputError

DEFAULT_PLANNER: Final = "kairos"
_POLL: Final = 0.05
_THREADS: Final = 1
"""Phases of the search that run at once; one, so that the same problem always gets the same plan."""

_STATUS: Final[Mapping[kairos.Status, PlanningStatus]] = {
    kairos.Status.SOLVED: PlanningStatus.SOLVED,
    kairos.Status.UNSOLVABLE: PlanningStatus.UNSOLVABLE,
    kairos.Status.NO_PLAN_FOUND: PlanningStatus.NO_PLAN,
    kairos.Status.TIMEOUT: PlanningStatus.TIMED_OUT,
    kairos.Status.OUT_OF_MEMORY: PlanningStatus.OUT_OF_MEMORY,
    kairos.Status.GROUNDING_TOO_LARGE: PlanningStatus.OUT_OF_MEMORY,
    kairos.Status.UNSUPPORTED: PlanningStatus.UNSUPPORTED,
    kairos.Status.INVALID_INPUT: PlanningStatus.INVALID,
    kairos.Status.CANCELLED: PlanningStatus.TIMED_OUT,
    kairos.Status.INTERNAL_ERROR: PlanningStatus.CRASHED,
}


def solve(
    problem: Problem, *, planner: str = DEFAULT_PLANNER, timeout: float = 30.0, cancel: threading.Event | None = None
) -> PlanningResult:
    """Search for a plan with the named planner, at most `timeout` seconds, and validate it."""
    stop = cancel or threading.Event()
    if planner == DEFAULT_PLANNER:
        return _solve_with_kairos(problem, timeout, stop)
    from planner_bridge.child import solve_in_child  # here, because Kairos needs no child

    result = solve_in_child(problem, planner, timeout, stop)
    if result.plan is None:
        return result
    refusal = validate(problem, result.plan)
    return PlanningResult(PlanningStatus.CRASHED, message=f"{planner} returned a plan that is not valid: {refusal}") if refusal else result


def validate(problem: Problem, plan: Plan) -> str:
    """Return why the plan does not solve the problem by Kairos' validator; empty when it does."""
    try:
        report = kairos.validate(_load(problem), kairos.parse_plan(plan_text(plan)))
    except kairos.PddlError as error:
        return str(error)
    return "" if report.valid else _told(report.diagnostics) or str(report.status)


def plan_text(plan: Plan) -> str:
    """Write the plan in the format of the planning competitions."""
    if not plan.temporal:
        return "".join(f"({' '.join((step.action, *step.arguments))})\n" for step in plan.steps)
    return "".join(f"{step.start:.6f}: ({' '.join((step.action, *step.arguments))}) [{step.duration:.6f}]\n" for step in plan.steps)


def _load(problem: Problem) -> kairos.Problem:
    """Hand the problem to Kairos as PDDL text.

    Raises:
        InputError: Kairos does not accept what our reader accepted.
    """
    try:
        domain = kairos.parse_domain(write_domain(problem.domain), f"{problem.domain.name}.pddl")
        return kairos.parse_problem(write_problem(problem), domain, f"{problem.name}.pddl")
    except kairos.PddlError as error:
        raise InputError(f"the planner refuses the problem: {error}") from error


def _solve_with_kairos(problem: Problem, timeout: float, cancel: threading.Event) -> PlanningResult:
    loaded = _load(problem)
    search = kairos.Planner().start(  # type: ignore[no-untyped-call]
        loaded, timeout=timeout, anytime=False, threads=_THREADS
    )
    while search.running() and not cancel.is_set():
        search.next_plan(_POLL)
    search.stop()
    result = search.wait()
    status, message = _STATUS[result.status], _told(result.diagnostics)
    if result.plan is None:
        return PlanningResult(PlanningStatus.NO_PLAN if status is PlanningStatus.SOLVED else status, message=message)
    report = kairos.validate(loaded, result.plan)
    if not report.valid:
        return PlanningResult(PlanningStatus.CRASHED, message=f"the plan is not valid: {_told(report.diagnostics)}")
    return PlanningResult(PlanningStatus.SOLVED, _plan(result.plan, problem))


def _told(diagnostics: Iterable[kairos.Diagnostic]) -> str:
    """Return what the diagnostics say, on one line."""
    return "; ".join(" ".join(one.message.split()) for one in diagnostics)


def _plan(found: kairos.Plan, problem: Problem) -> Plan:
    objects = {name.casefold(): name for name in problem.objects}
    return Plan(
        tuple(
            PlanStep(
                action=_action(problem.domain, step.name),
                arguments=tuple(objects[argument.casefold()] for argument in step.args),
                start=step.time,
                duration=step.duration,
            )
            for step in found.steps
        ),
        temporal=problem.is_timed,
        cost=found.cost,
    )


def _action(domain: Domain, name: str) -> str:
    return name if name in domain.actions else next(one for one in domain.actions if one.casefold() == name.casefold())
