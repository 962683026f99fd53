"""Does a problem calculate with whole numbers alone, or can it? Then all planners and we come to the same results.

Planners calculate with floats or fractions, compare them exactly, and separate events by a time of their own; we tolerate a
millionth. Where numbers are not whole, a plan that a planner has ruled out may be valid here. Sums of decimals are made
whole for planners, all by the same factor, which changes nothing about what is larger than what.
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from decimal import Decimal
from typing import Any, Final

from planner_bridge.model.problem import Problem
from planner_bridge.planning.normal_form import action_assignments, functions_in_use, is_whole
from pnm.core.logic.conditions import Compare, Holds
from pnm.core.logic.effects import Set, TimedChange
from pnm.core.logic.expressions import DURATION, Arithmetic, Constant, Expression, Fluent, Value, ValueOf, expression_fluents, is_number

_FACTORS: Final = (10, 100, 1000, 10_000, 100_000)
"""Decimals that are closer to each other than that count as equal, by our tolerance."""
_EXACT: Final = 2**53
"""Whole numbers up to here are floats as well."""


def calculates_with_whole_numbers(problem: Problem) -> bool:
    """Return whether every number that a comparison or a time can depend on is whole."""
    without_metric = replace(problem, metric=None)
    return is_whole(without_metric, functions_in_use(without_metric))


def in_whole_numbers(problem: Problem) -> Problem:
    """Return the problem with the same plans in which all that is compared is whole; the problem itself if that cannot be done."""
    if calculates_with_whole_numbers(problem):
        return problem
    concerned = functions_in_use(replace(problem, metric=None))
    elsewhere = [bound.bound for schema in problem.domain.actions.values() for bound in schema.duration or ()]
    elsewhere += (change.value for change in action_assignments(problem) if change.fluent[0] not in concerned)
    elsewhere += () if problem.metric is None else (problem.metric.expression,)
    watched = problem.has_preferences or problem.constraints or problem.domain.constraints
    if watched or any(fluent[0] in concerned for expression in elsewhere for fluent in expression_fluents(expression)):
        return problem
    for factor in _FACTORS:
        with suppress(_NotWhole):
            if calculates_with_whole_numbers(scaled := _Scale(factor, concerned).problem(problem)):
                return scaled
    return problem


class _NotWhole(Exception):
    """A number is not whole after all."""


@dataclass(frozen=True, slots=True)
class _Scale:
    """A factor for these functions, and for what they are compared with."""

    factor: int
    concerned: frozenset[str]

    def problem(self, problem: Problem) -> Problem:
        domain = problem.domain
        actions = {name: self.inside(schema) for name, schema in domain.actions.items()}
        timed = tuple(TimedChange(change.time, self.values(change.changes.items())) for change in problem.timed)
        domain = replace(domain, actions=actions, rules=self.inside(domain.rules))
        return replace(problem, domain=domain, init=self.values(problem.init.items()), timed=timed, goal=self.inside(problem.goal))

    def values(self, values: Iterable[tuple[Fluent, Value]]) -> dict[Fluent, Value]:
        return {fluent: self.value(value) if fluent[0] in self.concerned else value for fluent, value in values}

    def value(self, value: Value) -> Value:
        if not is_number(value):
            return value
        scaled = Decimal(repr(value)) * self.factor
        if scaled % 1 or abs(scaled) > _EXACT:
            raise _NotWhole
        return float(scaled)

    def inside(self, part: Any) -> Any:
        """Return a part of the problem with what is compared and assigned in it scaled."""
        match part:
            case Compare(operation, left, right):
                return Compare(operation, self.expression(left), self.expression(right))
            case Set(fluent, value, "scale-up" | "scale-down") if fluent[0] in self.concerned:
                return part
            case Set(fluent, value, operation) if fluent[0] in self.concerned:
                return Set(fluent, self.expression(value), operation)
            case tuple():
                return tuple(map(self.inside, part))
            case Holds() | Set() | str() | bool() | int() | float() | None:
                return part
            case _:
                return replace(part, **{inner.name: self.inside(getattr(part, inner.name)) for inner in fields(part)})

    def expression(self, expression: Expression) -> Expression:
        match expression:
            case Constant(value):
                return Constant(self.value(value))
            case Arithmetic("+" | "-" as operation, operands):
                return Arithmetic(operation, tuple(map(self.expression, operands)))
            case Arithmetic("*", (Constant() as times, operand)) | Arithmetic("*", (operand, Constant() as times)):
                return Arithmetic("*", (times, self.expression(operand)))
            case ValueOf(fluent) if fluent != DURATION:
                return expression
            case _:
                raise _NotWhole
