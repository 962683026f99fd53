"""The request to an engine of unified-planning, and its answer as plain data."""

from __future__ import annotations

import re
import time
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final, TypeAlias

import unified_planning.shortcuts as up
from unified_planning.engines import PDDLPlanner
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.engines.factory import DEFAULT_ENGINES
from unified_planning.engines.results import PlanGenerationResult
from unified_planning.exceptions import UPException, UPUnsupportedProblemTypeError
from unified_planning.io import PDDLReader
from unified_planning.model import ProblemKind

from planner_bridge.model.plan import PlanningStatus
from planner_bridge.model.problem import Problem
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.planning.engines import ENGINES, Feature, problem_kind
from planner_bridge.planning.unified_planning.problems import Translation
from pnm.errors import InputError, suggestion

_STATUS: Final = {
    Status.UNSOLVABLE_PROVEN: PlanningStatus.UNSOLVABLE,
    Status.TIMEOUT: PlanningStatus.TIMED_OUT,
    Status.MEMOUT: PlanningStatus.OUT_OF_MEMORY,
    Status.INTERNAL_ERROR: PlanningStatus.CRASHED,
    Status.UNSUPPORTED_PROBLEM: PlanningStatus.UNSUPPORTED,
}
_OUT_OF_MEMORY: Final = re.compile(r"OutOfMemoryError|bad_alloc|MemoryError|insufficient memory|exit code: -9")
_UNSUPPORTED: Final = re.compile(r"^Unsupported \w|not supported")
_LENGTH: Final = 400
"""Characters of an engine's message that are passed on, half of them from the beginning and half from the end."""


class _StatedProblem(up.Problem):  # type: ignore[misc]  # unified-planning ships no types
    """A problem for planners that are given PDDL: without a value for every combination of objects."""

    @property
    def initial_values(self) -> dict[Any, Any]:
        """Only the values stated: other fluents are false, or have no value."""
        return self.explicit_initial_values  # type: ignore[no-any-return]

    @cached_property
    def kind(self) -> ProblemKind:
        """Cached, because it is read often and slow to compute."""
        return super().kind


Answer: TypeAlias = dict[str, object]
"""The status by name, a message, and the steps of the plan; or `unknown`, if there is no such engine."""


def ask(name: str, seconds: float) -> Answer:
    """Ask an engine for a plan for the problem in this folder. An engine that cannot cope with the metric is asked for any plan."""
    if unknown := look_up(name):
        return unknown
    deadline = time.monotonic() + seconds
    problem = parse_problem(Path("problem.pddl").read_text(), parse_domain(Path("domain.pddl").read_text()))
    answer = _answer(name, problem, deadline)
    if problem.metric is None or not _is_refused(answer):
        return answer
    again = _answer(name, replace(problem, metric=None), deadline)
    return answer if _is_refused(again) else {**again, "message": f"{again['message']} (without the metric: {answer['message']})".strip()}


def look_up(name: str) -> Answer:
    """Return the error if there is no such engine; nothing if there is."""
    environment = up.get_environment()
    environment.credits_stream = None
    installed = sorted(engine for engine in environment.factory.engines if environment.factory.engine(engine).is_oneshot_planner())
    if name in installed:
        return {}
    if name in DEFAULT_ENGINES:
        package = DEFAULT_ENGINES[name][0].partition(".")[0].replace("_", "-")
        return {"unknown": f"the planner {name} is not installed: pip install {package}"}
    planners = ("kairos", *(engine for engine in installed if "[" not in engine))
    hint = suggestion(name, (*planners, "race", *ENGINES))
    return {"unknown": f"there is no planner {name!r}; installed: {', '.join(planners)}{f'; {hint}' if hint else ''}"}


def _is_refused(answer: Answer) -> bool:
    return answer["status"] in (PlanningStatus.UNSUPPORTED.name, PlanningStatus.CRASHED.name)


def _answer(name: str, problem: Problem, deadline: float) -> Answer:
    try:
        there, actions, objects = _problem(name, problem)
        with up.OneshotPlanner(name=name) as planner:
            planner.skip_checks = True  # what it declares has been looked at already
            result = planner.solve(there, timeout=max(0.01, deadline - time.monotonic()))
    except (InputError, UPUnsupportedProblemTypeError) as error:
        return _no_plan(PlanningStatus.UNSUPPORTED, str(error))
    except UPException as error:
        return _no_plan(PlanningStatus.CRASHED, str(error))
    except MemoryError as error:
        return _no_plan(PlanningStatus.OUT_OF_MEMORY, str(error))
    if result.plan is None:
        return _reason(name, result)
    plan: Any = getattr(result.plan, "action_plan", result.plan)  # of a hierarchical plan, what is carried out
    if hasattr(plan, "timed_actions"):
        calls = [(call, float(start), float(duration or 0)) for start, call, duration in plan.timed_actions]
    else:
        sequential = plan if hasattr(plan, "actions") else next(iter(plan.all_sequential_plans()))
        calls = [(call, float(index), 0.0) for index, call in enumerate(sequential.actions)]
    steps = [
        (actions.get(call.action.name, call.action.name), [objects.get(name, name) for name in map(str, call.actual_parameters)], *times)
        for call, *times in calls
    ]
    return {"status": PlanningStatus.SOLVED.name, "steps": steps, "message": ""}


def _reason(name: str, result: PlanGenerationResult) -> Answer:
    log = "\n".join(message.message for message in result.log_messages or ())
    status = _STATUS.get(result.status, PlanningStatus.NO_PLAN)
    if status is PlanningStatus.UNSOLVABLE and not (name in ENGINES and ENGINES[name].proves_unsolvability):
        return _no_plan(PlanningStatus.NO_PLAN, f"{name} says that there is none, which is not taken for proved")
    if status is not PlanningStatus.CRASHED:
        return _no_plan(status, "")
    if _OUT_OF_MEMORY.search(log):
        return _no_plan(PlanningStatus.OUT_OF_MEMORY, log)
    return _no_plan(PlanningStatus.UNSUPPORTED if _UNSUPPORTED.search(log) else status, log)


def _no_plan(status: PlanningStatus, log: str) -> Answer:
    words = " ".join(log.split())
    return {"status": status.name, "message": words if len(words) <= _LENGTH else f"{words[: _LENGTH // 2]} ... {words[-_LENGTH // 2 :]}"}


def _problem(name: str, problem: Problem) -> tuple[Any, dict[str, str], dict[str, str]]:
    """Return the problem for the engine, which must support it, and how its actions and objects are called here."""
    engine = up.get_environment().factory.engine(name)
    if Feature.TASKS in problem_kind(problem):
        up.get_environment().error_used_name = False
        try:  # unified-planning reads it itself: tasks and methods are text to us
            there, actions, objects = PDDLReader().parse_problem("domain.pddl", "problem.pddl"), dict[str, str](), dict[str, str]()
        except Exception as error:  # the reader raises whatever its grammar raises
            raise InputError(f"unified-planning cannot read the problem: {error}") from error
    else:
        translation = Translation(problem, (_StatedProblem if issubclass(engine, PDDLPlanner) else up.Problem)(problem.name))
        there, actions, objects = translation.translated, translation.actions, translation.objects
    undeclared = ENGINES[name].undeclared if name in ENGINES else frozenset[str]()
    asked = there.kind.features - undeclared
    if not engine.supports(ProblemKind(asked, version=there.kind.version)):
        raise InputError(", ".join(sorted(asked - engine.supported_kind().features)).lower().replace("_", " "))
    return there, actions, objects
