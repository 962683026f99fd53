"""Problem → Plan: Kairos in this process by default, any other engine in a child process, or several at once.

Every plan is validated before it is returned. A limit in seconds bounds every search, and a
search can be cancelled from another thread.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable, Mapping
from dataclasses import replace
from math import inf
from typing import TYPE_CHECKING, Final

import kairos

from planner_bridge.model import Domain, Problem
from planner_bridge.pddl.writer import write_domain, write_problem
from planner_bridge.plan import Plan, PlanningResult, PlanningStatus, PlanStep, Stop
from planner_bridge.validation import why_invalid
from pnm.errors import InputError

if TYPE_CHECKING:
    from concurrent.futures import Executor

DEFAULT_PLANNER: Final = "kairos"
RACE: Final = "race"
_RACE_OF: Final = f"{RACE}:"
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


def solve(
    problem: Problem,
    *,
    planner: str = DEFAULT_PLANNER,
    timeout: float = 30.0,
    cancel: Stop | None = None,
    executor: Executor | None = None,
) -> PlanningResult:
    """Search for a plan, at most `timeout` seconds, and validate it.

    Args:
        problem: what is to be solved.
        planner: kairos, an engine of unified-planning, ``race`` for several at once, or ``race:kairos,aries`` for these.
        timeout: seconds that the search may take, besides the time to load a planner.
        cancel: set from elsewhere when nobody wants the plan any more.
        executor: runs the planners of a race; a process pool by default.

    Raises:
        InputError: the planner refuses the problem, is not known, or is not installed.
    """
    stop = cancel or threading.Event()
    if planner == RACE or planner.startswith(_RACE_OF):
        from planner_bridge.race import race  # here, because most searches are no races

        named = None if planner == RACE else _named(planner)
        return race(problem, planners=named, timeout=timeout, executor=executor, cancel=stop)
    if planner == DEFAULT_PLANNER and not _has_tasks(problem):
        loaded = _accepted(problem)
        return validated(problem, _found(loaded, problem, timeout, stop), loaded)
    return validated(problem, search(problem, planner, timeout, stop))


def check_planner(planner: str, cancel: Stop | None = None) -> None:
    """See to it that there is such a planner, before anybody needs it; one that we do not know ourselves takes some seconds.

    Args:
        planner: as for `solve`.
        cancel: set from elsewhere when nobody wants to know any more.

    Raises:
        InputError: it is not known, or something has to be installed first.
    """
    if planner in (DEFAULT_PLANNER, RACE):
        return
    if planner.startswith(_RACE_OF):
        from planner_bridge.race import check_entrants  # here and below, because Kairos needs neither

        check_entrants(_named(planner))
    else:
        from planner_bridge.child import check_engine

        check_engine(planner, cancel or threading.Event())


def _named(race: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in race.removeprefix(_RACE_OF).split(","))


def search(problem: Problem, planner: str, timeout: float, cancel: Stop) -> PlanningResult:
    """Search with one planner; its plan is still to be validated.

    Raises:
        InputError: as `solve`.
    """
    if planner == DEFAULT_PLANNER and _has_tasks(problem):
        message = "task networks, which aries plans for (--planner aries)"
        return PlanningResult(PlanningStatus.UNSUPPORTED, message=message, planner=planner)
    if planner == DEFAULT_PLANNER:
        return _found(_accepted(problem), problem, timeout, cancel)
    from planner_bridge.child import solve_in_child  # here, because Kairos needs no child

    return replace(solve_in_child(problem, planner, timeout, cancel), planner=planner)


# --- validation ----------------------------------------------------------------------------


def validated(problem: Problem, found: PlanningResult, loaded: kairos.Problem | None = None) -> PlanningResult:
    """Return what was found if there is no plan or all validators accept it; every plan goes through here.

    Args:
        problem: what was to be solved.
        found: what a planner says.
        loaded: the problem, if Kairos has it already.
    """
    if found.plan is None:
        return found
    verdicts = {"Kairos' validator": validate(problem, found.plan, loaded), "our own": why_invalid(problem, found.plan)}
    if not any(verdicts.values()):
        return found
    status = PlanningStatus.INVALID_PLAN if all(verdicts.values()) else PlanningStatus.DISAGREEMENT
    said = "; ".join(f"{validator} says: {why or 'valid'}" for validator, why in verdicts.items())
    return PlanningResult(status, message=f"{said}; the plan: {' '.join(plan_text(found.plan).split())}", planner=found.planner)


def validate(problem: Problem, plan: Plan, loaded: kairos.Problem | None = None) -> str:
    """Return why the plan does not solve the problem by Kairos' validator; empty when it does."""
    try:
        report = kairos.validate(loaded or _load(_without_tasks(problem)), kairos.parse_plan(plan_text(plan)))
    except kairos.PddlError as error:
        return str(error)
    return "" if report.valid else _told(report.diagnostics) or str(report.status)


def plan_text(plan: Plan) -> str:
    """Write the plan in the format of the planning competitions."""
    if not plan.temporal:
        return "".join(f"({' '.join((step.action, *step.arguments))})\n" for step in plan.steps)
    return "".join(f"{step.start:.6f}: ({' '.join((step.action, *step.arguments))}) [{step.duration:.6f}]\n" for step in plan.steps)


# --- Kairos --------------------------------------------------------------------------------


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


def _has_tasks(problem: Problem) -> bool:
    return bool(problem.network or problem.domain.hierarchy)


def _accepted(problem: Problem) -> kairos.Problem:
    """Hand the problem to Kairos.

    Raises:
        InputError: it refuses the problem.
    """
    try:
        return _load(problem)
    except kairos.PddlError as error:
        raise InputError(f"the planner refuses the problem: {error}") from error


def _found(loaded: kairos.Problem, problem: Problem, timeout: float, cancel: Stop) -> PlanningResult:
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
