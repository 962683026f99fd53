"""Conditions and expressions, in unified-planning."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from fractions import Fraction
from typing import Any, Final, assert_never

import unified_planning.shortcuts as up

from planner_bridge.planning.unified_planning.declarations import Declarations, Terms
from pnm.core.logic import conditions
from pnm.core.logic.conditions import All, Compare, Computed, Condition, Exists, ForAll, Holds, Implies, Not
from pnm.core.logic.expressions import DURATION, Arithmetic, Constant, Expression, Fluent, ValueOf
from pnm.errors import InputError

_COMPARISONS: Final[Mapping[str, Callable[..., Any]]] = {"=": up.Equals, "<": up.LT, "<=": up.LE, ">": up.GT, ">=": up.GE}
_ARITHMETIC: Final[Mapping[str, Callable[..., Any]]] = {"+": up.Plus, "-": up.Minus, "*": up.Times, "/": up.Div}


def condition_there(condition: Condition, declared: Declarations, terms: Terms) -> Any:
    """Return the condition in unified-planning."""
    match condition:
        case Holds(fluent):
            return fluent_there(fluent, declared, terms)
        case Compare(operation, left, right):
            return _COMPARISONS[operation](expression_there(left, declared, terms), expression_there(right, declared, terms))
        case Not(operand):
            return up.Not(condition_there(operand, declared, terms))
        case All(operands):
            return up.And(*(condition_there(operand, declared, terms) for operand in operands))
        case conditions.Any(operands):
            return up.Or(*(condition_there(operand, declared, terms) for operand in operands))
        case Implies(left_condition, right_condition):
            return up.Implies(condition_there(left_condition, declared, terms), condition_there(right_condition, declared, terms))
        case ForAll(variables, body):
            chosen, guards, inner = declared.variables(variables, terms)
            then = condition_there(body, declared, inner)
            return up.Forall(up.Implies(up.And(*guards), then) if guards else then, *chosen)
        case Exists(variables, body):
            chosen, guards, inner = declared.variables(variables, terms)
            return up.Exists(up.And(*guards, condition_there(body, declared, inner)), *chosen)
        case Computed():
            raise InputError(f"planners cannot be told {condition}: they know facts and functions, not variables")
        case _:
            assert_never(condition)


def expression_there(expression: Expression, declared: Declarations, terms: Terms) -> Any:
    """Return the expression in unified-planning; `terms` may give `DURATION` a value, which is known before the action begins."""
    match expression:
        case Constant(bool() as truth):
            return up.Bool(truth)
        case Constant(float() | int() as number):
            return number_there(number)
        case Constant(str() as name):
            return terms[name] if name.startswith("?") else up.ObjectExp(declared.objects[name])
        case ValueOf(fluent) if fluent == DURATION:
            if DURATION[0] not in terms:
                raise InputError("an effect that depends on a duration the planner chooses")
            return terms[DURATION[0]]
        case ValueOf(fluent):
            return fluent_there(fluent, declared, terms)
        case Arithmetic("-", (operand,)):
            return up.Minus(0, expression_there(operand, declared, terms))
        case Arithmetic(operation, (first, *others)):
            result = expression_there(first, declared, terms)
            for operand in others:
                result = _ARITHMETIC[operation](result, expression_there(operand, declared, terms))
            return result
        case _:
            raise AssertionError(expression)


def fluent_there(fluent: Fluent, declared: Declarations, terms: Terms) -> Any:
    """Return the fluent in unified-planning."""
    arguments = (terms[term] if term.startswith("?") else up.ObjectExp(declared.objects[term]) for term in fluent[1:])
    return up.FluentExp(declared.fluent(fluent), arguments)


def number_there(number: float) -> Any:
    """Return the number in unified-planning: exactly what was written, and whole if it is."""
    return up.Int(int(number)) if number == int(number) else up.Real(Fraction(repr(number)))
