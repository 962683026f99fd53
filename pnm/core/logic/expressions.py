"""Fluents, states and the values of expressions.

A *fluent* is a tuple of names, the first of which is the predicate, function or variable:
``("at", "r1", "kitchen")``, written ``(at r1 kitchen)``. Terms that start with ``?`` are
variables; an environment maps them to values, so that one expression serves every call of an
action. `str` of an expression is its PDDL text.
"""

from __future__ import annotations

import json
import operator
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from itertools import product
from typing import Final, Protocol, TypeAlias, TypeGuard, assert_never

Fluent: TypeAlias = tuple[str, ...]


class Unknown(Enum):
    """The third truth value, and the value of a fluent that is not known."""

    UNKNOWN = "unknown"

    def __bool__(self) -> bool:
        raise TypeError("unknown is neither true nor false; compare with `is`")


UNKNOWN: Final = Unknown.UNKNOWN
Value: TypeAlias = bool | float | str
Truth: TypeAlias = bool | Unknown
Environment: TypeAlias = Mapping[str, object]
"""Values of variables: names of objects; of an action's parameters also numbers, and whatever else JSON has."""
NOTHING: Final[Environment] = {}
DURATION: Final[Fluent] = ("?duration",)
"""Stands for the duration of the action it is used in; an environment may give it a value, in seconds."""


UNDEFINED: Final = "undefined"
"""The value of an object fluent that has none (PDDL 3.1), absent ones included. It is equal to nothing, itself included."""


EXISTS: Final = "exists"
"""The name of facts such as ``(exists cup_1 cup)``: an object is there that no problem declares. No domain has such a predicate."""


class State(Protocol):
    """A state that conditions are evaluated in."""

    def value(self, fluent: Fluent, /) -> Value | Unknown | None:
        """Return the value of a ground fluent; None when nothing is recorded about it."""

    def objects(self, types: tuple[str, ...], /) -> tuple[str, ...]:
        """Return the objects of any of the types, in a fixed order."""


@dataclass(frozen=True, slots=True)
class OnlyObjects:
    """A state of which nothing but the objects is known, by type."""

    members: Mapping[str, tuple[str, ...]]

    def value(self, fluent: Fluent, /) -> None:
        """Return that nothing is recorded."""

    def objects(self, types: tuple[str, ...], /) -> tuple[str, ...]:
        """Return the objects of any of the types."""
        return tuple(dict.fromkeys(name for kind in types for name in self.members.get(kind, ())))


@dataclass(frozen=True, slots=True)
class Variable:
    """A typed variable of an action, a quantifier or a declaration; the name starts with ``?``."""

    name: str
    types: tuple[str, ...] = ("object",)

    def __str__(self) -> str:
        if len(self.types) == 1:
            return f"{self.name} - {self.types[0]}"
        return f"{self.name} - (either {' '.join(self.types)})"


@dataclass(frozen=True, slots=True)
class Constant:
    """A number, an object's name, a variable such as ``?x`` that stands for one, or a truth value, which equals no number."""

    value: Value

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Constant) and same_value(self.value, other.value)

    def __hash__(self) -> int:
        return hash(self.value)

    def __str__(self) -> str:
        if isinstance(self.value, float):
            return f"{self.value:.12g}" if self.value != int(self.value) else str(int(self.value))
        return str(self.value)


@dataclass(frozen=True, slots=True)
class ValueOf:
    """The value of a fluent: ``(battery r1)``; `DURATION` is the duration of the action."""

    fluent: Fluent

    def __str__(self) -> str:
        return "?duration" if self.fluent == DURATION else fluent_text(self.fluent)


@dataclass(frozen=True, slots=True)
class Arithmetic:
    """``+ - * /`` over two or more operands; ``-`` over one operand negates."""

    operation: str
    operands: tuple[Expression, ...]

    def __str__(self) -> str:
        return f"({self.operation} {' '.join(map(str, self.operands))})"


Expression: TypeAlias = Constant | ValueOf | Arithmetic

_ARITHMETIC: Final[dict[str, Callable[[float, float], float]]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
}


def value_of(expression: Expression, state: State, env: Environment = NOTHING) -> Value | Unknown:
    """Return the value of the expression; unknown as soon as one part is, or on division by zero."""
    match expression:
        case Constant(value):
            return _plain(env[value]) if isinstance(value, str) and value in env else value
        case ValueOf(fluent) if fluent == DURATION and DURATION[0] in env:
            return _plain(env[DURATION[0]])
        case ValueOf(fluent):
            known = state.value(bind(fluent, env))
            return UNKNOWN if known is None else known
        case Arithmetic(operation, operands):
            numbers = [value_of(operand, state, env) for operand in operands]
            if any(number is UNKNOWN or isinstance(number, str) for number in numbers):
                return UNKNOWN
            result, *others = [float(number) for number in numbers]  # type: ignore[arg-type]
            for number in others:
                if operation == "/" and number == 0:
                    return UNKNOWN
                result = _ARITHMETIC[operation](result, number)
            return result if others or operation != "-" else -result
        case _:
            assert_never(expression)


def same_value(left: Value | Unknown | None, right: Value | Unknown | None) -> bool:
    """Return whether two recorded values are the same; an absent one is the same as false and as no object, but not as 0."""
    if left is None:
        return right is None or right is False or right == UNDEFINED
    if right is None:
        return left is False or left == UNDEFINED
    return isinstance(left, bool) is isinstance(right, bool) and left == right


def absent_value(value: Value | Unknown) -> Value | Unknown:
    """Return the value of a fluent that no longer has a value of this kind: false, no object, or an unknown number."""
    return False if isinstance(value, bool) else UNDEFINED if isinstance(value, str) else UNKNOWN


def is_number(value: object) -> TypeGuard[float]:
    """Whether the value is a number; truth values are none."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def choices(variables: tuple[Variable, ...], state: State, env: Environment) -> Iterator[Environment]:
    """Yield the environment extended by every choice of objects for the variables."""
    names = [variable.name for variable in variables]
    for chosen in product(*(state.objects(variable.types) for variable in variables)):
        inner = {**env}
        inner.update(zip(names, chosen, strict=True))
        yield inner


def bind(fluent: Fluent, env: Environment) -> Fluent:
    """Replace the variables of the fluent by what the environment has for them: names of objects, or the text of other values."""
    if not env:
        return fluent
    return tuple([value if isinstance(value := env.get(term, term), str) else text_of(value) for term in fluent])


def text_of(value: object) -> str:
    """Write a value as the argument of a fluent: a name as it is, a number shortly, all else as JSON."""
    if isinstance(value, str):
        return value
    return f"{value:.12g}" if isinstance(value, float) else json.dumps(value, default=str)


def _plain(value: object) -> Value:
    return value if isinstance(value, bool | int | float | str) else text_of(value)


def fluent_text(fluent: Fluent) -> str:
    """Return the PDDL text of a fluent."""
    return f"({' '.join(fluent)})"


def leaves(expression: Expression) -> Iterator[Constant | ValueOf]:
    """Yield the constants and the fluents that the expression is computed from."""
    if isinstance(expression, Arithmetic):
        for operand in expression.operands:
            yield from leaves(operand)
    else:
        yield expression


def expression_fluents(expression: Expression, env: Environment = NOTHING) -> Iterator[Fluent]:
    """Yield every ground fluent the value of the expression depends on."""
    for leaf in leaves(expression):
        if isinstance(leaf, ValueOf) and (leaf.fluent != DURATION or DURATION[0] not in env):
            yield bind(leaf.fluent, env)


def variables_in(fluent: Fluent) -> frozenset[str]:
    """Return the terms of the fluent that are variables."""
    return frozenset(term for term in fluent if term.startswith("?"))


def expression_variables(expression: Expression) -> frozenset[str]:
    """Return the variables in the expression."""
    terms = (leaf.fluent if isinstance(leaf, ValueOf) else (str(leaf.value),) for leaf in leaves(expression))
    return frozenset().union(*map(variables_in, terms))


def ground_expression(expression: Expression, env: Environment) -> Expression:
    """Substitute the environment's values for the variables of an expression."""
    match expression:
        case Constant(value):
            return Constant(_plain(env[value])) if isinstance(value, str) and value in env else expression
        case ValueOf(fluent) if fluent == DURATION and DURATION[0] in env:
            return Constant(_plain(env[DURATION[0]]))
        case ValueOf(fluent):
            return ValueOf(bind(fluent, env))
        case Arithmetic(operation, operands):
            return Arithmetic(operation, tuple(ground_expression(operand, env) for operand in operands))
        case _:
            assert_never(expression)


def hidden(env: Environment, variables: tuple[Variable, ...]) -> Environment:
    """Return the environment without the variables that a quantifier binds anew."""
    names = {variable.name for variable in variables}
    return {name: value for name, value in env.items() if name not in names}
