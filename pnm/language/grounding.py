"""Putting what a step gives in the place of the parameters of its action.

Names go in by `pnm.conditions.ground`; this file adds numbers, which PDDL's parameters never are, and computed values.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeAlias, assert_never

from pnm.conditions import All, Any, Compare, Computed, Condition, Exists, ForAll, Holds, Implies, Not
from pnm.effects import Effect, Effects, ForEach, Set, When
from pnm.expressions import Arithmetic, Constant, Environment, Expression, ValueOf, Variable, bind
from pnm.queries import Data, KnowledgeOperation, Literal, Operation, Query, Update, filled

Numbers: TypeAlias = Mapping[str, float]
"""Parameters, with ``?``, that are given as numbers."""


def names_of(numbers: Numbers) -> dict[str, str]:
    """Return how the numbers are written as arguments of facts."""
    return {name: f"{number:.12g}" for name, number in numbers.items()}


def number_expression(expression: Expression, numbers: Numbers) -> Expression:
    """Put numbers in the place of parameters."""
    match expression:
        case Constant(str() as name) if name in numbers:
            return Constant(numbers[name])
        case Constant():
            return expression
        case ValueOf(fluent):
            return ValueOf(bind(fluent, names_of(numbers)))
        case Arithmetic(operation, operands):
            return Arithmetic(operation, tuple(number_expression(one, numbers) for one in operands))
        case _:
            assert_never(expression)


def number_condition(condition: Condition, numbers: Numbers) -> Condition:
    """Put numbers in the place of parameters; what is computed finds them when it is."""
    match condition:
        case Holds(fluent):
            return Holds(bind(fluent, names_of(numbers)))
        case Compare(operation, left, right):
            return Compare(operation, number_expression(left, numbers), number_expression(right, numbers))
        case Not(operand):
            return Not(number_condition(operand, numbers))
        case All(operands):
            return All(tuple(number_condition(operand, numbers) for operand in operands))
        case Any(operands):
            return Any(tuple(number_condition(operand, numbers) for operand in operands))
        case Implies(before, after):
            return Implies(number_condition(before, numbers), number_condition(after, numbers))
        case ForAll(variables, body):
            return ForAll(variables, number_condition(body, _hidden(numbers, variables)))
        case Exists(variables, body):
            return Exists(variables, number_condition(body, _hidden(numbers, variables)))
        case Computed():
            return condition
        case _:
            assert_never(condition)


def number_effects(effects: Effects, numbers: Numbers) -> Effects:
    """Put numbers in the place of parameters."""
    return tuple(_effect(effect, numbers) for effect in effects)


def _effect(effect: Effect, numbers: Numbers) -> Effect:
    match effect:
        case Set(fluent, value, operation):
            return Set(bind(fluent, names_of(numbers)), number_expression(value, numbers), operation)
        case When(condition, inner, early):
            return When(number_condition(condition, numbers), number_effects(inner, numbers), early)
        case ForEach(variables, inner):
            return ForEach(variables, number_effects(inner, _hidden(numbers, variables)))
        case _:
            assert_never(effect)


def _hidden(numbers: Numbers, variables: tuple[Variable, ...]) -> Numbers:
    names = {variable.name for variable in variables}
    return {name: number for name, number in numbers.items() if name not in names}


def filled_data(data: Data, values: Mapping[str, Data]) -> Data:
    """Put computed values in the place of parameters; in fluents only texts fit."""
    return filled(data, values, _texts(values))


def filled_operation(operation: KnowledgeOperation, values: Mapping[str, Data]) -> KnowledgeOperation:
    """Put computed values in the place of parameters."""
    if isinstance(operation, Update):
        name, value, meta = (filled_data(one, values) for one in (operation.name, operation.value, operation.meta))
        return Update(name, value, operation.layer, meta)
    found = filled_data(operation, values)
    assert isinstance(found, Query | Operation)
    return found


def _texts(values: Mapping[str, Data]) -> Environment:
    return {name: data.value for name, data in values.items() if isinstance(data, Literal) and isinstance(data.value, str)}
