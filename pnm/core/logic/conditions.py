"""What can be said about a state, and whether it holds: true, false or unknown.

Three values (Kleene): unknown is neither true nor false. A fluent that is *absent* from a
state is false where a fact is asked for (closed world), undefined where an object is, and unknown
where a number is. A fluent that a state maps to `UNKNOWN` is unknown either way. PDDL 3.1 does not
say what an undefined object fluent is equal to: here, as for planners, to nothing, itself included.
`str` of a condition is its PDDL text.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Final, Protocol, TypeAlias, assert_never

from pnm.core.logic.computed_values import Answers, Data, Unanswered, compute, fluents_in, observed_values, parameters_in, substituted
from pnm.core.logic.computed_values import is_true as is_true
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
from pnm.core.logic.operators import Uncomputable

# --- conditions ----------------------------------------------------------------------------


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
    """The value is true: what hand-written plans say of variables. Unknown when it cannot be computed."""

    data: Data

    def __str__(self) -> str:
        return str(self.data)


Condition: TypeAlias = Holds | Compare | Not | All | Any | Implies | ForAll | Exists | Computed

TRUE: Final = All()

_COMPARE: Final[dict[str, Callable[[float, float], bool]]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}
TOLERANCE: Final = 1e-6
"""Numbers closer than this are equal: plans are computed and durations measured in floats."""


# --- evaluation ----------------------------------------------------------------------------


def evaluate(condition: Condition, state: State, env: Environment = NOTHING) -> Truth:
    """Tell whether the condition is true, false or unknown in the state."""
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
            return _test(substituted(data, env), state)
        case _:
            assert_never(condition)


def _test(data: Data, state: State) -> Truth:
    """Raise `Unanswered` if it depends on what has to be asked first."""
    if not isinstance(state, Answers):
        return UNKNOWN
    try:
        return is_true(compute(data, state))
    except Uncomputable:
        return UNKNOWN


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
    """Return the value of the expression; None if it is a fluent of which nothing is recorded."""
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


def map_operands(condition: Condition, change: Callable[[Condition], Condition]) -> Condition:
    """Return the condition with each of the conditions that it is made of changed."""
    match condition:
        case Holds() | Compare() | Computed():
            return condition
        case Not(operand):
            return Not(change(operand))
        case All(operands):
            return All(tuple(map(change, operands)))
        case Any(operands):
            return Any(tuple(map(change, operands)))
        case Implies(left, right):
            return Implies(change(left), change(right))
        case ForAll(variables, body):
            return ForAll(variables, change(body))
        case Exists(variables, body):
            return Exists(variables, change(body))
        case _:
            assert_never(condition)


def every_part(condition: Condition) -> Iterator[Condition]:
    """Yield the condition and all conditions in it, outer ones first."""
    waiting = [condition]
    while waiting:
        part = waiting.pop()
        yield part
        waiting += operands_of(part)[::-1]


def fluents(condition: Condition, state: State, env: Environment = NOTHING) -> frozenset[Fluent]:
    """Return every ground fluent the truth of the condition may depend on."""
    return frozenset(_fluents(condition, state, env))


def _fluents(condition: Condition, state: State, env: Environment) -> Iterator[Fluent]:
    match condition:
        case Holds(fluent):
            yield bind(fluent, env)
        case Compare(_, left, right):
            yield from expression_fluents(left, env)
            yield from expression_fluents(right, env)
        case Computed(data):
            yield from fluents_in(data, env)
        case ForAll(variables, body) | Exists(variables, body):
            for inner in choices(variables, state, env):
                yield from _fluents(body, state, inner)
        case _:
            for operand in operands_of(condition):
                yield from _fluents(operand, state, env)


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
            case _:
                pass
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
    """Yield what of the condition is computed from variables."""
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
            return All(tuple([ground(operand, env) for operand in operands]))
        case Compare(operation, left, right):
            return Compare(operation, ground_expression(left, env), ground_expression(right, env))
        case Computed(data):
            return Computed(substituted(data, env))
        case ForAll(variables) | Exists(variables):
            env = hidden(env, variables)
        case _:
            pass
    return map_operands(condition, lambda operand: ground(operand, env))


def conjuncts(condition: Condition) -> tuple[Condition, ...]:
    """Return the conditions that must all hold for this one to hold, nested conjunctions flattened."""
    if isinstance(condition, All):
        return tuple(part for operand in condition.operands for part in conjuncts(operand))
    return (condition,)


def conjunction(parts: Iterable[Condition]) -> Condition:
    """Join conditions by ``and``: nested ones flattened, a single one left alone."""
    flat = conjuncts(All(tuple(parts)))
    return flat[0] if len(flat) == 1 else All(flat)


def failing(condition: Condition, state: State) -> tuple[Condition, ...]:
    """Return the conjuncts that do not hold in the state: what was expected and is not so.

    Those that nobody had to ask about, because others did not hold, are not among them.
    """
    return tuple(part for part in conjuncts(condition) if _fails(part, state))


def _fails(condition: Condition, state: State) -> bool:
    try:
        return evaluate(condition, state) is not True
    except Unanswered:
        return False


class Witness(State, Protocol):
    """A state that can also say why it has the derived facts it has."""

    def because(self, fluent: Fluent, /) -> str:
        """Say why the fluent has its value, to be read after that; empty for what is recorded and nothing more."""


def observed(condition: Condition, state: Witness) -> str:
    """Say what the state has in place of the condition: the value of each fluent in it, and why if it is derived."""
    if isinstance(condition, Computed) and isinstance(state, Answers):
        return observed_values(condition.data, state)
    said = sorted(_told(fluent, state) for fluent in fluents(condition, state))
    return ", ".join(said) or "no fluent involved"


def _told(fluent: Fluent, state: Witness) -> str:
    reason = state.because(fluent)
    return f"{fluent_text(fluent)} is {_say(state.value(fluent))}{' ' if reason else ''}{reason}"


def _say(value: Value | Unknown | None) -> str:
    if value is UNKNOWN:
        return "unknown"
    return "false" if value is None else str(value).lower() if isinstance(value, bool) else f"{value}"
