"""Whether a condition holds in a state: true, false or unknown.

Three values (Kleene): unknown is neither true nor false. A fluent that is *absent* from a
state is false where a fact is asked for (closed world), undefined where an object is, and unknown
where a number is. A fluent that a state maps to `UNKNOWN` is unknown either way. PDDL 3.1 does not
say what an undefined object fluent is equal to: here, as for planners, to nothing, itself included.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator
from typing import Final, assert_never

from pnm.core.logic.computed_values import Answers, compute, is_true, substituted
from pnm.core.logic.conditions import All, Any, Compare, Computed, Condition, Exists, ForAll, Holds, Implies, Not, conjuncts
from pnm.core.logic.expressions import (
    DURATION,
    NOTHING,
    UNDEFINED,
    UNKNOWN,
    Environment,
    Expression,
    State,
    Truth,
    Unknown,
    Value,
    ValueOf,
    bind,
    choices,
    value_of,
)
from pnm.core.logic.operators import Uncomputable

_COMPARE: Final[dict[str, Callable[[float, float], bool]]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}


TOLERANCE: Final = 1e-6
"""Numbers closer than this are equal: plans are computed and durations measured in floats."""


def evaluate(condition: Condition, state: State, env: Environment = NOTHING) -> Truth:
    """Return the truth of the condition in the state; raises `Unanswered` if it depends on a question that has to be asked first."""
    match condition:
        case Holds(fluent):
            value = state.value(bind(fluent, env))
            return value if value is UNKNOWN else bool(value)
        case All(operands):
            return _all(evaluate(operand, state, env) for operand in operands)
        case Not(operand):
            return negate(evaluate(operand, state, env))
        case Compare(operation, left, right):
            return _compare(operation, _recorded(left, state, env), _recorded(right, state, env))
        case Any(operands):
            return negate(_all(negate(evaluate(operand, state, env)) for operand in operands))
        case Implies(left, right):
            return evaluate(Any((Not(left), right)), state, env)
        case ForAll(variables, body):
            return _all(evaluate(body, state, inner) for inner in choices(variables, state, env))
        case Exists(variables, body):
            return negate(evaluate(ForAll(variables, Not(body)), state, env))
        case Computed(data):
            if not isinstance(state, Answers):
                return UNKNOWN
            try:
                return is_true(compute(substituted(data, env), state))
            except Uncomputable:
                return UNKNOWN
        case _:
            assert_never(condition)


def unmet(condition: Condition, state: State) -> tuple[Condition, ...]:
    """Return the conjuncts that are not true in the state; raises `Unanswered` if one depends on a question that has to be asked first."""
    return tuple(part for part in conjuncts(condition) if evaluate(part, state) is not True)


def negate(truth: Truth) -> Truth:
    """Return the opposite; unknown stays unknown."""
    return truth if truth is UNKNOWN else not truth


def _all(truths: Iterator[Truth]) -> Truth:
    result: Truth = True
    for truth in truths:
        if truth is False:
            return False
        if truth is UNKNOWN:
            result = UNKNOWN
    return result


def _recorded(expression: Expression, state: State, env: Environment) -> Value | Unknown | None:
    """Return the value of the expression; None for a fluent that is absent."""
    if isinstance(expression, ValueOf) and expression.fluent != DURATION:
        return state.value(bind(expression.fluent, env))
    return value_of(expression, state, env)


def _compare(operation: str, left: Value | Unknown | None, right: Value | Unknown | None) -> Truth:
    if left is UNKNOWN or right is UNKNOWN:
        return UNKNOWN
    if isinstance(left, str) or isinstance(right, str):
        return left == right != UNDEFINED if operation == "=" else UNKNOWN
    if left is None or right is None:
        return UNKNOWN
    equal = abs(float(left) - float(right)) <= TOLERANCE
    if operation == "=":
        return equal
    return equal if equal and "=" in operation else not equal and _COMPARE[operation](left, right)
