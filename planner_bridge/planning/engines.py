"""Which planner suits which problem: the kind of a problem, and the engines that come with the extra `planners`.

Any other engine of unified-planning can be named as well; of those nothing is known here.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from enum import Enum
from importlib.metadata import PackageNotFoundError, version
from typing import Final

from planner_bridge.model.problem import Problem
from planner_bridge.planning.normal_form import action_assignments, conditions_of, functions_in_use, is_whole
from pnm.core.logic.conditions import Exists, ForAll, every_part
from pnm.errors import InputError


class Feature(Enum):
    """Something a problem may use that not every planner can handle, besides instantaneous actions that change facts."""

    TIME = "actions that last, or facts that change by themselves"
    NUMBERS = "numeric functions"
    FRACTIONS = "numbers that are not whole"
    OBJECT_FLUENTS = "functions whose values are objects"
    QUANTIFIERS = "quantifiers"
    CONDITIONAL_EFFECTS = "conditional effects"
    DERIVED = "derived predicates"
    CONSTRAINTS = "trajectory constraints"
    PREFERENCES = "preferences"
    TASKS = "task networks"


def problem_kind(problem: Problem) -> frozenset[Feature]:
    """Return what a planner must handle to find a plan, whatever the metric (unified-planning's `ProblemKind`)."""
    problem = replace(problem, metric=None)
    domain = problem.domain
    used = functions_in_use(problem)
    parts = (part for condition in conditions_of(problem) for part in every_part(condition))
    relevant = (change for change in action_assignments(domain) if change.fluent[0] in domain.predicates or change.fluent[0] in used)
    present = {
        Feature.TIME: problem.is_timed,
        Feature.NUMBERS: any(not domain.functions[name].values for name in used),
        Feature.FRACTIONS: not is_whole(problem, used),
        Feature.OBJECT_FLUENTS: any(domain.functions[name].values for name in used),
        Feature.QUANTIFIERS: any(isinstance(part, ForAll | Exists) for part in parts),
        Feature.CONDITIONAL_EFFECTS: not all(change.is_plain for change in relevant),
        Feature.DERIVED: bool(domain.rules),
        Feature.CONSTRAINTS: bool(domain.constraints or problem.constraints),
        Feature.PREFERENCES: problem.has_preferences,
        Feature.TASKS: problem.has_tasks,
    }
    return frozenset(feature for feature, is_present in present.items() if is_present)


@dataclass(frozen=True, slots=True)
class PlanningEngine:
    """An engine of unified-planning, and the features it handles."""

    name: str
    package: str
    """The PyPI package that brings it."""
    supports: frozenset[Feature]
    program: str = ""
    """A program that must be installed to start it."""
    proves_unsolvability: bool = False
    """Whether its answer that there is no plan is a proof."""
    undeclared: frozenset[str] = frozenset()
    """Features, in unified-planning's words, that it handles although it does not declare them there."""

    @property
    def is_installed(self) -> bool:
        """Whether its package is installed, and the program that it needs."""
        return _has_package(self.package) and (not self.program or shutil.which(self.program) is not None)


ENGINES: Final = {
    engine.name: engine
    for engine in (
        PlanningEngine(
            "fast-downward",
            "up-fast-downward",
            frozenset({Feature.QUANTIFIERS, Feature.CONDITIONAL_EFFECTS}),
            proves_unsolvability=True,
            undeclared=frozenset({"UNDEFINED_INITIAL_NUMERIC"}),  # the costs of actions that are never applicable
        ),
        PlanningEngine("aries", "up-aries", frozenset({Feature.TIME, Feature.NUMBERS, Feature.OBJECT_FLUENTS, Feature.TASKS})),
        PlanningEngine(  # ends without a plan, and unified-planning takes that for a proof
            "enhsp",
            "up-enhsp",
            frozenset({Feature.QUANTIFIERS, Feature.CONDITIONAL_EFFECTS, Feature.NUMBERS, Feature.FRACTIONS}),
            program="java",
        ),
    )
}


def require_installed(name: str) -> None:
    """Refuse one of `ENGINES` that is not installed, as far as that shows without starting it."""
    engine = ENGINES.get(name)
    if engine is None or engine.is_installed:
        return
    if not _has_package(engine.package):
        raise InputError(f"the planner {name} is not installed: pip install {engine.package}, or 'petri-net-machines[planners]'")
    raise InputError(f"the planner {name} needs {engine.program}, which is not installed")


def _has_package(package: str) -> bool:
    try:
        version(package)
    except PackageNotFoundError:
        return False
    return True
