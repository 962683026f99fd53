"""Whether a condition holds in a state: true, false or unknown; and for people, what fails, and what the state has instead.

Three values (Kleene): unknown is neither true nor false. A fluent that is *absent* from a
state is false where a fact is asked for (closed world), undefined where an object is, and unknown
where a number is. A fluent that a state maps to `UNKNOWN` is unknown either way. PDDL 3.1 does not
say what an undefined object fluent is equal to: here, as for planners, to nothing, itself included.
"""

from __future__ import annotations

import json
import operator
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Final, Protocol, assert_never

from pnm.core.logic.computed_values import MISSING, Answers, Parameter, Query, Unanswered, compute, is_true, parts, substituted
from pnm.core.logic.conditions import All, Any, Compare, Computed, Condition, Exists, ForAll, Holds, Implies, Not, conjuncts, fluents
from pnm.core.logic.expressions import (
    DURATION,
    NOTHING,
    UNDEFINED,
    UNKNOWN,
    Environment,
    Expression,
    Fluent,
    State,
    Truth,
    Unknown,
    Value,
    ValueOf,
    bind,
    choices,
    fluent_text,
    value_of,
)
from pnm.core.logic.operators import Uncomputable

_COMPARE: Final[dict[str, Callable[[float, float], bool]]] = {"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge}
TOLERANCE: Final = 1e-6
"""Numbers closer than this are equal: plans are computed and durations measured in floats."""


def evaluate(condition: Condition, state: State, env: Environment = NOTHING) -> Truth:
    """Return the truth of the condition in the state; raises `Unanswered` if it depends on a question that has to be asked first."""
    match condition:
        case Holds(fluent):
            value = state.value(bind(fluent, env))
            return value if value is UNKNOWN else bool(value)
        case All(operands):
            return _joined((evaluate(operand, state, env) for operand in operands), False)
        case Not(operand):
            return negate(evaluate(operand, state, env))
        case Compare(operation, left, right):
            return _compare(operation, _recorded(left, state, env), _recorded(right, state, env))
        case Any(operands):
            return _joined((evaluate(operand, state, env) for operand in operands), True)
        case Implies(left, right):
            return _joined((evaluate(operand, state, env) for operand in (Not(left), right)), True)
        case ForAll(variables, body):
            return _joined((evaluate(body, state, inner) for inner in choices(variables, state, env)), False)
        case Exists(variables, body):
            return _joined((evaluate(body, state, inner) for inner in choices(variables, state, env)), True)
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


def _joined(truths: Iterator[Truth], decisive: bool) -> Truth:
    """Return the decisive truth if there is one; else unknown if any is, and else the opposite."""
    result: Truth = not decisive
    for truth in truths:
        if truth is decisive:
            return decisive
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
    if isinstance(left, bool) is not isinstance(right, bool):  # in Python true is 1
        return False if operation == "=" else UNKNOWN
    equal = abs(float(left) - float(right)) <= TOLERANCE
    if operation == "=":
        return equal
    return equal if equal and "=" in operation else not equal and _COMPARE[operation](left, right)


class Witness(State, Protocol):
    """A state that can explain its derived facts."""

    def because(self, fluent: Fluent, /) -> str:
        """Return why a derived fact has its truth, to be read after that; empty for a recorded fluent."""


def explanation(condition: Condition, state: Witness) -> tuple[str, str]:
    """Return which conjuncts are expected and not so, and what is observed instead: for people, never to decide, which is for `unmet`.

    A conjunct that depends on a question that was never asked is no reason, unless there is no other.
    """
    whole = conjuncts(condition)
    failed = []
    for part in whole:
        with suppress(Unanswered):
            if evaluate(part, state) is not True:
                failed.append(part)
    return " ".join(map(str, failed or whole)), "; ".join(observed(part, state) for part in failed or whole)


def observed(condition: Condition, state: Witness) -> str:
    """Return the value of each fluent in the condition, and why it has it if it is derived; of a computed condition, of what it reads."""
    if not isinstance(condition, Computed) or not isinstance(state, Answers):
        return ", ".join(sorted(_observed_fluent(fluent, state) for fluent in fluents(condition, state))) or "no fluent involved"
    texts: dict[str, None] = {}
    for part in parts(condition.data):
        if isinstance(part, Query | ValueOf | Parameter):
            name = fluent_text(part.fluent) if isinstance(part, ValueOf) else str(part)
            with suppress(Unanswered, Uncomputable):
                value = compute(part, state)
                texts[f"{name} is {'missing' if value is MISSING else json.dumps(value, ensure_ascii=False, default=str)}"] = None
    return ", ".join(texts) or "no variable involved"


def _observed_fluent(fluent: Fluent, state: Witness) -> str:
    value, reason = state.value(fluent), state.because(fluent)
    match value:
        case None | bool():
            text = "true" if value else "false"
        case Unknown():
            text = "unknown"
        case _:
            text = str(value)
    return f"{fluent_text(fluent)} is {text}{' ' if reason else ''}{reason}"
