"""Conditions on a state, the traversal of their parts, and whether they hold: true, false or unknown.

`str` of a condition is its PDDL text.

Three values (Kleene): unknown is neither true nor false. A fluent that is *absent* from a
state is false where a fact is asked for (closed world), undefined where an object is, and unknown
where a number is. A fluent that a state maps to `UNKNOWN` is unknown either way. PDDL 3.1 does not
say what an undefined object fluent is equal to: here, as for planners, to nothing, itself included.
"""

from __future__ import annotations

import json
import operator
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from math import prod
from typing import Final, Protocol, TypeAlias, assert_never

from pnm.core.logic.computed_values import (
    MISSING,
    Answers,
    Data,
    Parameter,
    Query,
    Unanswered,
    Uncomputable,
    compute,
    fluents_in,
    is_true,
    parameters_in,
    parts,
    substituted,
)
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
    Variable,
    bind,
    choices,
    expression_fluents,
    expression_variables,
    fluent_text,
    ground_expression,
    hidden,
    value_of,
    variables_in,
)


@dataclass(frozen=True, slots=True)
class Holds:
    """The fact is true."""

    fluent: Fluent

    def __str__(self) -> str:
        return fluent_text(self.fluent)


@dataclass(frozen=True, slots=True)
class Compare:
    """``= < <= > >=`` between numbers, or ``=`` between objects."""

    operation: str
    left: Expression
    right: Expression

    def __str__(self) -> str:
        return f"({self.operation} {self.left} {self.right})"


@dataclass(frozen=True, slots=True)
class Not:
    """The operand is false."""

    operand: Condition

    def __str__(self) -> str:
        return f"(not {self.operand})"


@dataclass(frozen=True, slots=True)
class All:
    """Every operand is true; true when there is none."""

    operands: tuple[Condition, ...] = ()

    def __str__(self) -> str:
        return f"(and {' '.join(map(str, self.operands))})" if self.operands else "(and)"


@dataclass(frozen=True, slots=True)
class Any:
    """At least one operand is true; false when there is none."""

    operands: tuple[Condition, ...] = ()

    def __str__(self) -> str:
        return f"(or {' '.join(map(str, self.operands))})" if self.operands else "(or)"


@dataclass(frozen=True, slots=True)
class Implies:
    """The left side is false or the right side is true."""

    left: Condition
    right: Condition

    def __str__(self) -> str:
        return f"(imply {self.left} {self.right})"


@dataclass(frozen=True, slots=True)
class ForAll:
    """The body is true for every choice of objects for the variables."""

    variables: tuple[Variable, ...]
    body: Condition

    def __str__(self) -> str:
        return f"(forall ({' '.join(map(str, self.variables))}) {self.body})"


@dataclass(frozen=True, slots=True)
class Exists:
    """The body is true for at least one choice of objects for the variables."""

    variables: tuple[Variable, ...]
    body: Condition

    def __str__(self) -> str:
        return f"(exists ({' '.join(map(str, self.variables))}) {self.body})"


@dataclass(frozen=True, slots=True)
class Computed:
    """The computed value is true: a condition of hand-written plans on variables. Unknown when it cannot be computed."""

    data: Data

    def __str__(self) -> str:
        return str(self.data)


Condition: TypeAlias = Holds | Compare | Not | All | Any | Implies | ForAll | Exists | Computed

TRUE: Final = All()
_NO_FLUENTS: Final[frozenset[Fluent]] = frozenset()


# --- looking into a condition --------------------------------------------------------------


def operands_of(condition: Condition) -> tuple[Condition, ...]:
    """Return the conditions that this one is made of; none for facts, comparisons and computed values."""
    match condition:
        case All(operands) | Any(operands):
            return operands
        case Holds() | Compare() | Computed():
            return ()
        case Not(operand) | ForAll(_, operand) | Exists(_, operand):
            return (operand,)
        case Implies(left, right):
            return (left, right)
        case _:
            assert_never(condition)


def every_part(condition: Condition) -> Iterator[Condition]:
    """Yield the condition and all conditions in it, outer ones first."""
    waiting = [condition]
    while waiting:
        part = waiting.pop()
        yield part
        waiting += operands_of(part)[::-1]


def parts_of(
    condition: Condition, state: State, env: Environment = NOTHING, truth: bool = True
) -> tuple[list[tuple[Condition, Environment, bool]], bool]:
    """Return the parts of a condition, or of its opposite, quantifiers written out, and whether every one of them is needed.

    A part is a condition, with objects for its variables, that is to be true or false. A fact has none, and a computed value neither.
    """
    match condition:
        case Not(operand):
            return [(operand, env, not truth)], True
        case All(operands) | Any(operands):
            return [(operand, env, truth) for operand in operands], isinstance(condition, All) is truth
        case Implies(left, right):
            return [(left, env, not truth), (right, env, truth)], not truth
        case ForAll(variables, body) | Exists(variables, body):
            return [(body, inner, truth) for inner in choices(variables, state, env)], isinstance(condition, ForAll) is truth
        case _:  # what is computed at run time may come out either way
            return [], True


Count: TypeAlias = Callable[[tuple[str, ...]], int]
"""Returns how many objects are of any of the types."""


def choices_in(condition: Condition, count: Count, around: int = 0) -> int:
    """Return the number of facts and comparisons when quantifiers are written out; `around`: by those outside."""
    if isinstance(condition, ForAll | Exists):
        around = max(1, around) * prod(count(variable.types) for variable in condition.variables)
    operands = operands_of(condition)
    return sum(choices_in(operand, count, around) for operand in operands) if operands else around


def fluents(condition: Condition, state: State, env: Environment = NOTHING) -> frozenset[Fluent]:
    """Return every ground fluent the truth of the condition may depend on."""
    if isinstance(condition, Holds):
        return frozenset((bind(condition.fluent, env),))
    if condition is TRUE:
        return _NO_FLUENTS
    found: set[Fluent] = set()
    _add_fluents(found, condition, state, env)
    return frozenset(found)


def _add_fluents(found: set[Fluent], condition: Condition, state: State, env: Environment) -> None:
    match condition:
        case Holds(fluent):
            found.add(bind(fluent, env))
        case All(operands) | Any(operands):
            for operand in operands:
                if isinstance(operand, Holds):  # most are, and this is asked for every call of a plan
                    found.add(bind(operand.fluent, env))
                else:
                    _add_fluents(found, operand, state, env)
        case Compare(_, left, right):
            found.update(expression_fluents(left, env))
            found.update(expression_fluents(right, env))
        case Computed(data):
            found.update(fluents_in(data, env))
        case ForAll(variables, body) | Exists(variables, body):
            for inner in choices(variables, state, env):
                _add_fluents(found, body, state, inner)
        case _:
            for operand in operands_of(condition):
                _add_fluents(found, operand, state, env)


def names(condition: Condition) -> frozenset[str]:
    """Return the predicates and functions the condition mentions."""
    return frozenset([fluent[0] for fluent in fluents_of(condition)])


def fluents_of(condition: Condition) -> Iterator[Fluent]:
    """Yield the fluents that the condition mentions, with the variables that they have there."""
    for part in every_part(condition):
        match part:
            case Holds(fluent):
                yield fluent
            case Compare(_, left, right):
                yield from expression_fluents(left)
                yield from expression_fluents(right)
            case Computed(data):
                yield from fluents_in(data)


def polarities(condition: Condition, positive: bool = True) -> Iterator[tuple[str, bool]]:
    """Yield the predicate of each fact in the condition, with whether the fact stands under an even number of negations."""
    match condition:
        case Holds(fluent):
            yield fluent[0], positive
        case Not(operand):
            yield from polarities(operand, not positive)
        case Implies(left, right):
            yield from polarities(left, not positive)
            yield from polarities(right, positive)
        case _:
            for operand in operands_of(condition):
                yield from polarities(operand, positive)


def data_in(condition: Condition) -> Iterator[Data]:
    """Yield the computed values in the condition."""
    return (part.data for part in every_part(condition) if isinstance(part, Computed))


def free_variables(condition: Condition) -> frozenset[str]:
    """Return the variables that no quantifier in the condition binds."""
    match condition:
        case Holds(fluent):
            return variables_in(fluent)
        case Compare(_, left, right):
            return expression_variables(left) | expression_variables(right)
        case Computed(data):
            return parameters_in(data)
        case ForAll(variables, body) | Exists(variables, body):
            return free_variables(body) - {variable.name for variable in variables}
        case _:
            return frozenset().union(*map(free_variables, operands_of(condition)))


def ground(condition: Condition, env: Environment) -> Condition:
    """Substitute the environment's values for the variables; quantified variables stay."""
    match condition:
        case Holds(fluent):
            return Holds(bind(fluent, env))
        case All(operands):
            return All(tuple([ground(operand, env) for operand in operands])) if operands else condition
        case Not(operand):
            return Not(ground(operand, env))
        case Compare(operation, left_value, right_value):
            return Compare(operation, ground_expression(left_value, env), ground_expression(right_value, env))
        case Any(operands):
            return Any(tuple([ground(operand, env) for operand in operands]))
        case Implies(left, right):
            return Implies(ground(left, env), ground(right, env))
        case ForAll(variables, body) | Exists(variables, body):
            return type(condition)(variables, ground(body, hidden(env, variables)))
        case Computed(data):
            return Computed(substituted(data, env))
        case _:
            assert_never(condition)


def conjuncts(condition: Condition) -> tuple[Condition, ...]:
    """Return the conditions that must all hold for this one to hold, nested conjunctions flattened."""
    if not isinstance(condition, All):
        return (condition,)
    for operand in condition.operands:
        if isinstance(operand, All):
            return tuple([part for operand in condition.operands for part in conjuncts(operand)])
    return condition.operands


def conjunction(parts: Iterable[Condition]) -> Condition:
    """Join conditions by ``and``: nested ones flattened, a single one left alone."""
    flat = tuple([one for part in parts for one in conjuncts(part)])
    return flat[0] if len(flat) == 1 else All(flat)


# --- whether a condition holds -------------------------------------------------------------


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
        case ForAll(variables, body) | Exists(variables, body):
            decisive = isinstance(condition, Exists)
            return _joined((evaluate(body, state, inner) for inner in choices(variables, state, env)), decisive)
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


# --- for people: what fails, and what the state has instead --------------------------------


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
