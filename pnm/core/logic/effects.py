"""What an action does to a state.

Effects are simultaneous: every condition and every right-hand side is evaluated in the
state before, and a fact both deleted and added is added (PDDL 2.1, section 8).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final, TypeAlias, assert_never

from pnm.core.logic.conditions import Condition, evaluate, fluents, ground
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
    bind,
    choices,
    expression_fluents,
    ground_expression,
    hidden,
    is_number,
    nothing_like,
    same,
    show,
    value_of,
)

OPERATIONS: Final = ("assign", "increase", "decrease", "scale-up", "scale-down")


@dataclass(frozen=True, slots=True)
class Set:
    """A fact becomes true or false (`assign` of a truth value), or a fluent gets a new value."""

    fluent: Fluent
    value: Expression
    operation: str = "assign"

    def __str__(self) -> str:
        if self.value == Constant(True):
            return show(self.fluent)
        if self.value == Constant(False):
            return f"(not {show(self.fluent)})"
        return f"({self.operation} {show(self.fluent)} {self.value})"


@dataclass(frozen=True, slots=True)
class When:
    """The effects happen if the condition holds in the state before."""

    condition: Condition
    effects: Effects
    early: bool = False
    """Of an effect at the end of an action: its condition is decided in the state the action starts in."""

    def __str__(self) -> str:
        return f"(when {self.condition} {show_effects(self.effects)})"


@dataclass(frozen=True, slots=True)
class ForEach:
    """The effects happen for every choice of objects for the variables."""

    variables: tuple[Variable, ...]
    effects: Effects

    def __str__(self) -> str:
        return f"(forall ({' '.join(map(str, self.variables))}) {show_effects(self.effects)})"


Effect: TypeAlias = Set | When | ForEach
Effects: TypeAlias = tuple[Effect, ...]
Changes: TypeAlias = dict[Fluent, Value | Unknown]


@dataclass(frozen=True, slots=True)
class TimedChange:
    """Facts and numbers that change by themselves at a time, in seconds: timed initial literals and fluents."""

    time: float
    changes: Mapping[Fluent, Value]


def show_effects(effects: Effects) -> str:
    """Write effects as one PDDL effect."""
    return str(effects[0]) if len(effects) == 1 else f"({' '.join(('and', *map(str, effects)))})"


def changes(effects: Effects, state: State, env: Environment = NOTHING) -> Changes:
    """Return the new value of every fluent the effects set, computed in the state before."""
    result: Changes = {}
    for fluent, effect, inner in assignments(effects, state, env):
        value = value_of(effect.value, state, inner)
        if value is False and fluent in result:
            continue  # delete-then-add of the same fact adds, whichever is written first
        if effect.operation == "assign":
            result[fluent] = value
        else:
            before = result.get(fluent, state.value(fluent))
            result[fluent] = _combine(effect.operation, before, value)
    return result


def decided(effects: Effects, state: State) -> Effects:
    """Return what is left of the end effects of an action that starts in the state: the early conditions are decided."""
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
    """Tell whether some condition in the effect is decided before it happens."""
    return not isinstance(effect, Set) and ((isinstance(effect, When) and effect.early) or any(map(is_early, effect.effects)))


def assignments(effects: Effects, state: State, env: Environment = NOTHING) -> Iterator[tuple[Fluent, Set, Environment]]:
    """Yield each `Set` that happens in the state, with its ground fluent and its environment."""
    for effect in effects:
        match effect:
            case Set(fluent):
                yield bind(fluent, env), effect, env
            case When(condition, inner):
                if evaluate(condition, state, env) is True:
                    yield from assignments(inner, state, env)
            case ForEach(variables, inner):
                for chosen in choices(variables, state, env):
                    yield from assignments(inner, state, chosen)
            case _:
                assert_never(effect)


def written(effects: Effects, state: State) -> frozenset[Fluent]:
    """Return every fluent the effects may set, whether or not their conditions hold."""
    return frozenset(fluent for fluent, _, _ in assignments(unconditional(effects), state))


def names_written(effects: Effects) -> frozenset[str]:
    """Return the predicates and functions the effects may change."""
    return frozenset(name for effect in effects for name in _names(effect))


def _names(effect: Effect) -> Iterator[str]:
    match effect:
        case Set(fluent):
            yield fluent[0]
        case When(_, inner) | ForEach(_, inner):
            for one in inner:
                yield from _names(one)
        case _:
            assert_never(effect)


def read(effects: Effects, state: State) -> frozenset[Fluent]:
    """Return every fluent that decides what the effects do when they happen: their conditions and right-hand sides."""
    return frozenset(_read(effects, state, NOTHING))


def _read(effects: Effects, state: State, env: Environment) -> Iterator[Fluent]:
    for effect in effects:
        match effect:
            case Set(fluent, value, operation):
                yield from expression_fluents(value, env)
                if operation != "assign":
                    yield bind(fluent, env)
            case When(condition, inner, early):
                if not early:
                    yield from fluents(condition, state, env)
                yield from _read(inner, state, env)
            case ForEach(variables, inner):
                for chosen in choices(variables, state, env):
                    yield from _read(inner, state, chosen)
            case _:
                assert_never(effect)


def read_early(effects: Effects, state: State) -> frozenset[Fluent]:
    """Return every fluent that decides, when the action starts, what its end effects will be."""
    return frozenset(_read_early(effects, state, NOTHING))


def _read_early(effects: Effects, state: State, env: Environment) -> Iterator[Fluent]:
    for effect in effects:
        match effect:
            case Set():
                pass
            case When(condition, inner, early):
                if early:
                    yield from fluents(condition, state, env)
                yield from _read_early(inner, state, env)
            case ForEach(variables, inner):
                for chosen in choices(variables, state, env):
                    yield from _read_early(inner, state, chosen)
            case _:
                assert_never(effect)


def unconditional(effects: Effects) -> Effects:
    """Return the effects with every `When` replaced by what it may do."""
    result: list[Effect] = []
    for effect in effects:
        match effect:
            case Set():
                result.append(effect)
            case When(_, inner):
                result.extend(unconditional(inner))
            case ForEach(variables, inner):
                result.append(ForEach(variables, unconditional(inner)))
            case _:
                assert_never(effect)
    return tuple(result)


def ground_effects(effects: Effects, env: Environment) -> Effects:
    """Substitute the environment's values for the variables; quantified variables stay."""
    return tuple(_ground(effect, env) for effect in effects)


def _ground(effect: Effect, env: Environment) -> Effect:
    match effect:
        case Set(fluent, value, operation):
            return Set(bind(fluent, env), ground_expression(value, env), operation)
        case When(condition, inner, early):
            return When(ground(condition, env), ground_effects(inner, env), early)
        case ForEach(variables, inner):
            return ForEach(variables, ground_effects(inner, hidden(env, variables)))
        case _:
            assert_never(effect)


def values_before(after: Changes, state: State) -> Changes:
    """Return what the state has for the fluents that are about to be changed; what is absent is false, undefined, or an unknown number."""
    found: Changes = {}
    for fluent, value in after.items():
        old = state.value(fluent)
        found[fluent] = old if old is not None else nothing_like(value)
    return found


def undo(before: Changes, after: Changes, now: State) -> Changes:
    """Return what takes back `after`: old values where nobody else has written since.

    A number that has changed since is moved back by the difference the effect made.
    """
    result: Changes = {}
    for fluent, value in after.items():
        current, old = now.value(fluent), before[fluent]
        if same(current, value):
            result[fluent] = old
        elif is_number(current) and is_number(old) and is_number(value):
            result[fluent] = current - (value - old)
    return result


def is_fixed(effect: Effect) -> bool:
    """Tell whether the effect gives the same values whatever the state: no condition, nothing that is read."""
    match effect:
        case Set(_, value, operation):
            return operation == "assign" and isinstance(value, Constant)
        case When():
            return False
        case ForEach(_, inner):
            return all(map(is_fixed, inner))
        case _:
            assert_never(effect)


def facts(effects: Iterable[Effect], state: State) -> Changes | None:
    """Return the truth values and objects that the effects give whatever the state, or None if they do anything else."""
    flat = tuple(effects)
    if not all(map(is_fixed, flat)):
        return None
    found = changes(flat, state)
    return None if any(map(is_number, found.values())) else found


def _combine(operation: str, before: Value | Unknown | None, by: Value | Unknown) -> Value | Unknown:
    if not is_number(before) or not is_number(by):
        return UNKNOWN
    match operation:
        case "increase":
            return before + by
        case "decrease":
            return before - by
        case "scale-up":
            return before * by
        case "scale-down" if by:
            return before / by
        case _:
            return UNKNOWN
