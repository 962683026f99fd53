"""The planners that come with the extra `planners`: what they are good for, and whether they are there.

Any other engine of unified-planning can be named as well; of those nothing is known here.

What a problem asks of a planner, besides actions that happen at once and change facts.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum
from importlib.metadata import PackageNotFoundError, version
from typing import Final

from planner_bridge.model.problem import Problem
from planner_bridge.planning.normal_form import conditions_of, doings, functions_in_use, is_whole
from pnm.core.logic.conditions import Exists, ForAll, every_part
from pnm.errors import InputError


class Feature(Enum):
    """Something that not every planner can do."""

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


def features(problem: Problem) -> frozenset[Feature]:
    """Return what a planner must be able to do to find a plan, whatever the metric."""
    return frozenset(_features(replace(problem, metric=None)))


def _features(problem: Problem) -> Iterator[Feature]:
    domain = problem.domain
    used = functions_in_use(problem)
    if problem.is_timed:
        yield Feature.TIME
    if any(not domain.functions[name].values for name in used):
        yield Feature.NUMBERS
    if not is_whole(problem, used):
        yield Feature.FRACTIONS
    if any(domain.functions[name].values for name in used):
        yield Feature.OBJECT_FLUENTS
    if any(isinstance(part, ForAll | Exists) for condition in conditions_of(problem) for part in every_part(condition)):
        yield Feature.QUANTIFIERS
    if not all(one.is_plain for one in doings(problem) if one.fluent[0] in domain.predicates or one.fluent[0] in used):
        yield Feature.CONDITIONAL_EFFECTS
    if domain.rules:
        yield Feature.DERIVED
    if domain.constraints or problem.constraints:
        yield Feature.CONSTRAINTS
    if domain.preferences or problem.preferences or any(schema.preferences for schema in domain.actions.values()):
        yield Feature.PREFERENCES
    if domain.hierarchy or problem.network:
        yield Feature.TASKS


@dataclass(frozen=True, slots=True)
class Engine:
    """An engine of unified-planning."""

    name: str
    package: str
    """Brings it, on PyPI."""
    takes: frozenset[Feature]
    program: str = ""
    """Which must be there to start it."""
    proves: bool = False
    """Whether there is no plan when it says so."""
    undeclared: frozenset[str] = frozenset()
    """What it can do although it does not tell unified-planning so, in the words of unified-planning."""

    @property
    def is_there(self) -> bool:
        """Whether its package is installed, and the program that it needs."""
        return _is_installed(self.package) and (not self.program or shutil.which(self.program) is not None)


ENGINES: Final = {
    engine.name: engine
    for engine in (
        Engine(
            "fast-downward",
            "up-fast-downward",
            frozenset({Feature.QUANTIFIERS, Feature.CONDITIONAL_EFFECTS}),
            proves=True,
            undeclared=frozenset({"UNDEFINED_INITIAL_NUMERIC"}),  # the costs of actions that are never applicable
        ),
        Engine("aries", "up-aries", frozenset({Feature.TIME, Feature.NUMBERS, Feature.OBJECT_FLUENTS, Feature.TASKS})),
        Engine(  # ends without a plan, and unified-planning takes that for a proof
            "enhsp",
            "up-enhsp",
            frozenset({Feature.QUANTIFIERS, Feature.CONDITIONAL_EFFECTS, Feature.NUMBERS, Feature.FRACTIONS}),
            program="java",
        ),
    )
}


def require(name: str) -> None:
    """See to it that the engine is there, as far as that can be told without starting it.

    Raises:
        InputError: something has to be installed first.
    """
    engine = ENGINES.get(name)
    if engine is None or engine.is_there:
        return
    if not _is_installed(engine.package):
        raise InputError(f"the planner {name} is not installed: pip install {engine.package}, or 'petri-net-machines[planners]'")
    raise InputError(f"the planner {name} needs {engine.program}, which is not installed")


def _is_installed(package: str) -> bool:
    try:
        version(package)
    except PackageNotFoundError:
        return False
    return True
