"""Kairos, the default planner, in this process: its parser, its anytime search and its plan validator."""

from __future__ import annotations

import re
import time
from collections.abc import Iterable, Mapping
from dataclasses import replace
from math import inf
from typing import Final

import kairos

from planner_bridge.model.plan import CancelToken, Plan, PlanningResult, PlanningStatus, PlanStep
from planner_bridge.model.problem import Problem
from planner_bridge.pddl.write.writer import write_domain, write_problem
from planner_bridge.planning.normal_form import in_whole_numbers
from planner_bridge.planning.plan_text import plan_text
from pnm.errors import InputError

DEFAULT_PLANNER: Final = "kairos"
_POLL: Final = 0.05
"""Seconds between two looks at the cancel token."""
_ADVICE: Final = re.compile(r"\s[^.()]*\(SolveOptions::\w+\)\.|\s\(see the note before\)")
"""What Kairos says of its options, and of its own output."""
_PATIENCE: Final = 1.0
"""Seconds without a better plan after which the best one is taken, where preferences are weighed."""
_THREADS: Final = 1
"""Phases of the search that run at once; one, so that the same problem always gets the same plan."""
_STATUS: Final[Mapping[kairos.Status, PlanningStatus]] = {
    kairos.Status.SOLVED: PlanningStatus.NO_PLAN,  # without a plan, that is none
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
"""What a search that has found no plan ended with."""


def parse_for_kairos(problem: Problem) -> kairos.Problem:
    """Return the problem as Kairos reads it: without its task network, in whole numbers. It may refuse what our reader accepted."""
    try:
        return _parsed(problem)
    except kairos.PddlError as error:
        raise InputError(f"the planner refuses the problem: {error}") from error


def validate(problem: Problem, plan: Plan, parsed: kairos.Problem | None = None) -> str:
    """Return why the plan does not solve the problem by Kairos' validator; empty when it does.

    Which tasks of a hierarchical problem the steps carry out is not looked at.
    """
    try:
        report = kairos.validate(parsed or _parsed(problem), kairos.parse_plan(plan_text(plan)))
    except kairos.PddlError as error:
        return str(error)
    return "" if report.valid else _joined(report.diagnostics) or str(report.status)


def _parsed(problem: Problem) -> kairos.Problem:
    problem = in_whole_numbers(problem)
    primitive = replace(problem.domain, hierarchy=())
    domain = kairos.parse_domain(write_domain(primitive), f"{primitive.name}.pddl")
    return kairos.parse_problem(write_problem(replace(problem, domain=primitive, network="")), domain, f"{problem.name}.pddl")


def search_with_kairos(problem: Problem, parsed: kairos.Problem, timeout: float, cancel: CancelToken) -> PlanningResult:
    """Search for a plan until the timeout, or until the search is cancelled.

    The first plan is taken, for robots wait; where preferences are weighed, the best one once no better one comes for `_PATIENCE`.
    """
    weighs = problem.has_preferences
    search = kairos.Planner().start(parsed, timeout=timeout, anytime=weighs, threads=_THREADS)  # type: ignore[no-untyped-call]
    deadline = inf
    while search.running() and not cancel.is_set() and time.monotonic() < deadline:
        if search.next_plan(_POLL):  # every better plan starts the wait anew; without preferences the first plan ends it
            deadline = time.monotonic() + (_PATIENCE if weighs else 0.0)
    search.stop()
    best = search.best()
    if best is not None:  # the search ends some milliseconds later, which changes nothing
        return PlanningResult(PlanningStatus.SOLVED, _plan(best, problem), planner=DEFAULT_PLANNER)
    result = search.wait()
    status = _STATUS[result.status]
    if status is PlanningStatus.UNSOLVABLE and any(function.values for function in problem.domain.functions.values()):
        status = PlanningStatus.NO_PLAN  # Kairos 1.0.6 calls some such problems unsolvable although its validator accepts a plan
    message = "" if status is PlanningStatus.CANCELLED else _joined(result.diagnostics)
    if status is PlanningStatus.TIMED_OUT:
        message = f"{message.removesuffix('.')}; a longer limit, or another planner, may find one"
    return PlanningResult(status, message=message, planner=DEFAULT_PLANNER)


def _joined(diagnostics: Iterable[kairos.Diagnostic]) -> str:
    """Return the messages of the diagnostics on one line, without advice about options of Kairos that are not ours."""
    lines = (
        " ".join(_ADVICE.sub("", line).split()).removeprefix("no plan: ")
        for diagnostic in diagnostics
        for line in diagnostic.message.splitlines()
    )
    return "; ".join(filter(None, lines))


def _plan(plan: kairos.Plan, problem: Problem) -> Plan:
    """Return a plan of Kairos with the names of actions and objects spelled as in the problem."""
    actions = {name.casefold(): name for name in problem.domain.actions}
    objects = {name.casefold(): name for name in problem.objects}
    steps = (
        PlanStep(
            action=step.name if step.name in problem.domain.actions else actions[step.name.casefold()],
            arguments=tuple(objects[argument.casefold()] for argument in step.args),
            start=step.time,
            duration=step.duration,
        )
        for step in plan.steps
    )
    return Plan(tuple(steps), temporal=problem.is_timed, cost=plan.cost)
