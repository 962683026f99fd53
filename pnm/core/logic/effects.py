"""Effects: the changes that an action makes to a state.

Effects are simultaneous: every condition and every right-hand side is evaluated in the
state before, and a fact both deleted and added is added (PDDL 2.1, section 8).
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from math import prod
from typing import Final, TypeAlias, assert_never

from pnm.core.logic.conditions import Condition, Count, choices_in, evaluate, fluents, ground
from pnm.core.logic.expressions import (
    NOTHING,
    UNKNOWN,
    Constant,
    Environment,
    Expression,
    Fluent,
    State,
    Unknown,
    Value,
    Variable,
    absent_value,
    bind,
    choices,
    expression_fluents,
    fluent_text,
    ground_expression,
    hidden,
    is_number,
    same_value,
    value_of,
)

_ARITHMETIC: Final[dict[str, Callable[[float, float], float]]] = {
    "increase": operator.add,
    "decrease": operator.sub,
    "scale-up": operator.mul,
    "scale-down": operator.truediv,
}
OPERATIONS: Final = ("assign", *_ARITHMETIC)


@dataclass(frozen=True, slots=True)
class Set:
    """A fact becomes true or false (`assign` of a truth value), or a fluent gets a new value."""

    fluent: Fluent
    value: Expression
    operation: str = "assign"

    def __str__(self) -> str:
        if self.value == Constant(True):
            return fluent_text(self.fluent)
        if self.value == Constant(False):
            return f"(not {fluent_text(self.fluent)})"
        return f"({self.operation} {fluent_text(self.fluent)} {self.value})"


@dataclass(frozen=True, slots=True)
class When:
    """The effects happen if the condition holds in the state before."""

    condition: Condition
    effects: Effects
    early: bool = False
    """Of an effect at the end of an action: its condition is decided in the state the action starts in."""

    def __str__(self) -> str:
        return f"(when {self.condition} {effects_text(self.effects)})"


@dataclass(frozen=True, slots=True)
class ForEach:
    """The effects happen for every choice of objects for the variables."""

    variables: tuple[Variable, ...]
    effects: Effects

    def __str__(self) -> str:
        return f"(forall ({' '.join(map(str, self.variables))}) {effects_text(self.effects)})"


Effect: TypeAlias = Set | When | ForEach
Effects: TypeAlias = tuple[Effect, ...]
Changes: TypeAlias = dict[Fluent, Value | Unknown]


@dataclass(frozen=True, slots=True)
class TimedChange:
    """Facts and numbers that change by themselves at a time, in seconds: timed initial literals and fluents (PDDL 2.2)."""

    time: float
    changes: Mapping[Fluent, Value]


def effects_text(effects: Effects) -> str:
    """Return the PDDL text of effects, as one effect."""
    return str(effects[0]) if len(effects) == 1 else f"({' '.join(('and', *map(str, effects)))})"


def changes(effects: Effects, state: State, env: Environment = NOTHING) -> Changes:
    """Return the new value of every fluent the effects set, computed in the state before."""
    if not env and (constant := constants(effects)) is not None:
        return constant
    result: Changes = {}
    for fluent, effect, inner in assignments(effects, state, env):
        value = value_of(effect.value, state, inner)
        if value is False and fluent in result:
            continue  # delete-then-add of the same fact adds, whichever is written first
        if effect.operation == "assign":
            result[fluent] = value
        else:
            before = result.get(fluent, state.value(fluent))
            result[fluent] = UNKNOWN
            if is_number(before) and is_number(value) and (value or effect.operation != "scale-down"):
                result[fluent] = _ARITHMETIC[effect.operation](before, value)
    return result


def constants(effects: Effects) -> Changes | None:
    """Return the result of `changes` in every state, if the effects only assign constants; None if there are others."""
    result: Changes = {}
    for effect in effects:
        if not isinstance(effect, Set) or effect.operation != "assign" or not isinstance(effect.value, Constant):
            return None
        if effect.value.value is not False or effect.fluent not in result:
            result[effect.fluent] = effect.value.value
    return result


def every_effect(effects: Effects) -> Iterator[Effect]:
    """Yield the effects and all effects in them, outer ones first."""
    for effect in effects:
        yield effect
        if not isinstance(effect, Set):
            yield from every_effect(effect.effects)


def choices_in_effects(effects: Effects, count: Count, around: int = 0) -> int:
    """Return the number of facts, comparisons and changes when quantifiers are written out; see `choices_in`."""
    total = 0
    for effect in effects:
        match effect:
            case Set():
                total += around
            case When(condition, inner):
                total += choices_in(condition, count, around) + choices_in_effects(inner, count, around)
            case ForEach(variables, inner):
                total += choices_in_effects(inner, count, max(1, around) * prod(count(variable.types) for variable in variables))
            case _:
                assert_never(effect)
    return total


def expanded(
    effects: Effects, state: State, env: Environment = NOTHING, *, happening: bool = False
) -> Iterator[tuple[Set | When, Environment]]:
    """Yield every `Set` and `When` at any depth, once for every choice of objects, with its environment.

    With `happening`, those under conditions only where these hold in the state.
    """
    for effect in effects:
        if isinstance(effect, ForEach):
            for chosen in choices(effect.variables, state, env):
                yield from expanded(effect.effects, state, chosen, happening=happening)
        else:
            yield effect, env
            if isinstance(effect, When) and not (happening and evaluate(effect.condition, state, env) is not True):
                yield from expanded(effect.effects, state, env, happening=happening)


def decided(effects: Effects, state: State) -> Effects:
    """Return the end effects of an action that starts in the state, with their early conditions decided."""
    if not any(map(is_early, effects)):
        return effects
    result: list[Effect] = []
    for effect in effects:
        match effect:
            case Set():
                result.append(effect)
            case When(condition, inner, early):
                if not early:
                    result.append(When(condition, decided(inner, state)))
                elif evaluate(condition, state) is True:
                    result.extend(decided(inner, state))
            case ForEach(variables, inner):
                for chosen in choices(variables, state, NOTHING):
                    result.extend(decided(ground_effects(inner, chosen), state))
            case _:
                assert_never(effect)
    return tuple(result)


def is_early(effect: Effect) -> bool:
    """Return whether some condition in the effect is decided before it happens."""
    return not isinstance(effect, Set) and any(isinstance(part, When) and part.early for part in every_effect((effect,)))


def assignments(effects: Effects, state: State, env: Environment = NOTHING) -> Iterator[tuple[Fluent, Set, Environment]]:
    """Yield each `Set` that happens in the state, with its ground fluent and its environment."""
    return _sets(expanded(effects, state, env, happening=True))


def possible_assignments(effects: Effects, state: State) -> Iterator[tuple[Fluent, Set, Environment]]:
    """Yield the assignments as if every condition of the effects held."""
    return _sets(expanded(effects, state))


def _sets(effects: Iterable[tuple[Set | When, Environment]]) -> Iterator[tuple[Fluent, Set, Environment]]:
    return ((bind(effect.fluent, env), effect, env) for effect, env in effects if isinstance(effect, Set))


def written(effects: Effects, state: State) -> frozenset[Fluent]:
    """Return every fluent the effects may set, whether or not their conditions hold."""
    if (constant := constants(effects)) is not None:
        return frozenset(constant)
    return frozenset([fluent for fluent, _, _ in possible_assignments(effects, state)])


def names_written(effects: Effects) -> frozenset[str]:
    """Return the predicates and functions the effects may change."""
    return frozenset(effect.fluent[0] for effect in every_effect(effects) if isinstance(effect, Set))


def read(effects: Effects, state: State) -> frozenset[Fluent]:
    """Return every fluent that the effects read when they happen: in their conditions and right-hand sides."""
    if constants(effects) is not None:
        return frozenset()
    reads: set[Fluent] = set()
    for effect, env in expanded(effects, state):
        match effect:
            case Set(fluent, value, operation):
                reads.update(expression_fluents(value, env))
                if operation != "assign":
                    reads.add(bind(fluent, env))
            case When(condition, _, early):
                if not early:
                    reads |= fluents(condition, state, env)
            case _:
                assert_never(effect)
    return frozenset(reads)


def read_early(effects: Effects, state: State) -> frozenset[Fluent]:
    """Return every fluent that end effects read when the action starts: in their early conditions."""
    if all(isinstance(effect, Set) for effect in effects):
        return frozenset()
    early = ((effect.condition, env) for effect, env in expanded(effects, state) if isinstance(effect, When) and effect.early)
    return frozenset(fluent for condition, env in early for fluent in fluents(condition, state, env))


def ground_effects(effects: Effects, env: Environment) -> Effects:
    """Substitute the environment's values for the variables; quantified variables stay."""
    result: list[Effect] = []
    for effect in effects:
        match effect:
            case Set(fluent, value, operation):
                result.append(Set(bind(fluent, env), ground_expression(value, env), operation))
            case When(condition, inner, early):
                result.append(When(ground(condition, env), ground_effects(inner, env), early))
            case ForEach(variables, inner):
                result.append(ForEach(variables, ground_effects(inner, hidden(env, variables))))
            case _:
                assert_never(effect)
    return tuple(result)


def values_before(after: Changes, state: State) -> Changes:
    """Return the old values of fluents that are about to change; an absent one is false, undefined, or an unknown number."""
    before: Changes = {}
    for fluent, new in after.items():
        old = state.value(fluent)
        before[fluent] = absent_value(new) if old is None else old
    return before


def undo(before: Changes, after: Changes, now: State) -> Changes:
    """Return the changes that roll `after` back: to the old values of fluents that were not written again since.

    A number that has changed since is moved back by the difference the effect made.
    """
    result: Changes = {}
    for fluent, value in after.items():
        current, old = now.value(fluent), before[fluent]
        if same_value(current, value):
            result[fluent] = old
        elif is_number(current) and is_number(old) and is_number(value):
            result[fluent] = current - (value - old)
    return result


def is_fixed(effect: Effect) -> bool:
    """Return whether the effect assigns the same values in every state: it has no condition and reads nothing."""
    if isinstance(effect, ForEach):
        return all(map(is_fixed, effect.effects))
    return isinstance(effect, Set) and effect.operation == "assign" and isinstance(effect.value, Constant)


def facts(effects: Iterable[Effect], state: State) -> Changes | None:
    """Return the truth values and objects that the effects assign in any state; None if they depend on it, or assign numbers."""
    flat = tuple(effects)
    if not all(map(is_fixed, flat)):
        return None
    assigned = changes(flat, state)
    return None if any(map(is_number, assigned.values())) else assigned
