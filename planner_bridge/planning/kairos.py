"""Kairos, the default planner, and its plan validator, in this process."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from dataclasses import replace
from math import inf
from typing import Final

import kairos

from planner_bridge.model.plan import Plan, PlanningResult, PlanningStatus, PlanStep, Stop
from planner_bridge.model.problem import Domain, Problem
from planner_bridge.pddl.write.writer import write_domain, write_problem
from planner_bridge.planning.plan_text import plan_text
from pnm.errors import InputError

DEFAULT_PLANNER: Final = "kairos"


_POLL: Final = 0.05


_PATIENCE: Final = 1.0
"""Seconds that must pass without a better plan until the last one is good enough, where preferences are weighed."""


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
    kairos.Status.CANCELLED: PlanningStatus.CANCELLED,
    kairos.Status.INTERNAL_ERROR: PlanningStatus.CRASHED,
}


def validate(problem: Problem, plan: Plan, loaded: kairos.Problem | None = None) -> str:
    """Return why the plan does not solve the problem by Kairos' validator; empty when it does."""
    try:
        report = kairos.validate(loaded or _load(_without_tasks(problem)), kairos.parse_plan(plan_text(plan)))
    except kairos.PddlError as error:
        return str(error)
    return "" if report.valid else _told(report.diagnostics) or str(report.status)


def _load(problem: Problem) -> kairos.Problem:
    """Hand the problem to Kairos as PDDL text.

    Raises:
        kairos.PddlError: Kairos does not accept what our reader accepted.
    """
    domain = kairos.parse_domain(write_domain(problem.domain), f"{problem.domain.name}.pddl")
    return kairos.parse_problem(write_problem(problem), domain, f"{problem.name}.pddl")


def _without_tasks(problem: Problem) -> Problem:
    """Return the problem as it is for a plan that has been found: how the steps came about does not matter any more."""
    return replace(problem, domain=replace(problem.domain, hierarchy=()), network="")


def has_task_network(problem: Problem) -> bool:
    """Tell whether the problem has a task network or methods (HDDL)."""
    return bool(problem.network or problem.domain.hierarchy)


def accepted(problem: Problem) -> kairos.Problem:
    """Hand the problem to Kairos.

    Raises:
        InputError: it refuses the problem.
    """
    try:
        return _load(problem)
    except kairos.PddlError as error:
        raise InputError(f"the planner refuses the problem: {error}") from error


def kairos_plan(loaded: kairos.Problem, problem: Problem, timeout: float, cancel: Stop) -> PlanningResult:
    """Search for a plan until the timeout, or until nobody wants it any more."""
    weighs = _has_preferences(problem)  # else the first plan will do: robots wait
    search = kairos.Planner().start(  # type: ignore[no-untyped-call]
        loaded, timeout=timeout, anytime=weighs, threads=_THREADS
    )
    enough = inf
    while search.running() and not cancel.is_set() and time.monotonic() < enough:
        if search.next_plan(_POLL):
            enough = time.monotonic() + (_PATIENCE if weighs else 0.0)
    search.stop()
    best = search.best()
    if best is not None:  # its end, which takes Kairos some milliseconds more, would not tell us anything
        return PlanningResult(PlanningStatus.SOLVED, _plan(best, problem), planner=DEFAULT_PLANNER)
    result = search.wait()
    status = _STATUS[result.status]
    if status is PlanningStatus.UNSOLVABLE and any(function.values for function in problem.domain.functions.values()):
        status = PlanningStatus.NO_PLAN  # Kairos 1.0.6 calls some such problems unsolvable although its validator accepts a plan
    message = "" if status is PlanningStatus.CANCELLED else _told(result.diagnostics)
    return PlanningResult(PlanningStatus.NO_PLAN if status is PlanningStatus.SOLVED else status, message=message, planner=DEFAULT_PLANNER)


def _has_preferences(problem: Problem) -> bool:
    return bool(problem.preferences or problem.domain.preferences or any(one.preferences for one in problem.domain.actions.values()))


def _told(diagnostics: Iterable[kairos.Diagnostic]) -> str:
    """Return what the diagnostics say, on one line."""
    lines = (" ".join(line.split()).removeprefix("no plan: ") for one in diagnostics for line in one.message.splitlines())
    return "; ".join(filter(None, lines))


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
