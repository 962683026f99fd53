"""What a problem asks of a planner, besides actions that happen at once and change facts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from enum import Enum

from planner_bridge.model import Problem
from planner_bridge.normal_form import conditions_of, doings, functions_in_use, is_whole
from pnm.conditions import All, Any, Condition, Exists, ForAll, Implies, Not


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
    if any(map(_quantifies, conditions_of(problem))):
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


def _quantifies(condition: Condition) -> bool:
    match condition:
        case ForAll() | Exists():
            return True
        case Not(operand):
            return _quantifies(operand)
        case All(operands) | Any(operands):
            return any(map(_quantifies, operands))
        case Implies(left, right):
            return _quantifies(left) or _quantifies(right)
        case _:
            return False
