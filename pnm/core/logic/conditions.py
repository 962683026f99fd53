"""Conditions on a state, and the traversal of their parts; `pnm.core.logic.evaluation` decides whether they hold.

`str` of a condition is its PDDL text.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from math import prod
from typing import Final, TypeAlias, assert_never

from pnm.core.logic.computed_values import Data, fluents_in, parameters_in, substituted
from pnm.core.logic.expressions import (
    NOTHING,
    Environment,
    Expression,
    Fluent,
    State,
    Variable,
    bind,
    choices,
    expression_fluents,
    expression_variables,
    fluent_text,
    ground_expression,
    hidden,
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


Count: TypeAlias = Callable[[tuple[str, ...]], int]
"""Returns how many objects are of any of the types."""


def choices_in(condition: Condition, count: Count, around: int = 0) -> int:
    """Return how many facts and comparisons stand under quantifiers when these are written out; `around`: by those outside."""
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
    mentioned: set[str] = set()
    for part in every_part(condition):
        match part:
            case Holds(fluent):
                mentioned.add(fluent[0])
            case Compare(_, left, right):
                mentioned.update(fluent[0] for side in (left, right) for fluent in expression_fluents(side))
            case Computed(data):
                mentioned.update(fluent[0] for fluent in fluents_in(data))
    return frozenset(mentioned)


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
        case ForAll(variables, body):
            return ForAll(variables, ground(body, hidden(env, variables)))
        case Exists(variables, body):
            return Exists(variables, ground(body, hidden(env, variables)))
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
